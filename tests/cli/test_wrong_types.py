"""Arguments of a type that is never meant: one line that names the argument, of the project's own errors."""

from __future__ import annotations

import pytest

import etendue
from etendue.core import EtendueError


class Other:
    """An object of the caller's own."""


def render(scene="cornell-box", method="path", **options):
    return etendue.render(scene, method, **({"spp": 1, "size": (8, 6)} | options))


@pytest.fixture(scope="module")
def made():
    return render()


@pytest.mark.parametrize("value", [None, 5, b"box", [], Other()])
@pytest.mark.parametrize("method", ["path", None])
def test_no_scenes(value, method):
    for function in (render, etendue.trace_particles, lambda scene, _: etendue.view(scene)):
        arguments = (value, method) if function is not etendue.trace_particles else (value,)
        with pytest.raises(EtendueError) as caught:
            function(*arguments)
        assert "a scene is a file" in str(caught.value) and "\n" not in str(caught.value)


def test_a_view_of_a_scene_that_does_not_exist():
    with pytest.raises(EtendueError, match="no scene file 'nope'"):
        etendue.view("nope")


@pytest.mark.parametrize("value", [5, b"a.exr", Other(), [5]])
def test_no_files(value, made):
    for call in (
        lambda: render(save=value),
        lambda: render(checkpoint=value),
        lambda: made.save(value),
        lambda: made.save_checkpoint(value),
        lambda: etendue.resume(value),
        lambda: etendue.read_particles(value),
        lambda: etendue.map_particles(value, "cornell-box"),
    ):
        with pytest.raises(EtendueError) as caught:
            call()
        assert "named by a text or a path" in str(caught.value)


@pytest.mark.parametrize("value", [5, [], b"x", Other()])
def test_no_names_and_numbers(value, made):
    for call in (
        lambda: render(method=value),
        lambda: made.save("a.png", tone=value),
        lambda: render(variant=value),
        lambda: made.save("a.png", exposure=[value]),
        lambda: render(seconds=[value]),
        lambda: render(seed=[value]),
        lambda: render(size=value),
        lambda: render(max_depth=[value]),
    ):
        with pytest.raises(EtendueError) as caught:
            call()
        assert "\n" not in str(caught.value)
