"""One run on the film, developed at several sizes by the command line."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from etendue import film
from etendue.cli.main import main


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def run(command: str) -> int:
    return main(shlex.split(command))


def test_a_checkpoint_is_developed_at_two_sizes(capsys):
    assert run("render cornell-box -m film_metropolis --size 24x16 --spp 16 -D bootstrap=8192 -o a.exr") == 0
    assert run("film-picture a.checkpoint --size 48x32 -o b.exr --estimator variable -o b.png") == 0
    assert run("film-picture a.checkpoint -o c.exr") == 0
    a, b, c = (film.read_image(f"{name}.exr") for name in "abc")
    assert b.shape == (32, 48, 3) and a.shape == (16, 24, 3)
    np.testing.assert_allclose(c, a, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(b.mean(), a.mean(), rtol=0.05)
    assert run("resume a.checkpoint --spp 32") == 0
    assert run("film-picture a.checkpoint -o d.exr") == 0
    assert not np.array_equal(film.read_image("d.exr"), c)
    capsys.readouterr()
    assert run("film-picture a.checkpoint --size 48x32") != 0
    assert run("render cornell-box -m path --size 8x8 --spp 1 -o p.exr") == 0
    assert run("film-picture p.checkpoint -o q.exr") != 0
    message = capsys.readouterr().err
    assert "name a picture" in message and "is a checkpoint of path" in message
    assert run("film-picture a.checkpoint -o q.exr --estimator best") != 0
    assert "estimator must be one of histogram" in capsys.readouterr().err
