"""Error after a given time, of every method on scenes of which a converged picture by another renderer exists."""

from __future__ import annotations

import atexit
import re
import shutil
import statistics
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from etendue import film, render
from etendue.cli.options import parse_pairs, settings_by_method
from etendue.scene import bundled

from .measuring import PUBLIC_SCENES, Record, console, verdict
from .options import Define, Methods, Names, Seconds, Seeds, Size

#: relMSE after 60 s at 512x512.
BARS = {
    ("veach-bidir", "auto"): 0.006,
    ("veach-bidir", "bpt"): 0.010,
    ("veach-bidir", "vcm"): 0.030,
    ("water-caustic", "vcm"): 0.006,
    ("water-caustic", "sppm"): 0.03,
}
BAR_SECONDS, BAR_SIZE = 60.0, (512, 512)
SCENES = "caustics,veach-bidir,water-caustic,cornell-box"


@dataclass(frozen=True)
class Case:
    """A scene and its reference picture."""

    name: str
    source: Any
    reference: Any  #: (height, width, 3), of the size that is rendered
    note: str

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the reference."""
        return self.reference.shape[1], self.reference.shape[0]


def find(name: str, size: tuple[int, int]) -> Case | str:
    """The case of a scene, or in words why it cannot be measured. A bundled scene has the size of its reference."""
    folder = PUBLIC_SCENES / name
    path = folder / "TungstenRender.exr"
    if not path.is_file():  # there is a Cornell box on both sides; the public one has a picture
        scene = bundled().get(name)
        if scene is None or scene.reference is None:
            return f"{name}: left out, there is no reference picture of it here"
        return Case(name, name, film.read_image(scene.reference), scene.reference_note)
    picture = film.read_image(path)
    height, width = picture.shape[:2]
    factor = width // size[0]
    if (width, height) != (factor * size[0], factor * size[1]):
        return f"{name}: left out, its reference of {width}x{height} cannot be averaged to {size[0]}x{size[1]}"
    note = (
        f"the author's picture, by Tungsten, {width}x{height} averaged in blocks of {factor}; "
        "rendered with a box filter in place of the scene's, as averaging is one"
    )
    return Case(name, str(filtered(folder)), film.block_average(picture, factor), note)


def filtered(folder: Path, kind: str = "box") -> Path:
    """A copy of the scene file with another filter, in a temporary folder that links to the scene's other files."""
    text = (folder / "scene.xml").read_text()
    text = re.sub(r"<rfilter[^>]*/>", "", text)
    text = re.sub(r"(<film [^>]*>)", rf'\1<rfilter type="{kind}"/>', text, count=1)
    copy = Path(tempfile.mkdtemp(prefix="etendue-benchmark-"))
    atexit.register(shutil.rmtree, copy, ignore_errors=True)
    for sibling in folder.resolve().iterdir():
        if sibling.name != "scene.xml":
            (copy / sibling.name).symlink_to(sibling)
    (copy / "scene.xml").write_text(text)
    return copy / "scene.xml"


def measure(
    scenes: Names = SCENES,
    names: Methods = "auto,path,light,sppm,bpt,bpm,vcm",
    size: Size = "512x512",
    seconds: Seconds = 60.0,
    seeds: Seeds = 1,
    define: Define = None,
) -> Iterator[Record]:
    """One table a scene; the methods take turns, seed by seed."""
    settings = parse_pairs(define, "-D")
    for scene in scenes:
        case = find(scene, size)
        if isinstance(case, str):
            console.print(case)
        else:
            yield _scene(case, names, seconds, seeds, settings)


def _scene(case: Case, names: Sequence[str], seconds: float, seeds: int, settings: Mapping[str, str]) -> Record:
    own = settings_by_method(names, settings)
    outcomes: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for seed in range(seeds):
        for name in names:
            console.print(f"{case.name}, {name}, seed {seed}, {seconds:g} s", style="dim")
            outcomes[name].append(_run(case, name, seconds, seed, own[name]))
    record = Record(
        f"Quality, {case.name}, {case.size[0]}x{case.size[1]}, {seconds:g} s",
        ("", "relMSE", "without worst 0.1 %", "relMSE x s", "brightness", "spp", "passes", "Mrays/s", "bar"),
    )
    for name, runs in outcomes.items():
        middle = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
        comparable = seconds == BAR_SECONDS and case.size == BAR_SIZE
        record.add(
            name,
            f"{middle['error']:.4g}",
            f"{middle['trimmed']:.4g}",
            f"{middle['error'] * middle['seconds']:.3g}",
            f"{middle['bias']:+.1%}",
            f"{middle['samples']:.0f}",
            f"{middle['passes']:.0f}",
            f"{middle['rate'] / 1e6:.1f}",
            verdict(middle["error"], BARS.get((case.name, name))) if comparable else "",
        )
    record.notes += [
        f"reference: {case.note}; pixels that are not finite in it are left out: "
        f"{np.count_nonzero(~np.isfinite(case.reference).all(axis=2))} of {case.size[0] * case.size[1]}",
        f"median of {seeds} seed{'s' if seeds > 1 else ''}; one process, one method after the other; the time begins "
        "when the scene is loaded, compilation included",
        "relMSE: mean of (x - ref)² / (ref² + 0.01); brightness: mean over the reference's mean, minus 1",
        "settings: " + (", ".join(f"{k}={v}" for k, v in settings.items()) or "defaults"),
    ]
    return record


def _run(case: Case, name: str, seconds: float, seed: int, settings: Mapping[str, Any]) -> dict[str, float]:
    rendering = render(case.source, name, seconds=seconds, size=case.size, seed=seed, **settings)
    facts = rendering.metadata
    return {
        "error": film.relative_mse(rendering.image, case.reference),
        "trimmed": film.relative_mse(rendering.image, case.reference, trim=0.001),
        "bias": film.relative_bias(rendering.image, case.reference),
        "seconds": float(facts["seconds"]),
        "samples": float(facts["samples"]),
        "passes": float(facts["passes"]),
        "rate": float(facts["rays"]) / max(float(facts["seconds"]), 1e-9),
    }
