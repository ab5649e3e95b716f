"""Resuming: the task of a checkpoint or of a file of particles, for every kind of run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import CheckpointError, OptionError, checked_path, describe
from etendue.engine import Checkpoint, Product, Source, Task
from etendue.particles import is_particle_file
from etendue.scene import SceneSource

from .files import PathLike, listed
from .pictures import Picture
from .readings import MeterTable
from .registry import PARTICLES, budget_of, current, find

if TYPE_CHECKING:
    from .patches import PatchProduct

#: Names of settings in earlier versions, and their present ones, by method.
_EARLIER: dict[str, dict[str, str]] = {
    "spheres": {"points": "point_set", "objects": "objects_digest"},
    "multipath": {"points": "point_set", "shot_rays": "shot"},
    "boxes": {"points": "point_set"},
}


def saved_task(
    path: PathLike,
    *,
    scene: Any = None,
    limits: Mapping[str, Any] | None = None,
    save: PathLike | Sequence[PathLike] = (),
    save_every: float | None = None,
    tone: str = "srgb",
    exposure: float | str = "auto",
) -> tuple[Task, Checkpoint]:
    """The task of a saved run, and its checkpoint.

    scene: its new place, if it has moved, or what it was if it was in memory. limits: the new budget, by the names of
    arguments; without one the rest of the saved budget is used. save: output files, for which those of the saved run
    are the default; a picture has only those given here. Raises :class:`CheckpointError` for a file that is damaged,
    :class:`OptionError` for limits and outputs that this kind of run does not have.
    """
    path, limits = checked_path(path, "a checkpoint"), dict(limits or {})
    about = limits.pop("particles", None)
    if path.is_file() and is_particle_file(path):
        if listed(save):
            raise OptionError(f"'{path}' is continued in place: leave out other outputs")
        return _particles(path, scene, limits, about)
    if about is not None:
        raise OptionError(f"'{path}' is no file of particles: a number of particles does not apply")
    saved = Checkpoint.read(path)
    saved.method = current(saved.method)
    saved.settings = _renamed(saved)
    method = find(saved.method)
    budget = budget_of(method, limits)
    known = saved.notes.get("product", {})
    product: Product[Any]
    source: Source
    if known.get("kind") == MeterTable.kind:
        source = SceneSource.at(saved.scene, scene)
        assert source.meters is not None
        product = MeterTable.noted(known, source.meters, listed(save), checkpoint=path, save_every=save_every)
    elif saved.method in PARTICLES or ("product" not in saved.notes and "lines" not in saved.notes):
        product = Picture.of(save, path, save_every, False, tone, exposure)
        source = SceneSource.at(saved.scene, scene)
    else:
        source, product = _patches(saved, scene, listed(save), path, save_every)
    return Task(source, method, product, {}, saved.seed, budget), saved


def _particles(path: Path, scene: Any, limits: dict[str, Any], particles: int | None) -> tuple[Task, Checkpoint]:
    from .particles import ParticleProduct

    product, saved = ParticleProduct.resumed(path, particles)
    method = find(saved.method)
    budget = budget_of(method, limits)
    if particles is not None:
        if budget.samples is not None:
            raise OptionError("paths and particles limit the same; give one of them")
        budget = product.budget(None, budget)
    return Task(SceneSource.at(saved.scene, scene), method, product, {}, saved.seed, budget), saved


def _patches(
    saved: Checkpoint, scene: Any, outputs: tuple[Path, ...], path: Path, save_every: float | None
) -> tuple[Source, PatchProduct[Any]]:
    """The source and the product of a run on patches. Raises :class:`CheckpointError` for other notes."""
    from etendue.radiosity import LineCasting, PartSource, PatchSource

    from .patches import FormFactorProduct, PatchDaylight, SolutionFiles, SolutionProduct

    made: PatchProduct[Any]
    try:
        if "product" in saved.notes:
            place, known = saved.scene, dict(saved.notes["product"])
        else:
            place, known = _of_earlier_version(saved.notes.pop("lines"))
        kind = known.pop("kind")
        common: dict[str, Any] = {"checkpoint": path, "save_every": save_every}
        if kind in (FormFactorProduct.kind, PatchDaylight.kind):
            saved_outputs = known.pop("outputs")
            files = outputs or tuple(map(Path, saved_outputs))
            product: Any = FormFactorProduct if kind == FormFactorProduct.kind else PatchDaylight
            made = product(**known, outputs=files, **common)
        else:
            before = SolutionFiles.from_dict(known.pop("outputs"))
            made = SolutionProduct(**known, outputs=before.renamed(outputs) if outputs else before, **common)
        source = (PartSource if saved.method == "boxes" else PatchSource).at(place, scene)
    except (KeyError, TypeError) as error:
        raise CheckpointError(
            f"the checkpoint does not contain its request ({describe(error)}); cast the lines again"
        ) from None
    made.check_files(issubclass(find(saved.method), LineCasting))
    return source, made


def _of_earlier_version(note: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The place and the product of a note as version 1 wrote it."""
    known = dict(note)
    is_factors = known["work"] == "form-factors"
    names = ("max_area", "mesh", "objects", "groups", "walls")
    place = {name: known[name] for name in names if known.get(name)} | {"source": known["source"]}
    outputs = known["outputs"]
    if is_factors:
        hierarchy = known.get("hierarchy")
        if hierarchy not in (None, True):
            place["objects"] = hierarchy
        chosen = known.get("estimator") or ("F1" if hierarchy is None else "F4")
        return place | _parameters(known), {"kind": "form factors", "estimator": chosen, "outputs": outputs}
    place |= {"for_light": True, "size": outputs.get("size"), "sensor": outputs.get("sensor", 0)}
    product = {name: known[name] for name in ("solver", "ambient", "bounces", "divide") if known.get(name) is not None}
    if product.get("solver") == "multipath":
        del product["solver"]
    return place | _parameters(known), {"kind": "solution", **product, "outputs": outputs}


def _renamed(saved: Checkpoint) -> str:
    """The settings with their present names."""
    settings: dict[str, Any] = json.loads(saved.settings)
    for name in _EARLIER.get(saved.method, {}).keys() & settings.keys():
        settings[_EARLIER[saved.method][name]] = settings.pop(name)
    return json.dumps(settings, sort_keys=True)


def _parameters(known: Mapping[str, Any]) -> dict[str, Any]:
    return {"parameters": known["parameters"]} if known.get("parameters") else {}
