"""Work on particles: the limits of a resumed file are checked as those of a new one, in the words of who asks."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.run_files import SCENE

import etendue
from etendue.cli.radiosity_outputs import Options
from etendue.core import EtendueError, OptionError
from etendue.engine import Budget
from etendue.jobs import ParticleRequest, ParticleWork


@pytest.fixture(scope="module")
def traced(tmp_path_factory, variant) -> Path:
    folder = tmp_path_factory.mktemp("particles")
    (folder / "scene.xml").write_text(SCENE)
    etendue.trace_particles(folder / "scene.xml", paths=1000, samples_per_pass=1000, save=folder / "a.particles")
    return folder / "a.particles"


@pytest.mark.parametrize(
    ("limits", "python", "terminal"),
    [
        ({"particles": 0}, "in particles must be a whole number of at least 1, not 0", "particles (--particles) must"),
        ({"particles": -5}, "in particles must be a whole number of at least 1, not -5", "not -5"),
        ({"particles": 1.5}, "in particles must be a whole number of at least 1, not 1.5", "not 1.5"),
        ({"paths": 9000, "particles": 9000}, "paths= and particles= limit the same", "--paths and --particles limit"),
        ({}, "give a new one with paths=, particles= or seconds=", "with --paths, --particles or --time"),
    ],
)
def test_limits_of_a_resumed_file(traced, limits, python, terminal):
    before = traced.read_bytes()
    with pytest.raises(EtendueError) as caught:
        etendue.trace_particles(None, resume=traced, **limits)
    assert python in str(caught.value)
    with pytest.raises(EtendueError) as caught:
        ParticleWork.resume(traced, Budget(samples=limits.get("paths")), limits.get("particles"), wording=Options())
    assert terminal in str(caught.value)
    assert traced.read_bytes() == before


def test_how_to_go_on_with_an_existing_file(traced):
    for words, how in (
        ({}, f"go on with it by resume='{traced}'"),
        ({"wording": Options()}, f"etendue resume {traced}"),
    ):
        with pytest.raises(OptionError) as caught:
            ParticleRequest(scene="cornell-box", output=traced, **words)
        assert str(caught.value).endswith(how)


def test_a_small_budget_of_chains_has_small_passes():
    made = etendue.trace_particles("cornell-box", method="metropolis_particles", paths=1000, bootstrap=1024)
    assert 1000 <= made.counters["paths"] < 1500 and made.passes >= 4
    asked = etendue.trace_particles(
        "cornell-box", method="metropolis_particles", paths=1000, bootstrap=1024, chains=64, steps=64
    )
    assert asked.counters["paths"] == 4096 and asked.passes == 1
