"""Numbers that a change of structure must not change: every method, line engine and solver on small scenes.

    python tools/fingerprints.py write before.npz     on the old commit
    python tools/fingerprints.py write after.npz      on the new one
    python tools/fingerprints.py compare before.npz after.npz

``compare`` wants the same bits of what nothing is scattered for, and 1e-5 of the largest number elsewhere: sums by
several threads are added in any order.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

#: What is bit-equal from run to run.
EXACT = ("path ", "guided ", "segments ", "lines ", "points ")
#: Of the largest number of an array.
TOLERANCE = 1e-5


def pictures() -> Iterator[tuple[str, Any]]:
    """Every method."""
    import etendue
    from etendue.methods import table

    for name in table():
        for scene in ("cornell-glass", "skylight"):
            made = etendue.render(scene, name, spp=8, size=(20, 15), seed=3, samples_per_pass=4)
            for layer, values in made.layers.items():
                yield f"{name} {scene} {layer}", values


def room() -> Any:
    """Two boxes in a room, three channels."""
    from etendue import radiosity as r

    vertices, faces = r.joined(r.box((0, 0, 0), (1, 1, 1), inward=True), r.box((0.3, 0.0, 0.3), (0.6, 0.4, 0.5)))
    count = len(faces)
    emission = np.zeros((count, 3))
    emission[0] = 1.0, 2.0, 3.0
    reflectance = np.full((count, 3), (0.3, 0.5, 0.7))
    return r.Patches(vertices, faces, reflectance=reflectance, emission=emission).subdivided(0.1)


def radiosities() -> Iterator[tuple[str, Any]]:
    """Lines, segments, form factors by every estimator, and every solver."""
    from etendue import radiosity as r
    from etendue.points import Independent, OwenSobol

    patches = room()
    rays = r.RayScene(patches)
    engines: dict[str, Any] = {
        "A-buffer": r.ABuffer(patches, OwenSobol(4, seed=1), 500),
        "A-buffer by Dr.Jit": r.ABuffer(patches, OwenSobol(4, seed=1), 500, backend="drjit"),
        "local rays": r.LocalRays(rays, OwenSobol(4, seed=2)),
    }
    for name, generator in (("pairs", r.SpherePairs), ("circle", r.GreatCircle), ("walls", r.BoxWalls)):
        engines[name] = r.ChainedRays(generator(patches), rays, OwenSobol(4, seed=3))
    for name, engine in engines.items():
        segments = engine.cast(64 if "buffer" in name else 4096)
        yield f"segments {name}", np.concatenate(segments.chunks)
        for estimator in r.ESTIMATORS:
            if estimator != "F2" or name != "local rays":
                factors = r.form_factors(segments, estimator)
                yield f"factors {name} {estimator}", factors.matrix.toarray()
                yield f"factors {name} {estimator} errors", factors.errors.toarray()
    segments = r.ABuffer(patches, OwenSobol(4, seed=1), 500).cast(128)
    shot = r.first_shot(rays, Independent(4, seed=9).block(1 << 12))
    for solver in r.SOLVERS:
        yield f"solver {solver}", r.solve(patches, r.form_factors(segments, "F4"), solver=solver).radiosity
    yield "solver on segments", r.solve(patches, segments).radiosity
    yield "solver after a shot", r.solve(patches, segments, shot=shot).radiosity
    chained = r.ChainedRays(r.SpherePairs(patches), rays, Independent(4, seed=5))
    yield "multipath", r.multipath(chained, 4096, shot=shot).radiosity
    yield "multipath by bundles", r.multipath_bundles(r.ABuffer(patches, Independent(4, seed=5), 200), 64).radiosity
    yield "particles by bounces", r.breadth_first(rays, 1 << 12, Independent(4, seed=6)).radiosity
    yield "particles by paths", r.depth_first(rays, 1 << 12, Independent(4, seed=6), seed=6).radiosity
    yield "factors of local rays", r.local_form_factors(rays, 1 << 8, points=OwenSobol(4, seed=7)).matrix.toarray()
    yield "vertices", r.vertex_radiosity(patches, r.solve(patches, segments).radiosity).values


def main(arguments: list[str]) -> int:
    """Write, or compare; 1 if something differs."""
    if arguments[:1] == ["write"] and len(arguments) == 2:
        from etendue.core import use_variant

        use_variant()
        found: dict[str, Any] = {n: np.asarray(values) for make in (pictures, radiosities) for n, values in make()}
        np.savez(arguments[1], **found)
        sys.stdout.write(f"{len(found)} arrays\n")
        return 0
    if arguments[:1] == ["compare"] and len(arguments) == 3:
        before, after = (dict(np.load(path)) for path in arguments[1:])
        faults = [f"only in one: {name}" for name in before.keys() ^ after.keys()]
        for name in sorted(before.keys() & after.keys()):
            a, b = before[name].astype(float), after[name].astype(float)
            same = a.shape == b.shape and np.array_equal(a, b, equal_nan=True)
            far = np.inf if a.shape != b.shape else np.abs(a - b).max() / max(np.abs(a).max(), 1e-30) if a.size else 0.0
            if not same and (name.startswith(EXACT) or not far <= TOLERANCE):
                faults.append(f"{name}: {far:.2g} of the largest number")
        sys.stdout.write("\n".join([*faults, f"{len(before)} arrays, {len(faults)} differ"]) + "\n")
        return int(bool(faults))
    sys.stdout.write(__doc__ or "")
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
