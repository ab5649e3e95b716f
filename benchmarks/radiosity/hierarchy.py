"""Form factors by lines in a hierarchy of spheres (chapter 4 of the thesis): estimators (table 4.1), against lines of
the whole scene (tables 4.2 and 4.3), with number sequences (tables 4.4 and 4.5), and against rasterised bundles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.points import Independent, PointSet
from etendue.radiosity import (
    ABuffer,
    Estimator,
    FormFactors,
    PartialSegments,
    RayScene,
    Segments,
    SpherePairs,
    SphereTree,
    SpiralPoints,
    TreeBundles,
    TreeRays,
    allocated,
    area_shares,
    find_objects,
    form_factors,
    least_error_shares,
    pair_errors,
    partial_form_factors,
    sphere_tree,
)

from .. import plotting
from ..measuring import Record, timed
from ..options import Out, Seeds, whole_numbers
from . import trees
from .drivers import DRIVERS
from .options import BUNDLES, OUT, Detail, ReferenceBundles, Scenes
from .references import factor_reference
from .scenes import SCENES
from .sweeping import Known, WholeRays, jackknife

_KINDS: tuple[Estimator, ...] = ("F1", "F2", "F3", "F4", "reciprocal", "pooled")
CLASSIC, INDEPENDENT, LEAST = "whole scene", "independent", "least error"
FLAT_BUNDLES, TREE_BUNDLES = "bundles of the whole scene", "bundles of the spheres"
#: Lines of a rasterised bundle.
_BUNDLE = 4096
#: Passes of one run: points go on from pass to pass.
_PASS = 1 << 18
#: Tables 4.1 to 4.5: F3 and F4 to F1; lines of the whole scene to those of the hierarchy, error and efficiency;
#: efficiency with independent numbers, Halton's and Sobol's points.
_ESTIMATORS = {"F1": "1", "F3": "7.1 to 7.8", "F4": "0.83 to 0.95"}
_GAINS = {"nine-cubes": ("3.6 to 3.9", "2.6 to 2.8"), "six-cubes": ("2.6 to 4.5", "1.8 to 3.2")}
_SEQUENCES = {INDEPENDENT: "3.0 to 3.6", "halton": "5.2 to 7.8", "sobol": "5.9 to 8.8"}
_GAIN_BAR, _SEQUENCE_BAR = 2.0, 1.6


@dataclass(frozen=True)
class Runs:
    """Squared errors by estimator and CPU seconds of a way to cast lines: for each seed and number of lines."""

    errors: Mapping[Estimator, Array]  #: (s, m)
    seconds: Array  #: (s, m)

    def efficiency(self, kind: Estimator, other: Runs, other_kind: Estimator, mark: int) -> Known:
        """Of this way, relative to that of another: the quotient of their products of error and time."""
        columns = (self.errors[kind], self.seconds, other.errors[other_kind], other.seconds)

        def quotient(rows: Array) -> float:
            mine, my_time, theirs, their_time = rows.mean(axis=0)
            return float(theirs * their_time / (mine * my_time))

        return jackknife(quotient, np.stack([column[:, mark] for column in columns], axis=1))

    def ratio(self, kind: Estimator, other: Runs, other_kind: Estimator, mark: int) -> Known:
        """Of its error to that of another."""
        pair = np.stack([self.errors[kind][:, mark], other.errors[other_kind][:, mark]], axis=1)
        return jackknife(lambda rows: float(np.divide(*rows.mean(axis=0))), pair)


#: Casts a number of lines with a seed, and makes form factors by an estimator.
Way = Callable[[int, int], Segments | PartialSegments]


def ways(scene: RayScene, tree: SphereTree) -> dict[str, Way]:
    """How lines are cast, by name."""
    patches = scene.patches

    def of_tree(driver: Callable[[int, int], PointSet], shares: Array) -> Way:
        def cast(lines: int, seed: int) -> PartialSegments:
            passes = max(lines // _PASS, 1)
            counts = allocated(lines // passes, shares)
            points = [driver(int(counts[k]) * passes, 1000 * seed + k) for k in range(len(tree))]
            engine = TreeRays(tree, scene, points, counts)
            return PartialSegments(tree, list(engine.stream(passes, 0, 1)), engine.densities(passes))

        return cast

    def flat(lines: int, seed: int) -> Segments:
        passes = max(lines // _PASS, 1)
        engine = WholeRays(SpherePairs(patches), scene, Independent(4, seed))
        chunks = list(engine.stream(lines, 0, lines // passes))
        return Segments(patches, chunks, np.zeros(len(chunks)), engine.expected(lines))

    def flat_bundles(lines: int, seed: int) -> Segments:
        bundles = max(lines // _BUNDLE, 1)
        return ABuffer(patches, SpiralPoints(seed, bundles), _BUNDLE).cast(bundles)

    def tree_bundles(lines: int, seed: int) -> PartialSegments:
        bundles = max(lines // _BUNDLE, 1)
        points = [SpiralPoints(1000 * seed + k, bundles) for k in range(len(tree))]
        engine = TreeBundles(tree, points, _BUNDLE * least_error_shares(tree))
        return PartialSegments(tree, list(engine.stream(bundles)), engine.densities(bundles))

    shares = area_shares(tree)
    made: dict[str, Way] = {CLASSIC: flat}
    made |= {name: of_tree(DRIVERS[name], shares) for name in (INDEPENDENT, "halton", "sobol")}
    made[LEAST] = of_tree(DRIVERS[INDEPENDENT], least_error_shares(tree))
    made[f"{LEAST}, sobol"] = of_tree(DRIVERS["sobol"], least_error_shares(tree))
    return made | {FLAT_BUNDLES: flat_bundles, TREE_BUNDLES: tree_bundles}


def factors_of(segments: Segments | PartialSegments, kind: Estimator) -> FormFactors:
    """Form factors of either."""
    if isinstance(segments, PartialSegments):
        return partial_form_factors(segments, kind)
    return form_factors(segments, kind)


def sweep(tasks: Mapping[str, Way], exact: FormFactors, lines: Sequence[int], seeds: int) -> dict[str, Runs]:
    """Every way with every seed and number of lines, in turn. The time is that of casting and of the form factors."""
    shape = seeds, len(lines)
    runs = {name: Runs({kind: np.empty(shape) for kind in _KINDS}, np.empty(shape)) for name in tasks}
    for task in tasks.values():
        factors_of(task(lines[0], seeds), "F4")
    for seed in range(seeds):
        for mark, count in enumerate(lines):
            for name, task in tasks.items():
                made: list[Any] = []

                def work(task: Way = task, count: int = count, seed: int = seed, made: list[Any] = made) -> None:
                    made.append(task(count, seed))
                    made.append(factors_of(made[0], "F4"))

                runs[name].seconds[seed, mark] = timed(work).cpu
                for kind in _KINDS:
                    factors = made[1] if kind == "F4" else factors_of(made[0], kind)
                    runs[name].errors[kind][seed, mark] = pair_errors(factors, exact)
    return runs


def measure(
    scenes: Scenes = "nine-cubes-factors,six-cubes-factors,test-one-factors",
    lines: Annotated[
        Any, typer.Option(parser=whole_numbers, help="Numbers, separated by commas.", metavar="N,...")
    ] = "50000,100000,500000,1000000",
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    bundles: ReferenceBundles = BUNDLES,
    out: Out = OUT,
) -> Iterator[Record]:
    """Four tables of each scene."""
    for name in scenes:
        scene = RayScene(SCENES[name](detail))
        tree = sphere_tree(find_objects(scene.patches))
        trees.save(out / f"tree-{name}.svg", tree, f"Spheres around the objects of {name}, from above")
        exact, noise = factor_reference(scene.patches, bundles)
        runs = sweep(ways(scene, tree), exact, lines, seeds)
        title = f"{name}, {len(scene.patches)} patches, {tree.objects.count} objects, {seeds} seeds"
        least = min(run.errors[kind][:, -1].mean() for run in runs.values() for kind in _KINDS)
        note = f"noise of the reference: {noise:.2g}, {noise / least:.1%} of the least error"
        yield _estimators(title, runs[INDEPENDENT], lines, note)
        yield _gains(name, title, runs, lines, note, out)
        yield _with_sequences(title, runs, lines, note)
        yield _engines(title, runs, lines, note)


def _estimators(title: str, runs: Runs, lines: Sequence[int], note: str) -> Record:
    """Table 4.1: a row for each estimator."""
    ratios = [f"to F1, {count} lines" for count in lines]
    record = Record(f"Estimators in a hierarchy, {title}", ("", f"FFE, {lines[-1]} lines", *ratios, "thesis, to F1"))
    for kind in _KINDS:
        cells = [str(runs.ratio(kind, runs, "F1", mark)) for mark in range(len(lines))]
        record.add(kind, f"{runs.errors[kind][:, -1].mean():.4g}", *cells, _ESTIMATORS.get(kind, ""))
    record.notes += [
        "FFE is the sum of squared errors over all pairs; independent numbers, 20 % of the lines in the main sphere",
        note,
    ]
    return record


def _gains(name: str, title: str, runs: Mapping[str, Runs], lines: Sequence[int], note: str, out: Path) -> Record:
    """Tables 4.2 and 4.3: a row for each number of lines."""
    flat, tree, least = runs[CLASSIC], runs[INDEPENDENT], runs[LEAST]
    record = Record(
        f"Hierarchy and whole scene, {title}",
        ("lines", "T cl", "FFE cl", "T hi", "FFE hi", "T hi / cl", "FFE cl / hi", "RelEff", "RelEff, least error"),
    )
    for mark, count in enumerate(lines):
        times = [run.seconds[:, mark].mean() for run in (flat, tree)]
        record.add(
            str(count),
            f"{times[0]:.3f}",
            f"{flat.errors['F1'][:, mark].mean():.4g}",
            f"{times[1]:.3f}",
            f"{tree.errors['F4'][:, mark].mean():.4g}",
            f"{times[1] / times[0]:.2f}",
            str(flat.ratio("F1", tree, "F4", mark)),
            str(tree.efficiency("F4", flat, "F1", mark)),
            str(least.efficiency("pooled", flat, "F1", mark)),
        )
    thesis = _GAINS.get(name.removesuffix("-factors"))
    if thesis:
        record.add("thesis", "", "", "", "", "1.39 to 1.42", *thesis, "")
        final = tree.efficiency("F4", flat, "F1", len(lines) - 1).value
        record.notes.append(f"RelEff at {lines[-1]} lines, bar {_floor(final, _GAIN_BAR)}")
    record.notes += [
        "T in CPU seconds, of casting and form factors; RelEff = T cl FFE cl / (T hi FFE hi); whole scene by F1, "
        "hierarchy by F4 with 20 % in the main sphere; least error: shares of that, by pooled",
        note,
    ]
    curves = {way: [(float(n), float(e)) for n, e in zip(lines, mean, strict=True)] for way, mean in _curves(runs)}
    plotting.save(out / f"hierarchy-{name}.svg", curves, name, "lines", "sum of squared errors of form factors", 1.0)
    return record


def _floor(value: float, bar: float) -> str:
    """A value's lower bar, and whether it is reached."""
    return f"≥ {bar:g}: {'reached' if value >= bar else 'missed'}"


def _curves(runs: Mapping[str, Runs]) -> Iterator[tuple[str, Array]]:
    """What is plotted: six curves."""
    for way in (CLASSIC, INDEPENDENT, "halton", "sobol", f"{LEAST}, sobol", FLAT_BUNDLES):
        kind: Estimator = "F1" if way in (CLASSIC, FLAT_BUNDLES) else "pooled"
        yield way, runs[way].errors[kind].mean(axis=0)


def _with_sequences(title: str, runs: Mapping[str, Runs], lines: Sequence[int], note: str) -> Record:
    """Tables 4.4 and 4.5: a row for each point set."""
    flat, plain = runs[CLASSIC], runs[INDEPENDENT]
    heads = [f"RelEff, {count} lines" for count in lines]
    record = Record(
        f"Sequences in a hierarchy, {title}",
        ("", *heads, "thesis (test-one)", f"gain, {lines[-1]} lines", "gain, pooled", "bar"),
    )
    for name in (INDEPENDENT, "halton", "sobol"):
        cells = [str(runs[name].efficiency("F4", flat, "F1", mark)) for mark in range(len(lines))]
        gain, pooled = (runs[name].efficiency(kind, plain, kind, len(lines) - 1) for kind in ("F4", "pooled"))
        judged = "" if name == INDEPENDENT else _floor(gain.value, _SEQUENCE_BAR)
        record.add(name, *cells, _SEQUENCES[name], str(gain), str(pooled), judged)
    record.notes += [
        "whole scene with independent numbers by F1, hierarchy by F4; gain: over independent numbers",
        note,
    ]
    return record


def _engines(title: str, runs: Mapping[str, Runs], lines: Sequence[int], note: str) -> Record:
    """Every way, by the product of its error and its time."""
    record = Record(
        f"Rays and bundles, {title}", ("", f"FFE, {lines[-1]} lines", "CPU seconds", "efficiency to rays, whole scene")
    )
    for name, run in runs.items():
        kind: Estimator = "F1" if name in (CLASSIC, FLAT_BUNDLES) else "pooled"
        known = run.efficiency(kind, runs[CLASSIC], "F1", len(lines) - 1)
        error, seconds = run.errors[kind][:, -1].mean(), run.seconds[:, -1].mean()
        record.add(name, f"{error:.4g}", f"{seconds:.3f}", str(known))
    record.notes += [f"F1 for the whole scene, pooled for spheres; bundles of {_BUNDLE} lines", note]
    return record
