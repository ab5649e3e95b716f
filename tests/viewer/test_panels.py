"""The panels of the scene and of the 3-D view by a plain client: edits, what is drawn, and tev as a second display."""

from __future__ import annotations

import asyncio
import math

import numpy as np
import pytest
from support.tev import fake_tev
from support.viewing import Page

import etendue
from etendue import methods
from etendue.core import Result
from etendue.film import read_exr, write_exr
from etendue.scene import SceneEditor, bundled_scene, load, name_elements

SIZE = (32, 24)
#: A scene that is parsed, but not built.
BROKEN = """<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant"/><shape type="sphere">
<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="nowhere.png"/></texture>
</bsdf></shape></scene>"""


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("panels")
    with etendue.view("cornell-glass", "path", size=SIZE, spp=4, max_depth=4, folder=folder) as made:
        yield made, folder


def talk(viewer, conversation):
    async def go():
        page = await Page.open(viewer.url)
        try:
            return await conversation(page)
        finally:
            page.close()

    return asyncio.run(go())


async def state(page, test=lambda own: True):
    found, _ = await page.until("state", lambda m: m["loaded"] and test(m["panels"]["parameters"]))
    return found["panels"]


async def done(page):
    return (await page.until("progress", lambda m: m["done"]))[0]


def arrays(message, data):
    found = {}
    for row in message["arrays"]:
        count = math.prod(row["shape"])
        kind = {"float32": "<f4", "uint32": "<u4", "uint8": "u1", "int8": "i1"}[row["type"]]
        found[row["name"]] = np.frombuffer(data, kind, count, row["offset"]).reshape(row["shape"])
    return found


def test_an_edit_is_in_the_picture_in_the_file_and_after_a_light_is_added(viewer):
    """The picture after an edit is that of the written scene, read by a fresh method: no table of lights is old."""
    made, folder = viewer
    broken = folder / "broken.xml"
    broken.write_text(BROKEN)
    lamp, metal = "light.emitter.radiance.value", "large-box.bsdf.alpha.value"

    async def conversation(page):
        own = (await state(page))["parameters"]
        values = {p["key"]: p["value"] for p in own["parameters"]}
        assert values[metal] == 0.15 and own["changes"] == {}
        for key, value, words in (
            (lamp, [1, None, 1], "numbers"),
            (lamp, [1, -1, 1], "at least 0"),
            (metal, 3, "at most 1"),
            ("nobody.home", 1, "no parameter"),
        ):
            page.send("parameters.set", key=key, value=value)
            error, _ = await page.until("error")
            assert words in error["text"] and "\n" not in error["text"]
            assert (await state(page))["parameters"]["changes"] == {}
        page.send("parameters.set", key=lamp, value=[2.0, 30.0, 1.0])
        page.send("parameters.set", key=metal, value=0.5)
        own = (await state(page, lambda own: len(own["changes"]) == 2))["parameters"]
        assert own["own"][metal] == 0.15
        # A scene that cannot be loaded leaves the one of before, and what was changed in it.
        page.send("open", scene=str(broken))
        assert "nowhere.png" in (await page.until("error"))[0]["text"]
        assert len((await state(page))["parameters"]["changes"]) == 2
        page.send("lights.add", kind="point", position=[0, 0.5, 0.5], colour=[1, 1, 1], strength=0.2)
        own = (await state(page))["parameters"]
        assert {p["key"]: p["value"] for p in own["parameters"]}[lamp] == [2.0, 30.0, 1.0]
        await done(page)
        for what, name in (("picture", "edited.exr"), ("scene", "edited.xml")):
            page.send("save", what=what, name=name)
            await page.until("saved")
        page.send("parameters.reset")
        own = (await state(page, lambda own: own["changes"] == {}))["parameters"]
        assert {p["key"]: p["value"] for p in own["parameters"]}[lamp] == values[lamp]

    talk(made, conversation)
    shown = read_exr(folder / "edited.exr").image
    problem = load(folder / "edited.xml", size=SIZE)
    kind = methods.get("path")
    method = kind(kind.Settings(max_depth=4, samples_per_pass=1))
    method.prepare(problem, 0)
    made_anew = method.start(), [method.step(i, 0, {}).measurement for i in range(4)]
    total = made_anew[1][0]
    for more in made_anew[1][1:]:
        total = total + more
    np.testing.assert_allclose(method.develop(total, {}).image, shown, rtol=2e-3, atol=1e-4)


def test_a_lamp_that_is_switched_off_leaves_a_black_picture(tmp_path):

    async def conversation(page):
        await state(page)
        page.send("parameters.set", key="light.emitter.radiance.value", value=[0.0, 0.0, 0.0])
        await state(page, lambda own: len(own["changes"]) == 1)
        await done(page)
        page.send("save", what="picture", name="black.exr")
        await page.until("saved")
        page.send("parameters.reset")
        await state(page, lambda own: own["changes"] == {})

    with etendue.view("cornell-glass", "path", size=SIZE, spp=1, max_depth=4, folder=tmp_path) as made:
        talk(made, conversation)
    assert not read_exr(tmp_path / "black.exr").image.any()


def test_changes_are_kept_if_a_texture_cannot_be_loaded(tmp_path):
    """The panel then lists the changes that the scene has; a picture that is opened next has none."""
    lamp, sky, broken = "light.emitter.radiance.value", "sky.data", tmp_path / "broken.exr"
    for name in ("own", "other"):
        write_exr(tmp_path / f"{name}.exr", Result({"image": np.ones((4, 8, 3), np.float32)}))
    broken.write_bytes(b"no picture")
    scene = bundled_scene("cornell-box").build()
    scene["sky"] = {"type": "envmap", "filename": str(tmp_path / "own.exr")}
    with etendue.view(scene, "path", size=SIZE, spp=1, max_depth=2, folder=tmp_path) as made:

        async def conversation(page):
            page.send("parameters.set", key=lamp, value=[2.0, 30.0, 1.0])
            await state(page, lambda own: lamp in own["changes"])
            page.send("parameters.set", key=sky, value=str(broken))
            await page.until("error")
            own = (await state(page))["parameters"]
            assert own["changes"].keys() == own["own"].keys() == {lamp}
            page.send("parameters.set", key=sky, value=str(tmp_path / "other.exr"))
            changes = (await state(page, lambda own: sky in own["changes"]))["parameters"]["changes"]
            (tmp_path / "own.exr").write_bytes(b"no picture")
            page.send("parameters.reset")
            await page.until("error")
            own = (await state(page))["parameters"]
            assert own["changes"] == changes
            assert {p["key"]: p["value"] for p in own["parameters"]}[lamp] == changes[lamp]
            page.send("parameters.set", key=sky, value=str(broken))
            await page.until("error")
            page.send("open", scene=str(tmp_path / "other.exr"))
            found, _ = await page.until("state", lambda m: m["still"])
            assert found["panels"]["parameters"] == {"parameters": [], "changes": {}, "own": {}}

        talk(made, conversation)


@pytest.mark.slow
def test_an_edit_of_a_mesh_in_memory_stays_when_a_light_is_added(tmp_path):
    """The meshes of `caustics` are built by code; the file that is saved has them as files."""
    key = "stone.bsdf.specular_transmittance.value"
    with etendue.view("caustics", "path", size=SIZE, spp=1, max_depth=2, folder=tmp_path) as made:

        async def conversation(page):
            own = (await state(page))["parameters"]
            assert key in {p["key"] for p in own["parameters"]}
            page.send("parameters.set", key=key, value=[0.5, 0.25, 0.75])
            await state(page, lambda own: own["changes"])
            page.send("lights.add", kind="sky", colour=[1, 1, 1])
            found, _ = await page.until("state", lambda m: m["panels"]["lights"]["added"])
            own = found["panels"]["parameters"]
            assert own["changes"] == {key: [0.5, 0.25, 0.75]}
            assert {p["key"]: p["value"] for p in own["parameters"]}[key] == [0.5, 0.25, 0.75]
            page.send("save", what="scene", name="edited.xml")
            await page.until("saved")

        talk(made, conversation)
    assert (tmp_path / "edited-files" / "stone.ply").is_file()
    found = SceneEditor(load(tmp_path / "edited.xml", size=SIZE, change=name_elements).scene)
    assert found.get(key).value == [0.5, 0.25, 0.75]


@pytest.mark.slow
def test_what_the_3d_view_asks_for(viewer):
    made, _ = viewer

    async def conversation(page):
        page.send("space.mesh")
        message, data = await page.until("space.mesh")
        mesh = arrays(message, data)
        assert mesh["triangles"].shape[1:] == (3, 3) and mesh["shape"].max() < len(message["names"])
        page.send("space.paths", source="camera", x=0.5, y=0.5, count=20, depth=4)
        assert "process" in (await page.until("space.busy"))[0]["text"]
        assert "compiled" in (await page.until("space.busy", lambda m: "compiled" in m["text"]))[0]["text"]
        message, data = await page.until("space.paths")
        assert len(arrays(message, data)["edges"]) >= 20 and message["method"] == message["shown"] == "path"
        await page.until("space.busy", lambda m: m == {"type": "space.busy", "verb": "paths", "text": ""})
        page.send("space.photons", count=200, file="")
        message, data = await page.until("space.photons")
        found = arrays(message, data)
        assert found["power"].sum(axis=0).mean() == pytest.approx(message["total"], rel=1e-4)
        page.send("space.tree", kind="kd-tree", count=200)
        message, data = await page.until("space.trees")
        boxes = arrays(message, data)["corners"]
        assert boxes.shape[1:] == (8, 3)
        for verb, fields, words in (
            ("paths", {"count": 0}, "number of paths"),
            ("paths", {"count": 5, "x": 7}, "off the film"),
            ("paths", {"count": 5, "source": "9"}, "no light 9"),
            ("photons", {"count": 5, "file": "missing.particles"}, "no file"),
            ("tree", {"kind": "oak", "count": 5}, "no tree 'oak'"),
            ("guide", {"position": [0, 0, 0], "normal": [0, 0, 1]}, "no guide"),
            ("solve", {}, "transmits"),  # the glass ball
            ("dance", {}, "space.dance"),
        ):
            page.send(f"space.{verb}", **fields)
            error, _ = await page.until("error")
            assert words in error["text"], error["text"]

    talk(made, conversation)


def test_tev_shows_what_the_viewer_shows():
    small = {"size": (16, 12), "spp": 2}
    with fake_tev() as server, etendue.view("cornell-box", "path", tev=server.address, **small) as made:
        talk(made, done)
    shown = server.images["etendue view"]["R"]
    assert shown.shape == (12, 16) and shown.mean() > 0
