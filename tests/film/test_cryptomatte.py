"""Cryptomatte: hashes as published, ids that are floats, coverage as in pictures with 64 times the pixels."""

import json

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest

import etendue
from etendue.core import Result
from etendue.display.denoising import component_names
from etendue.film import COMPONENTS, matte_attributes, matte_layers, read_exr, write_exr
from etendue.film.cryptomatte import id_bits, name_hash
from etendue.scene import bundled_scene, load, unmerged
from etendue.transport import seen_shapes

SIZE = (16, 12)


def as_float(name):
    return np.array(id_bits(name), np.uint32).view(np.float32)


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("", 0),
        ("test", 0xBA6BD213),
        ("hello", 0x248BFA47),
        ("Hello, world!", 0xC0363E43),
        ("The quick brown fox jumps over the lazy dog", 0x2E4FF723),
        ("crypto_object", 0xF834D0A6),  # f834d0a is the key of this name in files of other renderers
    ],
)
def test_hashes(name, known):
    assert name_hash(name) == known


def test_ids_are_floats_that_files_keep(tmp_path):
    names = [f"shape {k}" for k in range(4000)]
    hashes = np.array([name_hash(name) for name in names], np.uint32)
    assert ((hashes >> 23 & 255 == 0) | (hashes >> 23 & 255 == 255)).any()  # the rule for them is tried
    ids = np.array([id_bits(name) for name in names], np.uint32).view(np.float32)
    assert np.isfinite(ids).all() and (np.abs(ids) >= np.finfo(np.float32).tiny).all()
    numbers = np.arange(1, 4001, dtype=np.uint32).reshape(40, 100, 1).repeat(2, axis=2)
    coverage = np.zeros((40, 100, 2), np.float32)
    coverage[:, :, 1] = 0.75
    layers = matte_layers(numbers, coverage, names)
    assert list(layers) == ["CryptoObject00"]
    metadata = matte_attributes(names)
    write_exr(tmp_path / "matte.exr", Result({"image": np.ones((40, 100, 3), np.float32)} | layers, metadata))
    back = read_exr(tmp_path / "matte.exr")
    found = back.layers["CryptoObject00"]
    np.testing.assert_array_equal(found[:, :, 0].view(np.uint32), ids.view(np.uint32).reshape(40, 100))
    np.testing.assert_array_equal(found[:, :, 1], 0.75)
    np.testing.assert_array_equal(found[:, :, 2:], 0.0)
    assert {key: back.metadata[key] for key in metadata} == metadata
    header = OpenEXR.File(str(tmp_path / "matte.exr")).header()
    key = f"cryptomatte/{name_hash('CryptoObject'):08x}"[:19]
    assert (header[f"{key}/name"], header[f"{key}/hash"]) == ("CryptoObject", "MurmurHash3_32")
    assert header[f"{key}/conversion"] == "uint32_to_float32"
    assert json.loads(header[f"{key}/manifest"])["shape 7"] == f"{id_bits('shape 7'):08x}"


def test_coverage_is_that_of_pictures_with_more_pixels():
    scene = bundled_scene("cornell-box").build()
    scene["sensor"]["film"]["rfilter"] = {"type": "box"}
    problem = load(scene, size=SIZE, change=unmerged)
    layers, _ = seen_shapes(problem, False, True)
    fine, metadata = seen_shapes(load(scene, size=(8 * SIZE[0], 8 * SIZE[1]), change=unmerged), True, False)
    names = metadata["shapes"]
    assert {"floor", "small-box", "light"} <= set(names)
    blocks = fine["shape"].reshape(SIZE[1], 8, SIZE[0], 8)
    ranks = np.concatenate([layers[f"CryptoObject0{k}"].reshape(SIZE[1], SIZE[0], 2, 2) for k in range(3)], axis=2)
    assert (np.diff(ranks[..., 1], axis=2) <= 0.0).all()
    several = 0
    for number, name in enumerate(names, 1):
        expected = (blocks == number).mean(axis=(1, 3))
        found = np.where(ranks[..., 0] == as_float(name), ranks[..., 1], 0.0).sum(axis=2)
        np.testing.assert_allclose(found, expected, atol=2.1 / 64)  # a ray on an edge falls to either side
        several += ((expected > 0.1) & (expected < 0.9)).sum()
    assert several > 20


def test_the_largest_of_more_shapes_than_are_kept():
    """The first row of rays meets eight small plates; all others meet a large one behind them."""
    place = mi.ScalarTransform4f
    scene = {
        "type": "scene",
        "sensor": {
            "type": "orthographic",
            "to_world": place().look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 2, "height": 1, "rfilter": {"type": "box"}},
        },
        "light": {"type": "constant"},
        "large": {"type": "rectangle", "to_world": place().scale(2)},
    }
    for number in range(8):  # of the left pixel: x from -1 to 0, y from 0.5 to -0.5 for an aspect of 2
        x = -15 / 16 + number / 8
        scene[f"small-{number}"] = {
            "type": "rectangle",
            "to_world": place().translate([x, 7 / 16, 1]).scale([1 / 20, 1 / 20, 1]),
        }
    layers, _ = seen_shapes(load(scene, change=unmerged), False, True)
    ranks = np.concatenate([layers[f"CryptoObject0{k}"].reshape(2, 2, 2) for k in range(3)], axis=1)
    large, small = as_float("large"), {float(as_float(f"small-{number}")) for number in range(8)}
    full = next(pixel for pixel in ranks if pixel[1, 1] > 0.0)
    assert full[0, 0] == large and full[0, 1] == 56 / 64
    assert len(set(full[1:, 0])) == 5 and set(full[1:, 0]) <= small and (full[1:, 1] == 1 / 64).all()
    alone = next(pixel for pixel in ranks if pixel[1, 1] == 0.0)
    assert alone[0, 0] == large and alone[0, 1] == 1.0


def test_a_loaded_scene_keeps_its_shapes():
    loaded = load("cornell-box", size=SIZE, change=unmerged).scene
    made = etendue.render(loaded, "path", spp=1, max_depth=2, cryptomatte=True)
    (manifest,) = (json.loads(text) for key, text in made.metadata.items() if key.endswith("/manifest"))
    assert "small-box" in manifest


def test_a_picture_with_its_matte(tmp_path):
    made = etendue.render("cornell-box", "path", spp=1, size=SIZE, max_depth=2, cryptomatte=True, components=True)
    plain = etendue.render("cornell-box", "path", spp=1, size=SIZE, max_depth=2, components=True)
    np.testing.assert_array_equal(made.image, plain.image)
    (manifest,) = (json.loads(text) for key, text in made.metadata.items() if key.endswith("/manifest"))
    assert "small-box" in manifest and {f"CryptoObject0{k}" for k in range(3)} <= set(made.layers)
    covered = sum(made.layers[f"CryptoObject0{k}"][..., 1::2].sum(axis=2) for k in range(3))
    inside = covered[1:-1, 4:-4]  # of a closed room, where a ray through an edge of two walls may meet neither
    assert covered.max() == 1.0 and inside.min() >= 60 / 64 and np.mean(inside == 1.0) > 0.9
    # Denoisers do not take it for light.
    assert component_names(made.layers) == component_names(plain.layers) == COMPONENTS
