"""Point-like lamps that lie in surfaces are named; others are not."""

import logging

import mitsuba as mi
import numpy as np
import pytest

import etendue
from etendue.scene import lamps_in_surfaces, load, space


@pytest.fixture(autouse=True)
def _said_anew():
    space.warn_once.cache_clear()


def room(lamp, place, turn=0.0, scale=1.0, where=(0.0, 0.0, 0.0), **floor):
    """A floor, a cube and a ball, turned, scaled and moved together with the lamp."""
    frame = mi.ScalarTransform4d().translate(where).rotate([0.6, 0, 0.8], turn).scale(scale)
    x, y, z = np.asarray(frame @ mi.ScalarPoint3d(place)).ravel()
    shapes = {
        "floor": {"type": "rectangle", "to_world": frame @ mi.ScalarTransform4d().scale(3)} | floor,
        "box": {"type": "cube", "to_world": frame @ mi.ScalarTransform4d().translate([1, 1, 1.5]).scale(0.5)},
        "ball": {
            "type": "sphere",
            "center": [0, 0, 0],
            "to_world": frame @ mi.ScalarTransform4d().translate([0, 0, 3]),
        },
    }
    it = {"type": lamp}
    if lamp == "point":
        it["position"] = [x, y, z]
    else:
        it["to_world"] = mi.ScalarTransform4d().translate([x, y, z])
    if lamp == "projector":
        it["irradiance"] = {"type": "rgb", "value": 1.0}
    camera = {"type": "perspective", "to_world": mi.ScalarTransform4d().translate(where)}
    return {"type": "scene", "camera": camera, "lamp": it} | shapes


INSIDE = {"floor": (0.2, 0.4, 0.0), "box": (1.0, 0.7, 1.0), "ball": (0.0, 0.6, 2.2)}
OUTSIDE = [(0.2, 0.4, 0.01), (0.2, 0.4, -0.01), (1.0, 1.0, 1.5), (0.0, 0.0, 3.0), (0.0, 0.61, 2.2), (4.0, 0.0, 0.0)]


@pytest.mark.parametrize("lamp", ["point", "spot", "projector"])
@pytest.mark.parametrize("frame", [{}, {"turn": 33.0}, {"turn": 70.0, "scale": 0.01}, {"where": (300.0, 20.0, -70.0)}])
def test_lamps_in_surfaces(lamp, frame, caplog):
    for shape, place in INSIDE.items():
        with caplog.at_level(logging.WARNING, "etendue"):
            caplog.clear()
            load(room(lamp, place, **frame))
        (line,) = (r.message for r in caplog.records if "lies in the surface" in r.message)
        assert f"emitter 'lamp' of type '{lamp}' lies in the surface of shape '{shape}'" in line
        assert "\n" not in line
    for place in OUTSIDE:
        assert lamps_in_surfaces(load(room(lamp, place, **frame)).scene) == []


def test_surfaces_that_hide_nothing():
    assert lamps_in_surfaces(load(room("point", INSIDE["floor"], bsdf={"type": "null"})).scene) == []


def test_lamps_in_instances():
    scene = room("point", (5.0, 5.0, 6.0))
    scene["group"] = {"type": "shapegroup", "part": {"type": "cube"}}
    place = mi.ScalarTransform4d().translate([5, 5, 5])
    scene["instance"] = {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}
    ((_, shape),) = lamps_in_surfaces(load(scene).scene)
    assert shape.id() == "instance"


def panel(kind, distance, turn, size=0.8, **more):
    """A lamp parallel to a ceiling, with other things about."""
    frame = mi.ScalarTransform4d().translate([3, 2, 1]).rotate([0.6, 0, 0.8], turn)
    down = mi.ScalarTransform4d().rotate([1, 0, 0], 180)
    place = mi.ScalarTransform4d().translate([0, 0, 2 - distance])
    if kind == "cube":  # on its underside
        place = mi.ScalarTransform4d().translate([0, 0, 2 - distance - size])
    lamp = {"type": kind, "to_world": frame @ place @ down.scale(size), "emitter": {"type": "area"}} | more
    ceiling = {"type": "rectangle", "to_world": frame @ mi.ScalarTransform4d().translate([0, 0, 2]) @ down.scale(3)}
    return {"type": "scene", "camera": {"type": "perspective"}, "lamp": lamp, "ceiling": ceiling}


@pytest.mark.parametrize("turn", [12.0, 25.0, 61.0])  # where rounding decides what a ray hits
def test_flat_lamps_in_the_plane_of_a_surface(turn):
    for kind in ("rectangle", "disk"):
        ((lamp, remark),) = load(panel(kind, 0.0, turn)).remarks
        assert lamp == "emitter 'emitter' of type 'area' on shape 'lamp'"
        assert "shape 'ceiling' of type 'rectangle'" in remark
        assert load(panel(kind, 0.002, turn)).remarks == ()
    assert load(panel("cube", 0.0, turn)).remarks == ()  # one of six sides touches the ceiling
    assert load(panel("sphere", 0.8, turn)).remarks == ()


def test_merged_meshes_are_named(tmp_path, caplog):
    scene = room("point", INSIDE["floor"])
    for name in ("floor", "wall"):
        mi.load_dict({"type": "rectangle"}).write_ply(str(tmp_path / f"{name}.ply"))
        scene[name] = {"type": "ply", "filename": str(tmp_path / f"{name}.ply"), "bsdf": {"type": "diffuse"}}
    scene["wall"]["to_world"] = mi.ScalarTransform4d().translate([0, 0, 8])
    with caplog.at_level(logging.WARNING, "etendue"):
        ((lamp, remark),) = load(scene).remarks
    assert lamp == "emitter 'lamp' of type 'point'"
    assert "shape 'floor' of type 'ply'" in remark
    assert any(remark in r.message for r in caplog.records)


def test_a_check_names_the_lamp_and_the_surface():
    report = etendue.check(room("spot", INSIDE["floor"]), quick=True)
    (row,) = (f for f in report.findings if f.test == "placement")
    assert (row.component, row.verdict) == ("emitter 'lamp' of type 'spot'", "warn")
    assert "shape 'floor'" in row.meaning
