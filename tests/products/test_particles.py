"""Runs that trace particles: limits of a resumed file, the size of passes, methods that do not trace."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.run_files import SCENE

import etendue
from etendue.core import EtendueError, OptionError


@pytest.fixture(scope="module")
def traced(tmp_path_factory, variant) -> Path:
    folder = tmp_path_factory.mktemp("particles")
    (folder / "scene.xml").write_text(SCENE)
    etendue.trace_particles(folder / "scene.xml", paths=1000, samples_per_pass=1000, save=folder / "a.particles")
    return folder / "a.particles"


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"particles": 0}, "a budget in particles must be a whole number of at least 1, not 0"),
        ({"particles": 1.5}, "not 1.5"),
        ({"paths": 0}, "a budget in paths must be a whole number of at least 1, not 0"),
        ({"paths": 9000, "particles": 9000}, "paths and particles limit the same; give one of them"),
        ({"spp": 4}, "method 'particles' counts paths: give paths in place of spp"),
        ({"error": 0.1}, "particles have no error"),
        ({}, "the budget of the checkpoint is used up; give a new one"),
    ],
)
def test_limits_of_a_resumed_file(traced, limits, text):
    before = traced.read_bytes()
    with pytest.raises(EtendueError, match=text):
        etendue.resume(traced, **limits)
    assert traced.read_bytes() == before


def test_what_cannot_be_traced(traced):
    for asked, text in (
        ({"method": "metropolis"}, "no method 'metropolis' for particles; did you mean 'metropolis_particles'"),
        ({"method": "path"}, "no method 'path' for particles"),
        ({"save": traced}, "exists: choose another name, remove it, or go on with it by `etendue resume`"),
        ({"particles": 10, "paths": 10}, "paths and particles limit the same; give one of them"),
        ({"boxes": (2, 1, 1)}, "give workers or cluster with boxes"),
    ):
        with pytest.raises(OptionError, match=text):
            etendue.trace_particles("cornell-box", **asked)


def test_a_number_of_particles_is_about_reached_and_goes_on(tmp_path):
    path = tmp_path / "a.particles"
    made = etendue.trace_particles("cornell-box", particles=4000, save=path)
    assert 3000 < made.counters["particles"] < 5500 and made.stopped_by == "samples"
    more = etendue.resume(path, particles=8000)
    assert 6000 < more.counters["particles"] < 11_000
    assert len(etendue.read_particles(path)) == more.counters["particles"]


@pytest.mark.slow
def test_a_small_budget_of_chains_has_small_passes():
    made = etendue.trace_particles("cornell-box", method="metropolis_particles", paths=1000, bootstrap=1024)
    assert 1000 <= made.counters["paths"] < 1500 and made.passes >= 4
    asked = etendue.trace_particles(
        "cornell-box", method="metropolis_particles", paths=1000, bootstrap=1024, chains=64, steps=64
    )
    assert asked.counters["paths"] == 4096 and asked.passes == 1
