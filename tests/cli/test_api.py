"""The Python door on a bundled scene, small."""

from __future__ import annotations

import re
import tempfile
import threading
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from support.patches import cube
from support.tables import thinned
from support.tasks import rendering as picture

import etendue
from etendue import film, methods
from etendue.core import CheckpointError, OptionError, OutputError, Replica, SceneError
from etendue.engine import Budget, Job, RunError, RunResult
from etendue.products import Picture

SMALL = {"size": (16, 12), "samples_per_pass": 2}


def test_render_returns_image_layers_and_metadata(tmp_path):
    rendering = etendue.render("cornell-box", "path", spp=6, seed=3, max_depth=4, **SMALL)
    assert rendering.image.shape == (12, 16, 3)
    assert rendering.image.dtype == np.float32
    assert np.isfinite(rendering.image).all()
    assert re.fullmatch(r"<etendue.Rendering path 16x12, 6 spp, \d+\.\d s>", repr(rendering))
    assert rendering.image.mean() > 0.01
    m = rendering.metadata
    assert (m["method"], m["seed"], m["passes"], m["samples"]) == ("path", 3, 3, 6)
    assert m["settings"]["max_depth"] == 4
    assert m["rays"] > 16 * 12 * 6
    assert m["seconds"] > 0
    assert m["nonfinite"] == 0
    assert m["versions"]["mitsuba"] == mi.__version__
    assert m["versions"]["variant"] == mi.variant()
    rendering.save(tmp_path / "a.exr")
    rendering.save(tmp_path / "a.png")
    read = film.read_exr(tmp_path / "a.exr")
    assert np.array_equal(read.image, rendering.image)
    assert read.metadata["settings"] == m["settings"]
    assert read.metadata["fingerprint"] == m["fingerprint"]
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("kind", ["dict", "scene"])
def test_scenes_in_memory(kind, tmp_path):
    scene = mi.cornell_box()
    scene["sensor"]["film"].update({"width": 8, "height": 8})
    checkpoint = tmp_path / "a"
    given = scene if kind == "dict" else mi.load_dict(scene)
    rendering = etendue.render(given, "path", spp=2, samples_per_pass=1, checkpoint=checkpoint)
    assert rendering.image.shape == (8, 8, 3)
    with pytest.raises(CheckpointError, match="from a scene in memory"):
        etendue.resume(checkpoint, spp=4)
    assert etendue.resume(checkpoint, spp=4, scene=given).metadata["passes"] == 4


def test_without_a_budget_the_scene_decides():
    scene = mi.cornell_box()
    scene["sensor"]["film"].update({"width": 8, "height": 8})
    scene["sensor"]["sampler"]["sample_count"] = 7
    scene["integrator"]["max_depth"] = 3
    rendering = etendue.render(scene, "path")
    assert rendering.metadata["samples"] == 7
    assert rendering.metadata["settings"]["max_depth"] == 3


def test_the_scenes_own_integrator_gives_settings_that_were_not_given(caplog):
    scene = mi.cornell_box()
    scene["sensor"]["film"].update({"width": 8, "height": 8})
    scene["integrator"] = {"type": "path", "max_depth": 5, "rr_depth": 3, "strength": 2.0}
    settings = etendue.render(scene, "path", spp=1, rr_depth=2).metadata["settings"]
    assert (settings["max_depth"], settings["rr_depth"]) == (5, 2)
    assert "'strength' of the scene's integrator 'path' is not supported" in caplog.text
    assert etendue.render(scene, "light", spp=1).metadata["settings"]["rr_depth"] != 3


@pytest.mark.parametrize(
    ("named", "method"), [("bpt", "bpt"), ("light", "light"), ("path", "auto"), ("volpath", "auto"), (None, "auto")]
)
def test_without_a_method_the_scenes_integrator_is_taken(named, method, caplog):
    caplog.set_level("INFO")
    scene = mi.cornell_box()
    scene["sensor"]["film"].update({"width": 8, "height": 8})
    del scene["integrator"]
    if named is not None:
        scene["integrator"] = {"type": named, "max_depth": 3}
    metadata = etendue.render(scene, spp=1).metadata
    assert metadata["method"] == method
    assert metadata["settings"]["max_depth"] == (-1 if named is None else 3)
    assert (f"the scene names the integrator '{named}'" in caplog.text) == (named in ("path", "volpath"))


def test_samples_of_a_pass_add_up_to_the_budget():
    rendering = etendue.render("cornell-box", "path", spp=20, size=(8, 8))
    assert rendering.metadata["samples"] == 20


@pytest.mark.parametrize("kind", [bool, np.bool_])
def test_callback_sees_the_picture_and_may_stop(kind):
    seen = []

    def callback(update):
        seen.append((update.progress.passes, float(update.image.mean())))
        return kind(update.progress.passes < 3)

    rendering = etendue.render("cornell-box", "path", spp=100, callback=callback, **SMALL)
    assert [passes for passes, _ in seen] == [1, 2, 3]
    assert rendering.metadata["stopped_by"] == "cancel"
    assert seen[-1][1] == pytest.approx(rendering.image.mean())


@pytest.mark.parametrize(
    ("call", "given", "text"),
    [
        (etendue.render, {"chekpoint": "a"}, "method 'auto' has no option 'chekpoint'; did you mean 'checkpoint'?"),
        (etendue.render, {"max_dept": 4}, "method 'auto' has no option 'max_dept'; did you mean 'max_depth'?"),
        (etendue.render, {"samples": 4}, "there is no argument 'samples'; did you mean 'spp'?"),
        (etendue.render, {"time": 4}, "there is no argument 'time'; did you mean 'seconds'?"),
        (etendue.render, {"resume": "a"}, "there is no argument 'resume'; did you mean 'etendue.resume(file)'?"),
        (etendue.render, {"xyzzy": 4}, None),
        (etendue.view, {"sessor": 4}, "method 'auto' has no option 'sessor'; did you mean 'sensor'?"),
        (etendue.trace_particles, {"pahts": 4}, "tracing by particles has no option 'pahts'; did you mean 'paths'?"),
        (etendue.trace_particles, {"samples": 1}, "there is no argument 'samples'; did you mean 'paths'?"),
        (
            etendue.compute_form_factors,
            {"bundels": 1},
            "method 'lines' has no option 'bundels'; did you mean 'bundles'?",
        ),
        (
            etendue.solve_radiosity,
            {"method": "boxes", "grit": 1},
            "method 'boxes' has no option 'grit'; did you mean 'grid'?",
        ),
    ],
)
def test_a_misspelt_argument_is_told_from_a_setting(call, given, text):
    with pytest.raises(OptionError) as error:
        call("cornell-box", **given)
    assert str(error.value) == text or (text is None and "; it has: max_depth, rr_depth, " in str(error.value))


def test_a_callback_may_cancel_its_session():
    sessions, refused = [], []

    def callback(update):
        sessions[0].cancel()
        with pytest.raises(RuntimeError, match="a callback cannot wait for the end of its run"):
            sessions[0].wait()
        refused.append(update.progress.passes)

    # The first pass waits until the session is known.
    known = threading.Event()
    session = etendue.render(
        "cornell-box", "path", spp=100, callback=lambda u: known.wait() and callback(u), wait=False, **SMALL
    )
    sessions.append(session)
    known.set()
    assert session.wait(timeout=60)
    assert refused == [1] and session.result.metadata["stopped_by"] == "cancel"


def test_numbers_of_numpy_are_kept_in_checkpoints(tmp_path):
    given = {"size": np.array([16, 12]), "seed": np.int64(3), "sensor": np.int64(0), "memory": np.int64(1 << 30)}
    made = etendue.render("cornell-box", "path", spp=2, samples_per_pass=2, checkpoint=tmp_path / "a", **given)
    assert made.image.shape == (12, 16, 3)
    resumed = etendue.resume(tmp_path / "a", spp=4)
    assert resumed.metadata["seed"] == 3 and resumed.metadata["samples"] == 4


def test_what_a_callback_raises_costs_no_work(tmp_path):
    def callback(update):
        if update.progress.passes == 2:
            raise ValueError("plot window closed")

    with pytest.raises(RunError, match="plot window closed") as caught:
        etendue.render("cornell-box", "path", spp=100, callback=callback, save=tmp_path / "a.exr", **SMALL)
    assert caught.value.run.result.image.mean() > 0
    assert film.read_exr(tmp_path / "a.exr").metadata["passes"] == 2


def test_ctrl_c_writes_what_there_is(tmp_path):
    def callback(update):
        if update.progress.passes == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        etendue.render("cornell-box", "path", spp=100, callback=callback, checkpoint=tmp_path / "a", **SMALL)
    (note,) = caught.value.__notes__
    assert note.startswith("interrupted after 2 passes") and "wait=False" in note
    assert etendue.resume(tmp_path / "a", spp=6).metadata["passes"] == 3


def test_a_place_that_vanishes_costs_no_picture(tmp_path, temporary):
    place, other = tmp_path / "place", tmp_path / "other"
    place.mkdir()

    def callback(update):
        if update.progress.passes == 2:
            (place / "a.exr").unlink(missing_ok=True)
            place.rmdir()

    with pytest.raises(OutputError, match=r"the picture is in '(.*a\.exr)' instead") as caught:
        etendue.render("cornell-box", "path", spp=8, callback=callback, save=place / "a.exr", checkpoint=other, **SMALL)
    assert film.read_exr(rescued(caught.value, "a.exr")).metadata["passes"] == 4
    assert etendue.resume(other, spp=10).metadata["passes"] == 5


def test_every_place_that_fails_is_named(tmp_path):
    places = Picture((tmp_path / "no" / "a.exr",), tmp_path / "none" / "b")
    settings, budget = {"samples_per_pass": 2}, Budget(samples=2)
    job = Job.open(picture("cornell-box", methods.get("path"), settings, budget=budget, size=(8, 8)))
    with pytest.raises(OutputError, match=r"none.*; .*a\.exr"):
        places.write(job, RunResult(job.method, Replica(job.method, 0).step(0), {}, 1.0, "running"))


def rescued(error, name):
    """The file of that name that an error says it was saved from."""
    return Path(re.search(rf"is in '([^']*{re.escape(name)})' instead", str(error))[1])


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder for temporary files."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(place))
    return place


def test_a_picture_that_cannot_be_written_is_kept_as_arrays(tmp_path, temporary, monkeypatch):
    def fail(path, result):
        raise RuntimeError("a fault of the writer")

    monkeypatch.setattr(film, "write_exr", fail)
    paths = {"save": [tmp_path / "a.exr", tmp_path / "a.png"], "checkpoint": tmp_path / "c"}
    with pytest.raises(OutputError, match=r"cannot write '.*a\.exr': RuntimeError: a fault of the writer") as caught:
        etendue.render("cornell-box", "path", spp=4, **paths, **SMALL)
    with np.load(rescued(caught.value, "a.exr.npz")) as arrays:
        kept = arrays["image"]
    assert (tmp_path / "a.png").exists()
    monkeypatch.undo()
    assert np.array_equal(kept, etendue.render("cornell-box", "path", spp=4, **SMALL).image)
    assert etendue.resume(tmp_path / "c", spp=6).metadata["passes"] == 3


def test_a_picture_that_cannot_be_developed_is_kept_as_a_checkpoint(tmp_path, temporary, monkeypatch):
    monkeypatch.setattr("etendue.products.pictures.developed", lambda *_: 1 / 0)
    with pytest.raises(
        OutputError, match=r"cannot develop the picture: ZeroDivisionError: .*; the checkpoint"
    ) as caught:
        etendue.render("cornell-box", "path", spp=4, save=tmp_path / "a.exr", **SMALL)
    monkeypatch.undo()
    assert etendue.resume(rescued(caught.value, "render.checkpoint"), spp=6).metadata["passes"] == 3


def test_what_cannot_be_kept_anywhere_leaves_no_litter(tmp_path, temporary, monkeypatch):
    def fail(*arguments, **named):
        raise MemoryError

    monkeypatch.setattr(film, "write_exr", fail)
    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OutputError) as caught:
        etendue.render("cornell-box", "path", spp=4, save=tmp_path / "a.exr", **SMALL)
    assert str(caught.value) == f"cannot write '{tmp_path / 'a.exr'}': MemoryError"
    assert list(temporary.iterdir()) == []


def test_a_failing_pass_is_reported_even_if_nothing_can_be_written(tmp_path, temporary, monkeypatch, caplog):
    monkeypatch.setattr(film, "write_exr", lambda path, result: 1 / 0)

    def callback(update):
        raise ValueError("plot window closed")

    with pytest.raises(RunError, match="plot window closed"):
        etendue.render("cornell-box", "path", spp=4, callback=callback, save=tmp_path / "a.exr", **SMALL)
    assert "the finished passes could not be saved" in caplog.text
    assert rescued(caplog.text, "a.exr.npz").exists()


@pytest.mark.parametrize(
    ("method", "tolerance"),
    thinned(
        [("path", 0.0), ("guided", 0.0), ("light", 1e-5), ("bpt", 1e-5), ("vcm", 1e-5)],
        [("path", 0.0), ("guided", 0.0), ("vcm", 1e-5)],
    ),
)
def test_a_resumed_render_is_an_uninterrupted_one(method, tolerance, tmp_path):
    whole = etendue.render("cornell-glass", method, spp=8, **SMALL)
    checkpoint, picture = tmp_path / "a", tmp_path / "a.exr"
    with etendue.render("cornell-glass", method, spp=8, checkpoint=checkpoint, wait=False, **SMALL) as session:
        while session.progress.passes < 1:
            assert session.running
            time.sleep(0.001)
        session.cancel()
        early = session.result.metadata["passes"]
    if early == 4:  # the machine was faster than the cancellation
        etendue.render("cornell-glass", method, spp=4, checkpoint=checkpoint, **SMALL)
    resumed = etendue.resume(checkpoint, spp=8, save=picture)
    assert resumed.metadata["passes"] == 4
    for name, layer in whole.layers.items():
        if tolerance == 0.0:
            assert np.array_equal(resumed.layers[name], layer)
        else:
            assert np.allclose(resumed.layers[name], layer, rtol=tolerance, atol=1e-7)
    assert np.array_equal(film.read_exr(picture).image, resumed.image)


#: Each verb with a short run of several passes, and the numbers of its result.
VERBS = {
    "render": (
        lambda **options: etendue.render("cornell-box", "path", spp=6, **SMALL, **options),
        lambda made: made.image,
    ),
    "resume": (
        lambda **options: etendue.resume(begun(), spp=10, **options),
        lambda made: made.image,
    ),
    "form factors": (
        lambda **options: etendue.compute_form_factors(cube(1), bundles=24, **options),
        lambda made: made.factors.matrix.toarray(),
    ),
    "radiosity": (
        lambda **options: etendue.solve_radiosity("cornell-box", bundles=24, **options),
        lambda made: made.solution.radiosity,
    ),
    "particles": (
        lambda **options: etendue.trace_particles("cornell-box", paths=600, samples_per_pass=200, **options),
        lambda made: made.particles.position,
    ),
}


def begun():
    """A new checkpoint of four camera paths per pixel."""
    made = etendue.render("cornell-box", "path", spp=4, **SMALL)
    path = Path(tempfile.mkdtemp()) / "a"
    made.save_checkpoint(path)
    return path


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_runs_in_the_background(name, temporary):
    """With the result of waiting; a callback is called in another thread, and may end the run."""
    verb, numbers = VERBS[name]
    threads, passes = set(), []

    def callback(update):
        threads.add(threading.current_thread())
        passes.append(update.progress.passes)

    session = verb(wait=False, callback=callback)
    assert isinstance(session, etendue.Session)
    np.testing.assert_array_equal(numbers(session.result), numbers(verb()))
    assert len(passes) >= 3 and threading.main_thread() not in threads
    with verb(wait=False, callback=lambda update: False) as session:
        session.wait()
    assert session.progress.passes < passes[-1]
    np.testing.assert_array_equal(numbers(session.result), numbers(verb(callback=lambda update: False)))


def test_session():
    began = time.perf_counter()
    session = etendue.render("cornell-box", "path", seconds=60, wait=False, **SMALL)
    assert time.perf_counter() - began < 2.0
    while session.progress.passes < 2:
        time.sleep(0.005)
    assert session.image.shape == (12, 16, 3)
    assert 0 < session.progress.fraction < 0.5
    session.cancel()
    assert not session.running
    assert session.result.metadata["stopped_by"] == "cancel"
    assert session.result.metadata["passes"] >= 2


def test_session_reports_a_bad_scene_where_one_waits():
    session = etendue.render("cornell-bax", "path", spp=1, wait=False)
    with pytest.raises(SceneError, match="did you mean 'cornell-box'"):
        session.wait()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"method": "vmc"}, OptionError, "did you mean 'vcm'"),
        ({"seconds": -1}, OptionError, "must be a number above 0"),
        ({"spp": 0}, OptionError, "at least 1"),
        ({"seed": -1}, OptionError, "a seed is"),
        ({"seed": 0.5}, OptionError, "a seed is"),
        ({"sensor": "a"}, OptionError, "a sensor is a whole number"),
        ({"memory": "1G"}, OptionError, "a memory bound is a whole number of bytes of at least 16777216"),
        ({"memory": 1}, OptionError, "a memory bound is"),
        ({"method": 5}, OptionError, "by its name, not by 5"),
        ({"samples_per_pass": 10**8}, OptionError, "at most 4096"),
        ({"save_every": -1}, OptionError, "time between saves"),
        ({"save_every": "1m"}, OptionError, "time between saves"),
        ({"save": "a.tiff"}, OptionError, "as .exr or .png"),
        ({"save": ["a.exr", "./a.exr"]}, OptionError, "named for two outputs"),
        ({"save": "a.exr", "checkpoint": "a.exr"}, OptionError, "'a.exr' is named for two outputs"),
        ({"save": "/no/such/folder/a.exr"}, OutputError, "no folder"),
        ({"checkpoint": "/no/such/folder/a"}, OutputError, "no folder"),
    ],
)
def test_bad_arguments_are_refused_before_the_scene_is_read(arguments, error, message):
    with pytest.raises(error, match=message):
        etendue.render(**({"scene": "/no/such/scene.xml", "method": "path"} | arguments))


def test_resume_refuses_a_changed_scene_and_a_spent_budget(tmp_path):
    scene = tmp_path / "scene.xml"
    text = """<scene version="3.0.0"><emitter type="constant"/><sensor type="perspective"><film type="hdrfilm">
        <integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
        <shape type="sphere"><point name="center" x="0" y="0" z="5"/>
        <float name="radius" value="RADIUS"/></shape></scene>"""
    scene.write_text(text.replace("RADIUS", "1"))
    checkpoint = tmp_path / "a.checkpoint"
    etendue.render(scene, "path", spp=2, samples_per_pass=1, checkpoint=checkpoint)
    with pytest.raises(CheckpointError, match="the budget of the checkpoint is used up"):
        etendue.resume(checkpoint)
    scene.write_text(text.replace("RADIUS", "2"))
    before = checkpoint.read_bytes()
    with pytest.raises(CheckpointError, match="the scene is not the one"):
        etendue.resume(checkpoint, spp=4)
    scene.unlink()
    with pytest.raises(CheckpointError, match="cannot be loaded"):
        etendue.resume(checkpoint, spp=4)
    assert checkpoint.read_bytes() == before
    moved = tmp_path / "moved.xml"
    moved.write_text(text.replace("RADIUS", "1"))
    assert etendue.resume(checkpoint, spp=4, scene=moved).metadata["passes"] == 4
    assert etendue.resume(checkpoint, spp=5).metadata["passes"] == 5  # it remembers where the scene is now
