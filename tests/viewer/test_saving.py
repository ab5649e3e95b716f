"""What a session saves repeats what it shows. The sessions are stand-ins that render nothing."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

from etendue.cli.experiments.run_file import RunFile
from etendue.core import OptionError
from etendue.scene import bundled_scene, load, scene_xml
from etendue.viewer import Asked
from etendue.viewer.camera import Pose, place
from etendue.viewer.saving import save


def opened(scene, folder, **asked):
    """A session in which a scene is open."""
    wish = Asked(scene=scene, folder=folder, **asked)
    problem = wish.load(lambda state: None)
    pose = Pose.of(problem)
    return SimpleNamespace(asked=wish, problem=problem, pose=pose, home=pose, main=None, panels={}, saved={})


def written(folder, name="own.xml", **sensor):
    """The file of a scene that differs from a bundled one by its sensor."""
    description = bundled_scene("cornell-box").build()
    description["sensor"] |= sensor
    path = folder / name
    path.write_text(scene_xml(description), "utf-8")
    return path


def corner_rays(problem):
    """(2, 3) origins and directions of the rays through two places of the picture."""
    rays = [problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(*p), mi.Point2f(0.5))[0] for p in ((0.1, 0.2), (1.0, 1.0))]
    return [problem.space.to_scene([np.ravel(ray.o) for ray in rays]), np.array([np.ravel(ray.d) for ray in rays])]


def repeated(session, name="view.toml"):
    """(run file, what it loads) of a session whose camera is moved first."""
    session.pose = session.pose.orbited(0.3, 0.1).zoomed(0.2)
    place(session.problem.sensor, session.pose)
    run = RunFile.read(save(session, "run", name))
    found = load(run.scene, size=run.size, sensor=run.sensor, camera=run.camera)
    assert found.size == session.problem.size
    for got, wanted in zip(corner_rays(found), corner_rays(session.problem), strict=True):
        np.testing.assert_allclose(got, wanted, atol=2e-4)
    return run


@pytest.mark.parametrize(
    ("name", "sensor", "beside"),
    [
        ("own.xml", {}, False),
        ("view-scene.xml", {}, False),  # the name that the scene of another run file has
        ("own.xml", {"type": "spherical"}, True),  # which the camera of a run file cannot move
        ("own.xml", {"type": "orthographic"}, True),
    ],
)
def test_a_run_file_has_the_camera(tmp_path, name, sensor, beside):
    if sensor:
        film = bundled_scene("cornell-box").build()["sensor"]
        kept = {key: film[key] for key in ("to_world", "film", "sampler")}
        description = bundled_scene("cornell-box").build() | {"sensor": kept | sensor}
        path = tmp_path / name
        path.write_text(scene_xml(description), "utf-8")
    else:
        path = written(tmp_path, name)
    session = opened(path, tmp_path, size=(32, 24))
    run = repeated(session, "moved.toml")
    assert (run.scene != path) == beside and (run.camera is None) == beside


@pytest.mark.parametrize("sensor", [0, 1])
def test_a_run_file_has_the_chosen_camera_of_a_dictionary(sensor, tmp_path):
    description = bundled_scene("cornell-box").build()
    perspective = description.pop("sensor")
    spherical = {key: perspective[key] for key in ("to_world", "film", "sampler")} | {"type": "spherical"}
    description |= {"first": spherical, "second": perspective}
    run = repeated(opened(description, tmp_path, size=(32, 24), sensor=sensor))
    assert run.sensor == sensor and run.camera is None


def test_a_camera_that_is_not_moved_is_that_of_the_file(tmp_path):
    path = written(tmp_path)
    run = RunFile.read(save(opened(path, tmp_path, size=(32, 24)), "run", "still.toml"))
    assert run.scene == path and run.camera is None and run.budget.samples > 0


def test_a_cropped_film_keeps_its_window(tmp_path):
    film = {"type": "hdrfilm", "width": 80, "height": 60}
    film |= {"crop_offset_x": 20, "crop_offset_y": 10, "crop_width": 40, "crop_height": 30}
    session = opened(written(tmp_path, film=film), tmp_path)
    assert session.problem.size == (40, 30)
    assert repeated(session).size == (80, 60)
    session = opened(written(tmp_path, film=film), tmp_path, size=(160, 120))
    assert session.problem.size == (80, 60)


def test_the_size_that_is_asked_for_is_in_the_scene(tmp_path):
    session = opened("cornell-box", tmp_path, size=(40, 32))
    found = load(save(session, "scene", "small.xml"))
    assert found.size == (40, 32)
    whole = load(save(replace_size(session, None), "scene", "whole.xml"))
    assert whole.size == load("cornell-box").size


def replace_size(session, size):
    session.asked = replace(session.asked, size=size)
    return session


def test_the_scene_that_is_open_is_not_written_over(tmp_path):
    path = written(tmp_path, "view-scene.xml")
    before = path.read_bytes()
    session = opened(path, tmp_path, size=(16, 12))
    for what, name in (("scene", "view-scene.xml"), ("run", "view.toml")):
        session.panels = {"edited": SimpleNamespace(is_edited=lambda: True, describe=lambda state: None)}
        with pytest.raises(OptionError, match=r"'view-scene.xml' is the scene that is open"):
            save(session, what, name)
    assert path.read_bytes() == before and not Path(tmp_path / "view.toml").exists()
