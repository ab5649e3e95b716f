"""Pictures of files without a scene: layers, tone, denoisers and references are shown; what needs a scene is told."""

import asyncio
import io

import numpy as np
import pytest
from PIL import Image
from support.viewing import Page

import etendue
from etendue.cli.main import main
from etendue.core import Result
from etendue.display import develop, false_colour
from etendue.film import ALBEDO, COMPONENTS, LUMINANCE, NORMAL, read_exr, write_exr
from etendue.viewer.shown import LUMINANCE_LAYER, Show, luminances

SIZE = (20, 12)


def layers():
    rng = np.random.default_rng(3)
    image = rng.random((SIZE[1], SIZE[0], 3), dtype=np.float32)
    depth = np.tile(np.linspace(1.0, 5.0, SIZE[0], dtype=np.float32), (SIZE[1], 1))[:, :, None]
    return {"image": image, "albedo": np.full_like(image, 0.5), "normal": np.zeros_like(image), "depth": depth}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("pictures")
    write_exr(made / "picture.exr", Result(layers(), {"method": "bpt", "samples": 16, "seconds": 5.0}))
    write_exr(made / "reference.exr", Result({"image": layers()["image"] * 1.1}))
    write_exr(made / "small.exr", Result({"image": np.ones((2, 3, 3), np.float32)}))
    return made


@pytest.fixture(scope="module")
def viewer(folder):
    with etendue.view(folder / "picture.exr", folder=folder) as made:
        yield made


def talk(viewer, conversation):
    async def go():
        page = await Page.open(viewer.url)
        try:
            await conversation(page)
        finally:
            page.close()

    asyncio.run(go())


async def shown(page, wanted):
    """A frame that is as wanted; those of before it, also of another picture, are on their way."""
    while True:
        _, data = await page.until("frame")
        found = np.asarray(Image.open(io.BytesIO(bytes(data))).convert("RGB")).astype(float)
        if wanted(found):
            return found


@pytest.mark.parametrize(("name", "value"), [(name, 188) for name in ALBEDO] + [(name, 191) for name in NORMAL])
def test_layers_of_first_surfaces_are_known_by_all_usual_names(name, value):
    """An albedo of a half has no exposure; a direction from -1 to 1 is a colour."""
    layer = np.full((2, 3, 3), 0.5, np.float32)
    assert (Show(layer=name).colours({"image": layer, name: layer}, 3.0) == value).all()


def test_layers_tone_and_denoisers(viewer):
    async def conversation(page):
        state, _ = await page.until("state", lambda m: m["loaded"])
        assert state["still"] and state["method"] == "bpt" and tuple(state["size"]) == SIZE and state["camera"] is None
        assert not state["preparing"]
        progress, _ = await page.until("progress")
        assert progress["done"] and (progress["samples"], progress["error"]) == (16, None)
        page.send("show", exposure=0.5)
        before = await shown(page, lambda frame: True)
        page.send("show", layer="depth")
        grey = await shown(page, lambda frame: frame[:, -1].mean() > frame[:, 0].mean() + 200)
        assert grey.shape[1::-1] == SIZE
        page.send("show", layer="image", denoise="gaussian", radius=3, exposure=0.0)
        await shown(page, lambda frame: frame.std() < 0.5 * before.std())
        page.send("show", denoise="nlm")
        assert "needs the variance of 'image'" in (await page.until("error"))[0]["text"]
        page.send("show", denoise="")
        page.send("pick", x=0.99, y=0.01)
        found, _ = await page.until("picked")
        np.testing.assert_allclose(found["radiance"], layers()["image"][0, -1], rtol=1e-6)

    talk(viewer, conversation)

    async def later(page):  # nothing is made any more, and it is told all the same
        assert (await page.until("progress"))[0]["samples"] == 16

    talk(viewer, later)


def test_a_denoiser_for_each_component(folder):
    """Written as on the command line; the state has the parts."""
    rng = np.random.default_rng(3)
    parts = {name: rng.random((SIZE[1], SIZE[0], 3), dtype=np.float32) for name in COMPONENTS}
    path = folder / "components.exr"
    write_exr(path, Result(parts | {"image": sum(parts.values())}))
    asked = "bilateral,indirect=gaussian:radius=7:strength=2,direct=none"

    async def conversation(page):
        state, _ = await page.until("state", lambda m: m["components"])
        assert sorted(state["components"]) == sorted(COMPONENTS) and state["filters"] == {}
        page.send("show", denoise=asked, radius=3)
        state, _ = await page.until("state", lambda m: m["show"]["denoise"])
        assert state["filters"] == {
            "": {"name": "bilateral", "radius": 3, "strength": 1.0},
            "indirect": {"name": "gaussian", "radius": 7, "strength": 2.0},
            "direct": {"name": "none", "radius": 3, "strength": 1.0},
        }
        page.send("save", what="picture", name="denoised.exr")
        await page.until("saved")
        page.send("show", denoise="indrect=gaussian")
        assert "no component 'indrect'; it has: " in (await page.until("error"))[0]["text"]
        page.send("show", denoise="indirect=gausian")
        assert "did you mean 'gaussian'" in (await page.until("error"))[0]["text"]

    with etendue.view(path, folder=folder) as made:
        talk(made, conversation)
    expected = develop(read_exr(path).layers, asked, radius=3)
    np.testing.assert_allclose(read_exr(folder / "denoised.exr").layers["denoised"], expected, rtol=1e-6)


def test_references_and_what_needs_a_scene(viewer, folder):
    async def conversation(page):
        page.send("compare", reference=str(folder / "reference.exr"))
        progress, _ = await page.until("progress", lambda m: m.get("relmse"))
        image = layers()["image"].astype(float)
        expected = np.mean((0.1 * image) ** 2 / ((1.1 * image) ** 2 + 0.01))
        assert progress["relmse"] == pytest.approx(expected, rel=1e-4)
        for kind, message, words in (
            ("compare", {"reference": str(folder / "small.exr")}, "has 3x2 pixels, the picture 20x12"),
            ("compare", {"method": "path"}, "a picture without a scene"),
            ("render", {"method": "path"}, "a picture without a scene"),
            ("camera", {"orbit": [0.1, 0.0]}, "a picture without a scene"),
            ("lights.add", {"kind": "sky", "colour": [1, 1, 1]}, "a picture without a scene"),
            ("space.mesh", {}, "no scene is loaded"),
            ("save", {"what": "scene", "name": "x.xml"}, "no scene is loaded"),
            ("save", {"what": "picture", "name": "picture.exr"}, "is the picture that is open"),
            ("open", {"scene": str(folder / "missing.exr")}, "no picture"),
        ):
            page.send(kind, **message)
            assert words in (await page.until("error"))[0]["text"], kind
        page.send("save", what="picture", name="kept.exr")
        await page.until("saved")
        assert read_exr(folder / "kept.exr").metadata["method"] == "bpt"
        page.send("open", scene=str(folder / "small.exr"))
        state, _ = await page.until("state", lambda m: m["size"] == [3, 2])
        assert state["layers"] == ["image", LUMINANCE_LAYER]
        page.send("open", scene=str(folder / "picture.exr"))
        await page.until("state", lambda m: tuple(m["size"]) == SIZE)

    talk(viewer, conversation)


def test_a_missing_picture_is_told_at_once(capsys, tmp_path):
    assert main(["view", str(tmp_path / "none.exr"), "--no-browser"]) == 3
    assert "there is no picture" in capsys.readouterr().err


def test_luminance_in_false_colours_follows_the_exposure(viewer, folder):
    """The page's scale has the ends of ``luminances``; the exposure doubles what is black and yellow."""
    image = np.zeros((1, 3, 3), np.float32)
    for x, value in enumerate((2.0**-9, 2.0**-3, 2.0**3)):
        image[0, x] = value  # the ends and the middle of the scale at no exposure
    found = Show(layer=LUMINANCE_LAYER).colours({"image": image}, 0.0)
    assert found.tolist() == [[[0, 0, 4], [186, 54, 85], [252, 255, 164]]]
    assert (Show(layer=LUMINANCE_LAYER).colours({"image": image / 4}, 2.0) == found).all()
    assert luminances(0.0) == (683 / 512, 683 * 8) and luminances(3.0)[1] == 683

    async def conversation(page):
        about, _ = await page.until("about")
        assert about["luminance"]["ends"] == [683 / 512, 683 * 8]
        page.send("show", layer=LUMINANCE_LAYER, exposure=0.0)
        expected = false_colour(683 * layers()["image"] @ np.array(LUMINANCE), *luminances(0.0)).astype(float)
        await shown(page, lambda seen: seen.shape == expected.shape and np.abs(seen - expected).mean() < 12)
        page.send("save", what="picture", name="luminance.png")
        await page.until("saved")
        page.send("show", layer="image", exposure="auto")

    talk(viewer, conversation)
    saved = np.asarray(Image.open(folder / "luminance.png").convert("RGB"))
    assert saved.shape[0] == 12 * 33 and saved.shape[1] > 20 * 33  # enlarged, with a legend
