"""Runs on patches in the background: progress, cancelling, what went wrong; and parameters of their scenes."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from support.patches import cube

import etendue
from etendue.core import OptionError
from etendue.engine import Cancelled, RunError
from etendue.radiosity import LineCasting

#: Light leaves one wall.
LIT = {"reflectance": 0.5, "emission": np.repeat([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 4)}


def test_parameters_reach_the_scene(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><default name="size" value="1"/><sensor type="perspective"/><shape type="cube">'
        '<boolean name="flip_normals" value="true"/><transform name="to_world"><scale value="$size"/></transform>'
        '<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape></scene>'
    )
    for given, size in ((None, 1.0), ({"size": 3}, 3.0)):
        factors = etendue.compute_form_factors(path, bundles=8, parameters=given).factors
        assert factors.areas.sum() == pytest.approx(24 * size**2)
        solution = etendue.solve_radiosity(path, bundles=8, parameters=given).solution
        assert solution.patches.areas.sum() == pytest.approx(24 * size**2)
        particles = etendue.trace_particles(path, paths=200, parameters=given).particles
        assert np.abs(particles.position).max() == pytest.approx(size, rel=1e-5)


def test_progress_is_in_the_words_of_the_method(tmp_path):
    for method, count, words in (
        ("lines", {"bundles": 64}, "64 bundles, "),
        ("multipath", {"points": 512}, "512 lines, "),
        ("boxes", {"passes": 2, "lines": 512}, "1.02e+03 lines"),
    ):
        session = etendue.solve_radiosity(cube(2, **LIT), method, wait=False, **count)
        assert session.result.stopped_by == "samples"
        assert not session.running and session.prepared and session.image is None
        assert session.progress.fraction == 1.0
        assert str(session.progress).startswith(words) and "segments/s" in str(session.progress)


def test_cancelling_leaves_what_was_cast_solved_and_saved(tmp_path):
    kept, written = tmp_path / "lines.checkpoint", tmp_path / "s.npz"
    session = etendue.solve_radiosity(cube(2, **LIT), seconds=300, seed=2, checkpoint=kept, save=written, wait=False)
    while session.progress.samples < 16:
        assert session.running
        time.sleep(0.005)
    assert 0 < session.progress.fraction < 0.9
    session.cancel()
    assert not session.running
    result = session.result
    assert result.stopped_by == "cancel" and result.bundles >= 16 and written.exists()
    more = etendue.resume(kept, scene=cube(2, **LIT), bundles=result.bundles + 8, wait=False).result
    whole = etendue.solve_radiosity(cube(2, **LIT), seed=2, bundles=result.bundles + 8)
    np.testing.assert_array_equal(more.solution.radiosity, whole.solution.radiosity)


def test_what_was_cast_before_a_failure_is_kept(tmp_path):
    def fail(update):
        if update.progress.samples == 24:
            raise RuntimeError("on purpose")

    kept = tmp_path / "lines.checkpoint"
    asked = {"bundles": 64, "callback": fail, "checkpoint": kept, "save": tmp_path / "factors.npz"}
    with pytest.raises(RunError, match="on purpose"):
        etendue.compute_form_factors(cube(1), wait=False, **asked).wait()
    assert not (tmp_path / "factors.npz").exists()
    assert etendue.resume(kept, scene=cube(1), bundles=32).bundles == 32


def test_a_session_that_ends_before_the_first_lines(monkeypatch):
    prepared = threading.Event()
    prepare = LineCasting.prepare

    def slowly(self, problem, seed):
        prepare(self, problem, seed)
        prepared.wait()

    monkeypatch.setattr(LineCasting, "prepare", slowly)
    session = etendue.solve_radiosity(cube(1, reflectance=0.5, emission=1.0), bundles=64, wait=False)
    session.request_stop()
    prepared.set()
    with pytest.raises(Cancelled):
        session.wait()


def test_options_are_checked_in_the_thread_that_calls():
    for asked in ({"solver": "jacoby"}, {"bundles": 0}, {"method": "spheres"}):
        with pytest.raises(OptionError):
            etendue.solve_radiosity(cube(1, emission=1.0), wait=False, **asked)
