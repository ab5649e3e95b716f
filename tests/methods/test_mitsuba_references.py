"""Mitsuba's own render tests: scenes with the mean and variance of long renderings by Mitsuba, and its Z-test."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from conftest import SCENES
from scipy import stats
from support.spectral import spectral_variant

import etendue
from etendue.core import SceneError

#: Samples of a picture, over all pixels.
SAMPLES = 500_000
#: Mitsuba's level, at which one pixel of a picture is called different, and the share of values that have to agree.
LEVEL, AGREEING = 0.01, 0.9975
FOLDER = SCENES / "mitsuba-data" / "tests" / "scenes"
#: Scenes are named after the integrator of the reference.
FILES = sorted(FOLDER.glob("*/*.xml"))


def _xyz(picture: mi.Bitmap) -> np.ndarray:
    return np.array(picture.convert(mi.Bitmap.PixelFormat.XYZ, mi.Struct.Type.Float32, False))


@pytest.mark.slow
@pytest.mark.usefixtures("mitsuba_files")
@pytest.mark.parametrize("method", ["own", "bpt", "vcm"])
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_mitsuba_s_references(file: Path, method: str) -> None:
    _agrees(file, method, "rgb")


@pytest.mark.slow
@pytest.mark.usefixtures("mitsuba_files")
@pytest.mark.parametrize("method", ["own", "bpt", "vcm"])
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_mitsuba_s_spectral_references(file: Path, method: str) -> None:
    with spectral_variant():
        _agrees(file, method, "spectral")


def _agrees(file: Path, method: str, colours: str) -> None:
    name, integrator = file.stem.rsplit("_", 1)
    reference, variance = (
        _xyz(mi.Bitmap(str(file.parent / "refs" / f"{name}_ref_{colours}{part}.exr"))) for part in ("", "_var")
    )
    pixels = reference.shape[0] * reference.shape[1]
    # In fog few paths bring much of the light: with fewer samples volpath itself fails the test.
    samples = SAMPLES // pixels * (8 if integrator == "volpath" and method == "own" else 1)
    depth = {"max_depth": 2} if integrator == "direct" else {}
    if method == "own":
        method = "light" if integrator == "ptracer" else "path"
    try:
        result = etendue.render(str(file), method, spp=samples, seed=1, **depth)
    except SceneError as error:
        if "file does not exist" in str(error):
            pytest.skip(str(error))
        raise
    image = _xyz(mi.Bitmap(np.ascontiguousarray(result.image[..., :3], np.float32)))
    # Pixels alone do not tell a picture that is a few per cent too dark. (Filters and shared paths correlate them.)
    error = np.sqrt(variance.mean(axis=(0, 1)) / samples / pixels)
    whole = np.abs(image.mean(axis=(0, 1)) - reference.mean(axis=(0, 1)))
    assert (whole < 5.0 * error + 0.01 * reference.mean()).all(), (
        f"means {image.mean((0, 1))}, {reference.mean((0, 1))}"
    )
    z = np.abs(image - reference) * np.sqrt(samples / np.maximum(variance, 1e-4))
    differ = 2.0 * stats.norm.sf(z) <= 1.0 - (1.0 - LEVEL) ** (1.0 / pixels)
    assert differ.mean() <= 1.0 - AGREEING, f"{differ.mean():.4f} of the values differ, mean {image.mean()}"
