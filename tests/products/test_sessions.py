"""Form factors and radiosity in the background: progress, callbacks, cancelling, results, what went wrong."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from support.patches import cube

import etendue
from etendue.core import OptionError, SceneError
from etendue.engine import Cancelled, RunError
from etendue.radiosity import LineCasting, read_solution

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


def test_the_result_is_that_of_a_call(tmp_path):
    patches = cube(2, **LIT)
    session = etendue.solve_radiosity(patches, bundles=64, seed=5, save=tmp_path / "s.npz", wait=False)
    result = session.result
    assert not session.running and session.prepared and session.image is None
    assert (session.progress.samples, session.progress.fraction) == (64, 1.0)
    assert str(session.progress).startswith("64 bundles, ") and "segments/s" in str(session.progress)
    expected = etendue.solve_radiosity(patches, bundles=64, seed=5)
    np.testing.assert_array_equal(result.solution.radiosity, expected.solution.radiosity)
    np.testing.assert_array_equal(read_solution(tmp_path / "s.npz")[0].radiosity, expected.solution.radiosity)

    factors = etendue.start_form_factors(patches, "F4", bundles=32).result.factors
    expected = etendue.compute_form_factors(patches, "F4", bundles=32).factors
    np.testing.assert_array_equal(factors.matrix.toarray(), expected.matrix.toarray())


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
    more = etendue.solve_radiosity(cube(2, **LIT), seed=2, resume=kept, bundles=result.bundles + 8, wait=False).result
    whole = etendue.solve_radiosity(cube(2, **LIT), seed=2, bundles=result.bundles + 8)
    np.testing.assert_array_equal(more.solution.radiosity, whole.solution.radiosity)


def test_a_callback_is_called_in_the_session_and_ends_it():
    threads = []

    def callback(progress):
        threads.append(threading.current_thread().name)
        return progress.samples < 24

    with etendue.start_form_factors(cube(1), bundles=64, callback=callback) as session:
        assert session.wait()
    assert (session.result.bundles, session.result.stopped_by) == (24, "cancel")
    assert threads == ["etendue-session"] * 3


def test_what_was_cast_before_a_failure_is_kept(tmp_path):
    def fail(progress):
        if progress.samples == 24:
            raise RuntimeError("on purpose")

    kept = tmp_path / "lines.checkpoint"
    session = etendue.start_form_factors(
        cube(1), bundles=64, callback=fail, checkpoint=kept, save=tmp_path / "factors.npz"
    )
    with pytest.raises(RunError, match="on purpose"):
        session.wait()
    assert not (tmp_path / "factors.npz").exists()
    assert etendue.compute_form_factors(cube(1), resume=kept, bundles=32).bundles == 32


def test_a_session_that_ends_before_the_first_lines(monkeypatch):
    prepared = threading.Event()
    prepare = LineCasting.prepare

    def slowly(self, problem, seed):
        prepare(self, problem, seed)
        prepared.wait()

    monkeypatch.setattr(LineCasting, "prepare", slowly)
    session = etendue.solve_radiosity(cube(1, **LIT | {"emission": 1.0}), bundles=64, wait=False)
    session.request_stop()
    prepared.set()
    with pytest.raises(Cancelled):
        session.wait()


def test_options_are_checked_before_it_starts(tmp_path):
    """In the thread that calls; what takes the source is said by the session."""
    for call, text in (
        (lambda: etendue.solve_radiosity(cube(1, emission=1.0), "jacoby", wait=False), "did you mean 'jacobi'"),
        (lambda: etendue.solve_radiosity("cornell-box", bundles=0, wait=False), "in bundles must be a whole number"),
        (lambda: etendue.start_form_factors(cube(1), save=tmp_path / "a.csv"), "not known"),
        (lambda: etendue.start_form_factors({"type": "scene"}, hierarchy="thing"), "or by an array of a mesh file"),
    ):
        with pytest.raises(OptionError, match=text):
            call()
    with pytest.raises(SceneError, match="has no light"):
        etendue.solve_radiosity(cube(1), wait=False).wait()
