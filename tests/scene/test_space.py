"""Scenes of every size and place are rendered alike: far from the origin, and of another size than a metre."""

from __future__ import annotations

import logging

import mitsuba as mi
import numpy as np
import pytest
from support.running import prepared, run
from support.scenes import diffuse, rgb

from etendue import render, resume
from etendue.scene import Camera, RenderSpace, described_sensor, load, space
from etendue.transport import TransportFunctions

FAR = np.array([1.0, -0.5, 0.3])


def place(matrix, size, away):
    matrix = np.array(matrix, dtype=float).reshape(4, 4)
    move = np.diag([size, size, size, 1.0])
    move[:3, 3] = away * FAR
    return mi.ScalarTransform4d(move @ matrix)


def rigid(frame, size, away):
    matrix = np.array(frame.matrix, dtype=float).reshape(4, 4)
    matrix[:3, 3] = size * matrix[:3, 3] + away * FAR
    return mi.ScalarTransform4d(matrix)


def room(size=1.0, away=0.0, sensor="thinlens"):
    """A room with all that has a place or a length, ``size`` as large and ``away`` from the origin."""
    turn = mi.ScalarTransform4d()

    def wall(transform, *colour, bsdf=None):
        return {"type": "rectangle", "to_world": place(transform.matrix, size, away), "bsdf": bsdf or diffuse(*colour)}

    def at(*point):
        return list(size * np.array(point) + away * FAR)

    lens = {"aperture_radius": 0.02 * size, "focus_distance": 3.0 * size} if sensor == "thinlens" else {}
    view = rigid(turn.look_at([0, 0, 3.8], [0, 0, 0], [0, 1, 0]), size, away)
    if sensor == "orthographic":
        view = view @ mi.ScalarTransform4d().scale([1.3 * size, 1.3 * size, 1.0])
    bump = {
        "type": "bumpmap",
        "bump": {"type": "bitmap", "bitmap": mi.Bitmap(heights()), "raw": True},
        "scale": 0.1 * size,
        "bsdf": diffuse(0.6, 0.6, 0.6),
    }
    down = turn.look_at([0.5, 0.9, 0.5], [0.3, -1, 0], [1, 0, 0])
    return {
        "type": "scene",
        "sensor": {
            "type": sensor,
            "to_world": view,
            "near_clip": 0.1 * size,
            "far_clip": 100.0 * size,
            "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
        }
        | lens
        | ({"fov": 40.0} if sensor in ("perspective", "thinlens") else {}),
        "floor": wall(turn.rotate([1, 0, 0], -90).translate([0, 0, -1]), bsdf=bump),
        "ceiling": wall(turn.rotate([1, 0, 0], 90).translate([0, 0, -1]), 0.7, 0.7, 0.7),
        "back": wall(turn.translate([0, 0, -1]), 0.7, 0.7, 0.7),
        "left": wall(turn.rotate([0, 1, 0], 90).translate([0, 0, -1]), 0.6, 0.1, 0.1),
        "right": wall(turn.rotate([0, 1, 0], -90).translate([0, 0, -1]), 0.1, 0.6, 0.1),
        "ball": {
            "type": "sphere",
            "center": at(-0.4, -0.6, 0.2),
            "radius": 0.35 * size,
            "bsdf": diffuse(0.5, 0.5, 0.7),
        },
        "column": {
            "type": "cylinder",
            "p0": at(0.5, -1, -0.3),
            "p1": at(0.5, 0.2, -0.3),
            "radius": 0.2 * size,
            "bsdf": {"type": "twosided", "bsdf": diffuse(0.5, 0.5, 0.5)},
        },
        "lamp": wall(turn.translate([0, 0.98, 0]).rotate([1, 0, 0], 90).scale(0.25), 0, 0, 0)
        | {"emitter": {"type": "area", "radiance": rgb(9.0, 8.0, 7.0)}},
        "bulb": {"type": "point", "position": at(-0.6, 0.5, 0.6), "intensity": rgb(*(size**2 * np.ones(3)))},
        "candle": {"type": "point", "position": at(0.3, 0.2, 0.5), "intensity": rgb(0, 0.1 * size**2, 0)},
        "spot": {"type": "spot", "to_world": rigid(down, size, away), "intensity": 2.0 * size**2, "cutoff_angle": 30.0},
        "beam": {"type": "projector", "to_world": rigid(down, size, away), "fov": 30.0, "scale": 0.5 * size**2},
        "sky": {"type": "constant", "radiance": 0.05},
    }


def heights():
    x, y = np.meshgrid(np.linspace(0, 4 * np.pi, 32), np.linspace(0, 4 * np.pi, 32))
    return (0.5 + 0.25 * (np.sin(x) + np.sin(y))).astype(np.float32)[..., None]


def layers(scene, method="path", samples=64, **settings):
    measured = run(load(scene), method, 1, samples, aovs=True, max_depth=5, **settings).measurement
    return {name: measured.mean(name) for name in measured.sums}


def offset(method, size, away, seed=1):
    """Mean difference of a room from that of size 1, over its mean: of the picture as a whole, and of its pixels;
    ``seed``: of that room."""
    expected, found = layers(room(), method)["image"], layers(room(size, away), method, seed=seed)["image"]
    return abs(found.mean() / expected.mean() - 1), np.abs(found - expected).mean() / expected.mean()


@pytest.mark.parametrize(("size", "away"), [(1e-3, 2.0), (1e4, 0.0)])
def test_size_and_place_do_not_show(size, away):
    # The same paths, so that there is no noise but of those that rounding leads elsewhere. Offsets that were left
    # alone changed the mean by 1 % or more, and the pixels by 2 %.
    assert max(offset("path", size, away)) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("size", "away"), [(1e-3, 0.0), (1e-3, 2.0), (1e4, 0.0), (1.0, 2e3)])
def test_size_and_place_do_not_show_when_merging(size, away):
    whole, pixels = offset("vcm", size, away)
    # Other paths differ by all of the noise, these by what other numbers for the same photons make.
    _, noise = offset("vcm", 1.0, 0.0, seed=2)
    assert whole < 1e-3 and pixels < 0.15 * noise
    problem = load(room(size, away))
    method = prepared(problem, "vcm", radius=0.02 * size, radius_unit="absolute")
    assert method.radius(0) / problem.space.scale == pytest.approx(0.02 * size)


def moved(size=1e-3, away=2.0, **options):
    """Problems of the room of size 1, and of another one, which is rendered in a space of its own."""
    plain, problem = load(room(**options)), load(room(size, away, **options))
    assert plain.space.is_own and not problem.space.is_own
    return plain, problem


@pytest.mark.parametrize("sensor", ["perspective", "thinlens", "orthographic", "spherical"])
def test_sensors_see_the_same(sensor):
    size, away = 1e-3, 2.0
    plain, problem = moved(size, away, sensor=sensor)
    film, lens = np.random.default_rng(1).random((2, 2, 64), dtype=np.float32)
    expected, found = (p.sensor.sample_ray(0.0, 0.5, mi.Point2f(film), mi.Point2f(lens))[0] for p in (plain, problem))
    np.testing.assert_allclose(found.d, expected.d, atol=1e-6)
    origin = problem.space.to_scene(np.array(found.o).T) - away * FAR
    np.testing.assert_allclose(origin, size * np.array(expected.o).T, atol=1e-6 * size)
    np.testing.assert_allclose(np.array(found.maxt) / problem.space.scale, size * np.array(expected.maxt), rtol=1e-6)


def test_lights_light_the_same():
    size, away = 1e-3, 2.0
    plain, problem = moved(size, away)
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (3, 64))
    u = mi.Point2f(np.random.default_rng(2).random((2, 64), dtype=np.float32))
    there = problem.space.from_scene(size * points.T + away * FAR).T
    lit = 0
    for one, other in zip(plain.scene.emitters(), problem.scene.emitters(), strict=True):
        values = []
        for emitter, p in ((one, points), (other, there)):
            it = mi.Interaction3f(0.0, 0.0, mi.Color0f(), mi.Point3f(np.float32(p)))
            values.append(np.array(emitter.sample_direction(it, u)[1]))
        np.testing.assert_allclose(values[1], values[0], rtol=1e-4, atol=1e-6)
        lit += values[0].any()
    assert lit == 6


SHAPES = """
<sensor type="perspective"/><emitter type="constant"/>
<shape type="shapegroup" id="group"><shape type="cylinder"><float name="radius" value="0.1"/></shape></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><translate x="500000.25" y="4000000"/></transform>
</shape>
<shape type="ply"><string name="filename" value="mesh.ply"/>
<transform name="to_world"><scale value="0.5"/><translate x="500002" y="4000001.125"/></transform></shape>
<shape type="cube"><transform name="to_world"><translate x="499999" y="4000000"/></transform></shape>
<shape type="sphere"><point name="center" x="500001.03125" y="3999998" z="1"/><float name="radius" value="0.25"/>
</shape>
<shape type="sphere"><point name="center" x="1.03125" y="-2" z="1"/><float name="radius" value="0.25"/>
<transform name="to_world"><scale value="2"/><translate x="500000" y="4000000"/></transform></shape>
"""
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0.5
3 0 1 2
"""


def written(tmp_path, body):
    (tmp_path / "mesh.ply").write_text(PLY)
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


def test_shapes_lie_where_they_were_put(tmp_path, caplog):
    """To a thousandth of what single precision holds out there, which is 1/32 and 1/4."""
    with caplog.at_level(logging.INFO, "etendue"):
        problem = load(written(tmp_path, SHAPES))
    assert [r.levelname for r in caplog.records] == ["INFO"] and "rays would start" in caplog.text
    boxes = sorted(
        np.round(problem.space.to_scene([s.bbox().min, s.bbox().max]) - [5e5, 4e6, 0], 5).ravel().tolist()
        for s in problem.scene.shapes()
    )
    assert boxes == sorted(
        [
            [0.15, -0.1, 0.0, 0.35, 0.1, 1.0],
            [2.0, 1.125, 0.0, 2.5, 1.625, 0.25],
            [-2.0, -1.0, -1.0, 0.0, 1.0, 1.0],
            [0.78125, -2.25, 0.75, 1.28125, -1.75, 1.25],
            [1.5625, -4.5, 1.5, 2.5625, -3.5, 2.5],
        ]
    )


def test_a_light_that_is_given_by_its_spectrum(tmp_path):
    body = """<sensor type="perspective"/><shape type="sphere"><float name="radius" value="{0}"/></shape>
    <emitter type="point"><spectrum name="intensity" value="400:1, 550:3, 700:2"/></emitter>"""
    near, far = (load(written(tmp_path, body.format(size))) for size in (1.0, 1e-3))
    it = mi.Interaction3f(0.0, 0.0, mi.Color0f(), mi.Point3f(0.0, 0.5, 0.0))
    expected = near.scene.emitters()[0].sample_direction(it, mi.Point2f(0.5))[1]
    it.p = mi.Point3f(*map(float, far.space.from_scene([0.0, 0.5e-3, 0.0])))
    np.testing.assert_allclose(
        far.scene.emitters()[0].sample_direction(it, mi.Point2f(0.5))[1], 1e6 * expected, rtol=1e-5
    )


def test_layers_and_resuming_in_the_units_of_the_scene(tmp_path):
    size = 1e-3
    path = written(
        tmp_path,
        f"""<sensor type="perspective"><transform name="to_world"><translate x="{1000 * size}" z="{-3 * size}"/>
        </transform><float name="near_clip" value="{0.1 * size}"/><film type="hdrfilm">
        <integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
        <emitter type="constant"/><shape type="rectangle"><transform name="to_world"><scale value="{4 * size}"/>
        <translate x="{1000 * size}"/></transform></shape>""",
    )
    whole = render(path, "path", spp=8, samples_per_pass=4, aovs=True)
    render(path, "path", spp=4, samples_per_pass=4, aovs=True, checkpoint=tmp_path / "half.ckpt")
    resumed = resume(tmp_path / "half.ckpt", spp=8)
    assert np.array_equal(resumed.image, whole.image)
    depth = whole.layers["depth"]
    assert depth.min() == pytest.approx(2.9 * size, rel=0.01) and depth.max() < 3.3 * size  # from the near plane on


def test_a_camera_is_put_where_it_is_asked_to_be():
    problem = load(room(1e-3, 2.0), camera=Camera([2.0, -1.0, 0.602], [2.0, -1.0, 0.6]))
    place = problem.space.to_scene(np.array(problem.sensor.world_transform().translation()).ravel())
    np.testing.assert_allclose(place, [2.0, -1.0, 0.602], atol=1e-9)
    told = np.array(described_sensor(problem)["to_world"])  # in the metadata of pictures
    np.testing.assert_allclose(told[:3, 3], [2.0, -1.0, 0.602], atol=1e-8)


def test_a_camera_far_from_the_origin():
    """Single precision holds quarters there: the place, and the direction to a near target, are held in double."""
    x = 4e6
    origin, target = (x * FAR + offset for offset in ([0.3, 0.1, 0.8], [0.1, 0.2, 0.1]))
    problem = load(room(1.0, x), camera=Camera(origin.tolist(), target.tolist()))
    world = problem.sensor.world_transform()
    place = problem.space.to_scene(np.array(world.translation()).ravel())
    np.testing.assert_allclose(place, origin, rtol=0, atol=1e-5)
    ahead = np.array(world @ mi.Vector3f(0, 0, 1)).ravel()
    np.testing.assert_allclose(ahead / np.linalg.norm(ahead), np.array([-0.2, 0.1, -0.7]) / np.sqrt(0.54), atol=1e-5)


@pytest.fixture(autouse=True)
def _said_anew():
    """What is said once is said in each test."""
    space.warn_once.cache_clear()


def test_a_room_in_a_large_building():
    """A box of 2 m at 100 m from the origin, where rays start 9 mm off its walls, in a building of 220 m."""

    hall = {"type": "cube", "to_world": mi.ScalarTransform4d().scale(110.0), "flip_normals": True}
    assert load(room() | {"hall": hall}).space.is_own
    problem = load(room(1.0, 100.0) | {"hall": hall})
    np.testing.assert_allclose(problem.space.centre, 100.0 * FAR + [0.0, 0.0, 3.8], atol=1e-4)
    assert problem.space.scale == 1.0


@pytest.mark.parametrize("name", ["caustics", "cornell-box", "skylight", "stage"])
def test_what_is_of_common_size_is_left_alone(name):
    assert load(name).space == RenderSpace()


@pytest.mark.parametrize(("size", "away"), [(0.1, 0.0), (100.0, 0.0), (1.0, 10.0)])
def test_rooms_of_common_size_and_place_are_left_alone(size, away):
    assert load(room(size, away)).space.is_own


def test_what_cannot_be_moved_is_said(caplog):
    far = room(1.0, 2e3)
    loaded = mi.load_dict(far)
    built = far | {"ball": mi.load_dict(far["ball"])}
    text = "rays start up to 0.18 off surfaces, which changes the light"
    for source, why in (
        (loaded, "a loaded scene is not moved"),
        (built, "type 'sphere' is not moved, because it is built"),
    ):
        caplog.clear()
        assert load(source).space.is_own
        assert text in caplog.text and why in caplog.text and "near the origin" in caplog.text
    TransportFunctions(loaded)  # which has been said
    space.warn_once.cache_clear()
    caplog.clear()
    TransportFunctions(loaded)
    assert text in caplog.text
    caplog.clear()
    load(room(1.0, 0.0) | {"ball": built["ball"]})
    load(loaded)  # this has been said
    assert not caplog.text


def test_what_single_precision_does_not_hold_is_said(tmp_path, caplog):
    body = """<sensor type="perspective"/><emitter type="constant"/><shape type="ply"><string name="filename"
    value="mesh.ply"/><transform name="to_world"><translate x="{}"/></transform></shape>"""
    mesh = PLY.replace("0 0 0\n1 0 0\n0 1 0.5", "500000 0 0\n500001 0 0\n500000 1 0.5")
    path = written(tmp_path, body.format(500000))
    (tmp_path / "mesh.ply").write_text(mesh)
    load(path)
    assert "single precision rounds coordinates of 5e+05 to multiples of 0.06" in caplog.text
    caplog.clear()
    load(written(tmp_path, body.format(500000)))
    assert not caplog.text
    far = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([5e5, 0, 0])}
    load({"type": "scene", "sensor": {"type": "perspective"}, "sky": {"type": "constant"}, "cube": far})
    assert "give transforms as mi.ScalarTransform4d" in caplog.text
