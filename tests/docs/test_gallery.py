"""The gallery: its page is current, every bundled scene has a small picture, and no other picture is kept."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from PIL import Image

from etendue.scene import bundled

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def gallery():
    spec = importlib.util.spec_from_file_location("gallery_page", ROOT / "tools" / "gallery_page.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_current(gallery):
    assert gallery.PAGE.read_text("utf-8") == gallery.page(), "run python tools/gallery_page.py"


def test_every_scene_has_one_method(gallery):
    named = " ".join(gallery.METHODS.values()).split()
    assert sorted(named) == sorted(bundled())


def test_the_pictures_are_small(gallery):
    files = sorted(gallery.PICTURES.iterdir())
    assert sorted(file.stem for file in files) == sorted(
        [*bundled(), *gallery.PUBLIC, *(f"by-{name}" for name in gallery.COMPARED)]
    )
    assert sum(file.stat().st_size for file in files) <= 1_000_000
    for file in files:
        with Image.open(file) as picture:
            assert picture.width == 320 and file.stat().st_size <= 40_000, file.name
