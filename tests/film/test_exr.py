"""OpenEXR: layers and metadata come back as they were, files appear whole or not at all, reference pictures load."""

import os
from pathlib import Path

import numpy as np
import pytest

from etendue.core import OutputError, Result, SceneError
from etendue.film import layer_path, read_exr, read_image, replacing, write_exr, write_layers

SCENES = Path(__file__).parents[2].parent / "shared" / "scenes"


def make_result():
    rng = np.random.default_rng(3)
    layers = {name: rng.random((5, 7, 3)).astype(np.float32) for name in ("image", "emission", "merge", "normal")}
    layers["depth"] = rng.random((5, 7, 1)).astype(np.float32)
    layers["image"][0, 0] = [1e30, -2.0, np.inf]
    metadata = {
        "method": "vcm",
        "settings": {"max_depth": 10, "radius": 0.003, "mode": "a, b"},
        "seed": 7,
        "seconds": 1.5,
        "versions": {"mitsuba": "3.9.1"},
        "scene": 'été "quoted" #5.xml',
        "looks_like_json": "5",
        "quoted": '"x"',
        "empty": "",
        "nothing": None,
        "flag": True,
        "passes": [1, 2],
    }
    return Result(layers=layers, metadata=metadata)


def test_round_trip(tmp_path):
    result = make_result()
    write_exr(tmp_path / "out.exr", result)
    back = read_exr(tmp_path / "out.exr")
    assert next(iter(back.layers)) == "image" and back.layers.keys() == result.layers.keys()
    for name, layer in result.layers.items():
        assert back.layers[name].dtype == np.float32
        np.testing.assert_array_equal(back.layers[name], layer)
    assert back.metadata == result.metadata


def test_a_file_for_each_layer_shows_it_as_its_picture(tmp_path):
    result = make_result()
    write_layers(tmp_path / "a-0.5s.exr", result)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *(f"a-0.5s-{name}.exr" for name in ("depth", "emission", "merge", "normal")),
        "a-0.5s.exr",
    ]
    for name, layer in result.layers.items():
        back = read_exr(layer_path(tmp_path / "a-0.5s.exr", name))
        assert list(back.layers) == ["image"]
        np.testing.assert_array_equal(back.image, layer)
        assert back.metadata == {**result.metadata, "layer": name}


@pytest.mark.parametrize(
    ("beside", "layers"), [("AZ", ["image", "Z", "alpha"]), ("Z", ["image", "Z"]), ("A", ["image", "alpha"])]
)
def test_pictures_of_other_programs(tmp_path, beside, layers):
    """Depth beside the colours, without a layer's name: usual for Blender and Arnold."""
    import OpenEXR

    rng = np.random.default_rng(3)
    channels = {name: rng.random((5, 7), np.float32) for name in "BGR" + beside}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, dict(channels)).write(str(tmp_path / "other.exr"))
    found = read_exr(tmp_path / "other.exr").layers
    assert list(found) == layers
    for layer, names in zip(layers, ("RGB", *beside[::-1]), strict=True):
        np.testing.assert_array_equal(found[layer], np.stack([channels[name] for name in names], axis=-1))
    np.testing.assert_array_equal(read_image(tmp_path / "other.exr"), np.stack([channels[n] for n in "RGB"], axis=-1))


@pytest.mark.usefixtures("mitsuba_files")
def test_other_programs_see_the_picture_and_the_layers(variant, tmp_path):
    import mitsuba as mi

    result = make_result()
    write_exr(tmp_path / "out.exr", result)
    parts = dict(mi.Bitmap(str(tmp_path / "out.exr")).split())
    np.testing.assert_array_equal(np.array(parts["<root>"]), result.image)
    np.testing.assert_array_equal(np.array(parts["emission"]), result.layers["emission"])


def test_numpy_metadata_become_plain(tmp_path):
    result = Result(
        {"image": np.ones((2, 2, 3), np.float32)}, {"rays": np.float64(3.0), "size": (np.int64(2), 2), "p": Path("a")}
    )
    write_exr(tmp_path / "out.exr", result)
    assert read_exr(tmp_path / "out.exr").metadata == {"rays": 3.0, "size": [2, 2], "p": "a"}


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path, monkeypatch):
    import OpenEXR

    target = tmp_path / "out.exr"
    write_exr(target, make_result())
    before = target.read_bytes()

    def broken(self, name):
        Path(name).write_bytes(b"half")
        raise RuntimeError("disk\nfull")

    monkeypatch.setattr(OpenEXR.File, "write", broken)
    with pytest.raises(OutputError, match="disk full"):
        write_exr(target, make_result())
    assert target.read_bytes() == before
    assert os.listdir(tmp_path) == ["out.exr"]


def test_replacing_swaps_at_the_end_only(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with replacing(target) as temporary:
        temporary.write_text("new")
        assert target.read_text() == "old" and temporary.parent == tmp_path
    assert target.read_text() == "new" and os.listdir(tmp_path) == ["a.txt"]
    with pytest.raises(KeyError), replacing(target) as temporary:
        temporary.write_text("never")
        raise KeyError
    assert target.read_text() == "new" and os.listdir(tmp_path) == ["a.txt"]


def test_unwritable_places_are_one_line_errors(tmp_path):
    for path, words in [(tmp_path / "no" / "out.exr", "no folder"), (tmp_path, "is a folder")]:
        with pytest.raises(OutputError, match=words) as caught:
            write_exr(path, make_result())
        assert "\n" not in str(caught.value)


def test_layers_of_another_shape_are_refused(tmp_path):
    image = np.ones((2, 2, 3), np.float32)
    with pytest.raises(OutputError, match="'depth'"):
        write_exr(tmp_path / "o.exr", Result({"image": image, "depth": np.ones((3, 2, 1), np.float32)}))
    with pytest.raises(OutputError, match="5 channels"):
        write_exr(tmp_path / "o.exr", Result({"image": image, "x": np.ones((2, 2, 5), np.float32)}))
    assert not os.listdir(tmp_path)


def test_unreadable_pictures_are_one_line_errors(tmp_path):
    (tmp_path / "text.exr").write_text("no picture")
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(SceneError, match="not an OpenEXR file"):
        read_exr(tmp_path / "text.exr")
    for name, words in [("text.png", "not a picture"), ("missing.exr", "no picture")]:
        with pytest.raises(SceneError, match=words):
            read_image(tmp_path / name)
    write_exr(tmp_path / "cut.exr", make_result())
    data = (tmp_path / "cut.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: len(data) // 2])
    with pytest.raises(SceneError, match="damaged"):
        read_image(tmp_path / "cut.exr")


def test_a_single_channel_is_repeated(tmp_path):
    grey = np.arange(6, dtype=np.float32).reshape(2, 3, 1)
    write_exr(tmp_path / "g.exr", Result({"image": grey}))
    np.testing.assert_array_equal(read_image(tmp_path / "g.exr"), np.repeat(grey, 3, axis=2))


@pytest.mark.parametrize("scene", ["veach-bidir", "water-caustic", "cornell-box"])
def test_reference_pictures_of_another_renderer(scene):
    path = SCENES / scene / "TungstenRender.exr"
    if not path.exists():
        pytest.skip("the public test scenes are not beside the repository")
    image = read_image(path)
    assert image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.float32
    assert np.isfinite(image).mean() > 0.999 and np.nanmax(image) > 0
