"""Tests of all components of a scene."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError, SceneError, UnsupportedError
from etendue.scene import Problem, Source, graph, is_model, load, use_variant_of
from etendue.surfaces import is_mesh_file

from .bsdfs import check_bsdf
from .emitters import check_emitter
from .meshes import check_mesh
from .rays import check_ray_casting
from .report import Finding, Report
from .sensors import check_sensor
from .textures import check_textures

if TYPE_CHECKING:
    import mitsuba as mi

#: Generic names of a material: keys of a shape's dictionary, and Mitsuba's default.
_GENERIC = ("bsdf", "material", "mesh_bsdf", "default")
#: Probability that a scene with correct samplers fails by chance.
_LEVEL = 1e-3


def check(
    scene: Source,
    *,
    quick: bool = False,
    sensor: int = 0,
    parameters: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    seed: int = 0,
    orient: str | None = None,
    save: Path | None = None,
) -> Report:
    """Test materials, textures, emitters, sensors and ray casting of a scene, and the faces of a model; of other mesh
    files the faces alone (:func:`check_mesh`).

    ``scene`` and ``parameters`` are those of :func:`etendue.render`. ``quick`` uses fewer samples and may miss small
    faults. ``variants``: other Mitsuba variants for the test of ray casting, such as ``scalar_rgb``. The same
    ``seed`` gives the same report. ``orient``, ``save``: of a mesh file or model, see :func:`check_mesh`. Unsupported
    scenes fail the test ``supported``, broken ones the test ``broken``.

    Raises :class:`SceneError` for a scene that cannot be loaded, :class:`OptionError` for an invalid sensor.
    """
    use_variant_of(scene)
    began = time.perf_counter()
    path = Path(scene) if isinstance(scene, (str, os.PathLike)) else None
    if path is not None and is_mesh_file(path):
        return Report(str(path), tuple(check_mesh(path, seed, orient, save)), time.perf_counter() - began)
    has_faces = path is not None and is_model(path)
    if not has_faces and (orient is not None or save is not None):
        raise OptionError("orient and save are for mesh files; the faces of a scene in XML are turned in its own files")
    problem, rows = _load(scene, sensor, parameters)
    loaded = problem.scene
    broken = any(row.test == "broken" for row in rows)  # its geometry may be invalid
    place = None if broken else loaded
    materials = list(_materials(loaded))
    emitters, sensors = loaded.emitters(), loaded.sensors()
    level = _LEVEL / max(len(materials) + len(emitters), 1)
    for name, bsdf, shape in materials:
        rows += check_textures(bsdf, name, scene=place, shape=None if broken else shape, seed=seed)
        rows += check_bsdf(
            bsdf, name, scene=place, shape=None if broken else shape, quick=quick, seed=seed, level=level
        )
    if not broken:
        for emitter in emitters:
            name = graph.described_emitter(emitter)
            rows += check_emitter(emitter, loaded, name, quick=quick, seed=seed, level=level)
        rows += [Finding(name, "placement", "warn", 0.0, 0.0, f"it {remark}") for name, remark in problem.remarks]
        for item in sensors:
            rows += check_sensor(item, loaded, seed=seed)
        rows += check_ray_casting(loaded, variants=variants, quick=quick, seed=seed)
    if path is not None and has_faces:
        rows += check_mesh(path, seed, orient, save)
    return Report(problem.source, tuple(rows), time.perf_counter() - began)


def _load(scene: Source, sensor: int, parameters: Mapping[str, Any] | None) -> tuple[Problem, list[Finding]]:
    """The scene, and the finding whether it is supported. Raises :class:`SceneError` if it cannot be loaded."""
    try:
        problem = load(scene, sensor=sensor, parameters=parameters)
    except SceneError as error:
        problem = load(scene, sensor=sensor, parameters=parameters, check=False)
        test = "supported" if isinstance(error, UnsupportedError) else "broken"
        return problem, [Finding("scene", test, "fail", 1.0, 0.0, str(error))]
    return problem, [Finding("scene", "supported", "pass", 0.0, 0.0, "every method can render it")]


def _materials(scene: mi.Scene) -> Iterator[tuple[str, mi.BSDF, mi.Shape]]:
    """(name, material, a shape with it) for each material of the shapes."""
    seen: list[mi.BSDF] = []
    for shape in graph.shapes(scene):
        bsdf = shape.bsdf()
        if bsdf is None or any(bsdf is other for other in seen):
            continue
        seen.append(bsdf)
        name = graph.describe(bsdf, "material")
        if bsdf.id() in _GENERIC or f"'{bsdf.id()}'" not in name:
            name = f"material of type '{graph.plugin_name(bsdf)}' on {graph.short(shape)}"
        yield name, bsdf, shape
