"""A scene cut into boxes: paths go from box to box, and the particles are those of the whole scene."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.cluster.coherence import distinct_in_windows, lru_misses, visits
from support.workers import InProcess

from etendue.core import OptionError, UnsupportedError
from etendue.distributed import Cluster, ProcessPool
from etendue.engine import Budget, Job, Task
from etendue.particles import BoxGrid, Particles
from etendue.products import find, run_job
from etendue.products.particles import ParticleProduct
from etendue.scene import SceneSource, load, load_part, shape_boxes, unmerged


def traced(scene, cluster=None, boxes=None, paths=3000, method="particles", **settings):
    source, product = SceneSource(scene, merge=boxes is None), ParticleProduct(boxes=boxes)
    settings = settings or {"samples_per_pass": 1500}
    task = Task(source, find(method), product, settings, 4, Budget(samples=paths))
    return run_job(lambda: Job.open(task), cluster=cluster)


def equal(a: Particles, b: Particles) -> None:
    assert len(a) == len(b) > 1000
    for name in ("path", "bounce", "position", "direction", "power"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.parametrize(
    ("scene", "boxes"),
    [
        ("cornell-box", (2, 1, 1)),
        pytest.param("cornell-box", (2, 2, 2), marks=pytest.mark.slow),
        pytest.param("caustics", (2, 1, 2), marks=pytest.mark.slow),
    ],
)
def test_particles_of_boxes_are_those_of_the_whole(scene, boxes, tmp_path):
    whole = traced(scene)
    parts = traced(scene, Cluster(InProcess(tmp_path)), boxes=boxes)
    equal(parts.particles, whole.particles)
    assert parts.counters["paths"] == whole.counters["paths"] == 3000
    assert parts.traffic.received > 0
    assert {visit.box for visit in parts.traffic.visits} == {-1, *range(np.prod(boxes))}
    assert parts.traffic.loads == np.prod(boxes)  # each box once


def test_boxes_without_shapes_pass_paths_on(tmp_path):
    """A lamp that is no shape, in one of the two empty boxes."""
    scene: dict = {"type": "scene", "lamp": {"type": "point", "position": [1.0, -1.0, 0.0], "intensity": 1.0}}
    scene["eye"] = {"type": "perspective"}
    for name, place in (("a", -2.0), ("b", 2.0)):
        scene[name] = {"type": "sphere", "center": [place, place, 0.0], "radius": 1.9}
    options = {"paths": 9000, "samples_per_pass": 9000}
    parts = traced(scene, Cluster(InProcess(tmp_path)), boxes=(2, 2, 1), **options)
    equal(parts.particles, traced(scene, **options).particles)


_LAMP = '<emitter type="area"><rgb name="radiance" value="5"/></emitter>'
_SPHERE = '<shape type="sphere"{}><point name="center" x="{}" y="0" z="0"/><float name="radius" value="{}"/>{}</shape>'
_UNNAMED = f"""<scene version="3.0.0"><sensor type="perspective"/>
{_SPHERE.format(' id="shape 3"', -3, 1, "")}{_SPHERE.format("", 6, 1, "")}
{_SPHERE.format("", 0.5, 0.5, _LAMP)}{_SPHERE.format("", 5, 4.2, "")}</scene>"""


def test_boxes_of_a_file_whose_shapes_have_no_names(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(_UNNAMED)
    parts = traced(str(file), Cluster(InProcess(tmp_path / "workers")), boxes=(2, 1, 1))
    equal(parts.particles, traced(str(file)).particles)
    ids, bounds = shape_boxes(load(str(file), change=unmerged))
    assert sorted(ids) == ["shape 2", "shape 3", "shape 3 of the file", "shape 4"]
    near = {ids[k] for k in BoxGrid.even(bounds, (2, 1, 1)).touching(0, bounds)}
    assert near == {"shape 3", "shape 3 of the file", "shape 4"}


@pytest.mark.slow
def test_a_worker_that_dies_changes_nothing(tmp_path):
    whole = traced("cornell-box")
    parts = traced("cornell-box", Cluster(InProcess(tmp_path, losses=(2, 5, 9, 10))), boxes=(2, 1, 1))
    equal(parts.particles, whole.particles)


@pytest.mark.slow
def test_particles_of_boxes_in_processes(tmp_path):
    whole = traced("caustics")
    with Cluster(ProcessPool(2, threads=1)) as cluster:
        equal(traced("caustics", cluster, boxes=(2, 1, 1)).particles, whole.particles)
        # The same with workers that have the whole scene each.
        equal(traced("caustics", cluster).particles, whole.particles)


def test_a_part_has_the_shapes_of_its_box_only():
    whole = load("cornell-box", change=unmerged)
    ids, bounds = shape_boxes(whole)
    grid = BoxGrid.even(bounds, (2, 1, 1))
    wanted = {ids[k] for k in grid.touching(0, bounds)}
    assert 0 < len(wanted) < len(ids)
    part = load_part("cornell-box", wanted)
    lamps = {str(shape.id()) for shape in whole.scene.shapes() if shape.emitter() is not None}
    assert {str(shape.id()) for shape in part.scene.shapes()} == wanted | lamps


def test_boxes_and_their_numbers():
    bounds = np.array([[0.0, 0, 0, 4, 1, 1], [3, 0, 0, 4, 1, 1]])
    grid = BoxGrid.even(bounds, (4, 1, 1))
    assert len(grid) == 4
    np.testing.assert_array_equal(grid.of_points([[-9.0, 0, 0], [1, 0, 0], [3.5, 9, 9]]), [0, 1, 3])
    assert [list(grid.touching(box, bounds)) for box in range(4)] == [[0], [0], [0, 1], [0, 1]]
    with pytest.raises(OptionError, match="three whole numbers of boxes"):
        BoxGrid.even(bounds, (0, 1, 1))


@pytest.mark.slow
def test_what_cannot_be_divided_is_one_line(tmp_path):
    with pytest.raises(UnsupportedError, match="sends rays from around the whole scene"):
        traced("skylight", Cluster(InProcess(tmp_path)), boxes=(2, 1, 1))
    with pytest.raises(OptionError, match="'metropolis_particles' cannot be divided among workers"):
        traced("cornell-box", Cluster(InProcess(tmp_path)), method="metropolis_particles", bootstrap=1024)


def test_paths_in_strata_visit_boxes_together():
    grid = BoxGrid.even(shape_boxes(load("cornell-box", change=unmerged))[1], (4, 4, 4))
    found = {}
    for sampler in ("independent", "strata"):
        made = traced("cornell-box", paths=20_000, sampler=sampler, keep="first")
        found[sampler] = visits(made.particles, grid)
    assert distinct_in_windows(np.array([1, 1, 2, 3, 3, 3]), 3).tolist() == [2, 1]
    assert lru_misses([1, 2, 1, 3, 2], 2) == 4
    windows = {name: distinct_in_windows(boxes, 64).mean() for name, boxes in found.items()}
    assert windows["strata"] < windows["independent"]
