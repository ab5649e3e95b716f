"""A session with a real scene, by a plain client: pictures, commands, errors, files, memory."""

import asyncio
import contextlib
import gc
import io
import weakref
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from support.viewing import Page
from tornado.websocket import WebSocketClosedError

import etendue
from etendue import film
from etendue.cli.experiments.run_file import RunFile
from etendue.cli.main import main
from etendue.core import Result
from etendue.engine import Budget
from etendue.scene import load
from etendue.viewer.opening import Viewer

SIZE = (48, 36)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("viewer")


@pytest.fixture(scope="module")
def viewer(folder):
    with etendue.view("cornell-box", "path", size=SIZE, spp=4, max_depth=4, folder=folder) as made:
        yield made


def talk(viewer, conversation):
    """Run a conversation with a new page."""

    async def go():
        page = await Page.open(viewer.url)
        try:
            result = await conversation(page)
            # All that it has sent is handled now, not in the middle of the next conversation.
            with contextlib.suppress(AssertionError, WebSocketClosedError):
                page.send("done")
                await page.until("error", lambda m: "'done'" in m["text"])
            return result
        finally:
            page.close()

    return asyncio.run(go())


async def told(page, kind="error"):
    return (await page.until(kind))[0]


async def finished(page, **fields):
    """The progress once the picture is done."""
    done = lambda m: m["done"] and all(m[k] == v for k, v in fields.items())  # noqa: E731
    return (await page.until("progress", done))[0]


def decoded(data):
    return np.asarray(Image.open(io.BytesIO(bytes(data))).convert("RGB"))


def test_the_picture_is_refined_and_moves(viewer):
    async def conversation(page):
        about, _ = await page.until("about")
        state, _ = await page.until("state")
        assert (state["scene"], state["method"], tuple(state["settings"])) == ("cornell-box", "path", ("max_depth",))
        fields = {f["name"]: f for m in about["methods"] if m["name"] == "vcm" for f in m["fields"]}
        assert (
            fields["max_depth"]["kind"] == "int" and fields["max_depth"]["minimum"] == -1 and fields["max_depth"]["doc"]
        )
        assert fields["sampler"]["choices"] and fields["pyramid"]["kind"] == "bool"
        page.send("render", again=True)
        done = await finished(page)
        assert done["samples"] == 4 and done["error"] > 0
        while not page.frames or page.frames[-1][1]["moving"]:  # pictures follow messages
            await page.until("frame")
        still = page.frames[-1][1]
        assert not still["moving"] and (still["width"], still["height"]) == SIZE
        page.send("camera", orbit=[0.3, 0.1])
        moving, data = await page.until("frame", lambda m: m["moving"])
        assert decoded(data).mean() > 10 and moving["width"] <= SIZE[0]
        moved, _ = await page.until("state", lambda m: m["camera"]["origin"] != state["camera"]["origin"])
        assert moved["camera"]["distance"] == pytest.approx(state["camera"]["distance"])
        await finished(page)
        page.send("camera", reset=True)
        await page.until("state", lambda m: m["camera"]["origin"] == state["camera"]["origin"])

    talk(viewer, conversation)


def test_a_drag_is_around_the_point_where_it_begins(viewer):
    async def conversation(page):
        before, _ = await page.until("state")
        page.send("pick", x=0.3, y=0.7)
        picked, _ = await page.until("picked")
        point = np.array(picked["position"])
        page.send("camera", grab=[0.3, 0.7], orbit=[0.05, 0.02])
        after, _ = await page.until("state", lambda m: m["camera"]["origin"] != before["camera"]["origin"])
        away = [np.linalg.norm(np.array(m["camera"]["origin"]) - point) for m in (before, after)]
        assert away[1] == pytest.approx(away[0], rel=1e-5)
        page.send("pick", x=0.3, y=0.7)
        again, _ = await page.until("picked")
        np.testing.assert_allclose(again["position"], point, atol=0.01)
        page.send("camera", grab=[0.3, 1.2], orbit=[0.05, 0.02])
        assert "x and y from 0 to 1" in (await page.until("error"))[0]["text"]
        page.send("camera", reset=True)
        await page.until("state", lambda m: m["camera"]["origin"] == before["camera"]["origin"])

    talk(viewer, conversation)


def test_the_picture_is_that_of_render(viewer, folder):
    """The same passes as `etendue render` makes; the EXR has the layers and how it was made."""

    async def conversation(page):
        page.send("render", method="path", settings={"max_depth": 4, "aovs": True})
        await page.until("state", lambda m: m["settings"].get("aovs"))  # not the picture before this one
        await finished(page)
        page.send("save", what="picture", name="own.exr")
        saved = await told(page, "saved")
        assert saved["path"] == str(folder / "own.exr")
        page.send("render", method="path", settings={"max_depth": 4})

    talk(viewer, conversation)
    own = film.read_exr(folder / "own.exr")
    made = etendue.render("cornell-box", "path", spp=4, samples_per_pass=1, size=SIZE, seed=0, max_depth=4, aovs=True)
    # The viewer's camera is put together from position and direction, so that rays differ by rounding.
    assert film.relative_mse(own.layers["image"], made.image, trim=0.01) < 1e-8
    assert own.layers.keys() >= {"albedo", "normal", "variance"} and own.metadata["samples"] == 4


def test_a_place_in_the_picture(viewer):
    async def conversation(page):
        page.send("pick", x=0.3, y=0.96)
        found = await told(page, "picked")
        assert "floor" in found["shape"] and "white" in found["material"] and not found["emits"]
        assert found["position"][1] == pytest.approx(-1.0, abs=1e-4) and found["depth"] > 1
        page.send("camera", set={"origin": [0, 0, -50], "target": [0, 0, -60]})
        page.send("pick", x=0.5, y=0.5)
        assert (await told(page, "picked"))["shape"] is None
        page.send("camera", reset=True)

    talk(viewer, conversation)


@pytest.mark.parametrize(
    ("kind", "fields", "words"),
    [
        ("render", {"method": "vmc"}, "no method 'vmc'"),
        ("render", {"settings": {"max_depth": "nan"}}, "must be a whole number"),
        ("render", {"settings": {"clamp": "nan"}}, "must be finite"),
        ("render", {"settings": {"depth": 3}}, "has no option 'depth'"),
        ("render", {"settings": []}, "names with values"),
        ("render", {"budget": {"seconds": -1}}, "must be a number above 0"),
        ("render", {"budget": {"hours": 1}}, "a budget has"),
        ("render", {"size": [0, 5]}, "sides of a picture"),
        ("render", {"size": [1e9, 5]}, "sides of a picture"),
        ("camera", {"orbit": ["a", 1]}, "must be a finite number"),
        ("camera", {"set": {"origin": [0, 0, 0], "target": [0, 0, 0]}}, "target is its origin"),
        ("camera", {"set": {"fov": 190}}, "between 0 and 180"),
        ("pick", {"x": 2, "y": 0}, "from 0 to 1"),
        ("show", {"denoise": "magic"}, "no denoiser"),
        ("show", {"curve": "magic"}, "no tone curve"),
        ("show", {"exposure": "bright"}, "number of stops or auto"),
        ("show", {"layer": "nothing"}, "no layer"),
        ("views", {"show": 7}, "no view 7"),
        ("views", {"show": "next"}, "no saved view"),
        ("compare", {"reference": "no.exr"}, "no.exr"),
        ("compare", {"method": "vmc"}, "no method"),
        ("open", {"scene": "no-such-scene"}, "no scene file 'no-such-scene'"),
        ("open", {"scene": " "}, "give a scene file"),
        ("save", {"what": "picture", "name": "../x.png"}, "without a folder"),
        ("save", {"what": "picture", "name": "x.gif"}, ".exr or .png"),
        ("save", {"what": "soul", "name": "x"}, "what can be saved"),
        ("show", {"radius": 2.5}, "from 1 to 64"),
        ("show", {"strength": 0}, "above 0"),
        ("dance", {}, "no message 'dance'"),
        ("lights.remove", {"index": 0}, "no light 0"),
        ("lights.add", {"kind": "point", "colour": [1, 1, -1], "position": [0, 0, 0]}, "not negative"),
        ("lights.add", {"kind": "lava", "colour": [1, 1, 1], "position": [0, 0, 0]}, "a light is one of"),
        ("pyramid.show", {}, "no technique pyramid"),
    ],
)
def test_what_is_wrong_is_told_in_one_line_and_the_session_lives(viewer, kind, fields, words, caplog):
    async def conversation(page):
        page.send(kind, **fields)
        text = (await told(page))["text"]
        assert words in text and "\n" not in text and "Traceback" not in text
        assert (await told(page, "state"))["scene"] == "cornell-box"  # so that fields show what holds

    talk(viewer, conversation)
    assert any(words in record.message for record in caplog.records)  # in the terminal, too


def test_a_filter_without_its_layer_is_told_and_left_out(viewer):
    async def conversation(page):
        page.send("show", denoise="nlm")
        assert "needs the variance of 'image'" in (await told(page))["text"]
        assert (await page.until("state", lambda m: m["show"]["denoise"] == ""))[0]["loaded"]
        # With it, the filter stays when the picture starts anew, though one pass has no variance.
        page.send("render", settings={"max_depth": 4, "aovs": True})
        await finished(page)
        page.send("show", denoise="nlm")
        page.send("render", again=True)
        await page.until("state", lambda m: m["preparing"])
        await finished(page)
        page.send("show", radius=3)
        assert (await told(page, "state"))["show"]["denoise"] == "nlm"
        page.send("render", settings={"max_depth": 4})
        page.send("show", denoise="gaussian", curve="agx", exposure=0.5)
        await page.until("frame", lambda m: not m["moving"])
        page.send("show", denoise="", curve="srgb", exposure="auto")

    talk(viewer, conversation)


def test_two_pages_see_the_same(viewer):
    async def go():
        first, second = await Page.open(viewer.url), await Page.open(viewer.url)
        first.send("show", curve="filmic")
        for page in (first, second):
            await page.until("state", lambda m: m["show"]["curve"] == "filmic")
        first.close()
        second.send("show", curve="srgb")
        await second.until("state", lambda m: m["show"]["curve"] == "srgb")
        second.close()

    asyncio.run(go())


def test_beside_a_second_method_and_a_reference(viewer, folder):
    reference = etendue.render("cornell-box", "path", spp=64, size=SIZE, seed=5, max_depth=4)
    reference.save(folder / "reference.exr")

    async def conversation(page):
        page.send("compare", method="light")
        both = (await page.until("progress", lambda m: m.get("other") and m["other"]["samples"] >= 4))[0]
        assert both["other"]["method"] == "light" and both["relmse"] > 0
        assert viewer._session.compared.refinement.settings.max_depth == 4  # that of the first method
        page.send("compare", reference=str(folder / "reference.exr"))
        await page.until("state", lambda m: m["compared"] and m["compared"]["reference"])
        page.send("render", again=True)
        done = await finished(page)
        page.send("compare", reference=str(folder / "reference.exr"), map=True)
        await page.until("frame", lambda m: m["side"] == "b")
        # A filter that suits the first picture only leaves the second as it is, and the session goes on.
        page.send("compare", reference=str(folder / "reference.exr"), map=False)
        page.send("render", settings={"max_depth": 4, "aovs": True})
        await finished(page)
        page.send("show", denoise="nlm")
        assert "the second picture is not denoised" in (await told(page))["text"]
        await finished(page)
        page.send("show", denoise="")
        page.send("render", settings={"max_depth": 4})
        await finished(page)
        page.send("compare")
        await page.until("state", lambda m: m["compared"] is None)
        return done["relmse"]

    found = talk(viewer, conversation)
    own = etendue.render("cornell-box", "path", spp=4, samples_per_pass=1, size=SIZE, seed=0, max_depth=4)
    assert found == pytest.approx(film.relative_mse(own.image, reference.image), rel=1e-6)


def test_a_page_that_connects_later_sees_only_the_scene_that_is_open(viewer):
    async def go():
        first = await Page.open(viewer.url)
        first.send("render", paused=False, again=True)
        first.send("compare", method="light")
        await first.until("frame", lambda m: m["side"] == "b")
        first.send("render", paused=True)  # so that the opened scene has no progress
        first.send("open", scene="cornell-box")
        await first.until("state", lambda m: m["paused"] and m["compared"] is None)
        await first.until("frame", lambda m: m["moving"])
        second = await Page.open(viewer.url)
        await second.until("state")
        earlier = [(await second.next())[0]]  # messages come before pictures, and older pictures before newer ones
        while earlier[-1]["type"] != "frame":
            earlier.append((await second.next())[0])
        assert earlier[-1]["side"] == "a" and "progress" not in [fields["type"] for fields in earlier]
        second.send("render", paused=False)
        await second.until("state", lambda m: not m["paused"])
        first.close()
        second.close()

    asyncio.run(go())


def test_a_reference_of_another_size_keeps_the_views(viewer, folder):
    film.write_exr(folder / "small.exr", Result({"image": np.ones((12, 16, 3), np.float32)}, {}))

    async def conversation(page):
        page.send("views", save=True)
        page.send("compare", reference=str(folder / "small.exr"))
        state, _ = await page.until("state", lambda m: m["compared"] and m["size"] == [16, 12])
        assert state["views"] == 1
        page.send("compare")
        page.send("render", size=list(SIZE))
        page.send("views", remove=0)
        await page.until("state", lambda m: m["size"] == list(SIZE) and m["views"] == 0)

    talk(viewer, conversation)


def test_panels_work_while_the_picture_is_paused(viewer, monkeypatch):
    """Such as a solution of radiosity, also after the camera was moved."""
    session, calls = viewer._session, []
    monkeypatch.setattr(session.panels["pyramid"], "work", lambda: calls.append(0))

    async def conversation(page):
        page.send("render", paused=True)
        page.send("camera", orbit=[0.1, 0.0])
        await page.until("frame", lambda m: m["moving"])
        before = len(calls)
        async with asyncio.timeout(30):
            while len(calls) <= before:  # once the camera is at rest
                await asyncio.sleep(0.02)
        page.send("pick", x=0.3, y=0.96)
        assert (await told(page, "picked"))["radiance"] is None  # the picture is that of the view before
        page.send("show", exposure=3.0)
        brighter = (await page.until("frame", lambda m: m["moving"]))[1]
        page.send("show", exposure=-3.0)
        darker = (await page.until("frame", lambda m: m["moving"]))[1]
        assert decoded(brighter).mean() > decoded(darker).mean() + 20
        page.send("show", exposure="auto")
        page.send("camera", reset=True)
        page.send("render", paused=False)
        await finished(page)

    talk(viewer, conversation)


def test_the_run_file_and_the_scene_repeat_the_picture(viewer, folder):
    """From another view and with a light added: the XML has both, and the run file renders the same picture."""

    async def conversation(page):
        page.send("lights.add", kind="point", colour=[1, 1, 1], strength=2, position=[0, 0, 0.5])
        added = await page.until("state", lambda m: m["panels"]["lights"]["added"])
        assert added[0]["panels"]["lights"]["own"][0]["name"].startswith("area")
        page.send("camera", orbit=[0.2, 0.1], zoom=0.1)
        await page.until("frame", lambda m: m["moving"])
        await finished(page)
        page.send("save", what="picture", name="lit.exr")
        await told(page, "saved")
        page.send("save", what="run", name="lit.toml")
        await told(page, "saved")
        page.send("lights.remove", index=0)
        await page.until("state", lambda m: not m["panels"]["lights"]["added"])
        page.send("camera", reset=True)
        await finished(page)
        page.send("save", what="run", name="plain.toml")
        await told(page, "saved")
        page.send("save", what="run", name="timed.toml", times="2, 5.5")
        await told(page, "saved")
        page.send("save", what="run", name="timed.toml", times="5, 2")
        assert "times of saves must be above 0 seconds and grow" in (await told(page))["text"]
        page.send("save", what="run", name="timed.toml", times="soon")
        assert "as 20, 60, not 'soon'" in (await told(page))["text"]

    talk(viewer, conversation)
    timed = RunFile.read(folder / "timed.toml")
    assert timed.save_at == (2.0, 5.5) and timed.budget == Budget(seconds=5.5)
    lit, plain = RunFile.read(folder / "lit.toml"), RunFile.read(folder / "plain.toml")
    assert lit.scene == folder / "lit-scene.xml" and str(plain.scene) == "cornell-box"
    assert (plain.method, plain.size, plain.budget.samples) == ("path", SIZE, 4)
    problem = load(lit.scene, size=lit.size)
    assert len(problem.scene.emitters()) == 2
    wanted = film.read_image(folder / "lit.exr")
    made = etendue.render(str(lit.scene), "path", spp=4, samples_per_pass=1, size=SIZE, max_depth=4)
    # The XML has the numbers of the camera in decimal.
    assert film.relative_mse(made.image, wanted) < 1e-3
    assert np.mean(made.image) == pytest.approx(np.mean(wanted), rel=1e-3)
    for name, again in (("lit", made.image), ("plain", None)):
        assert main(["run", str(folder / f"{name}.toml")]) == 0
        image = film.read_image(folder / f"{name}-run.exr")
        assert image.shape[1::-1] == SIZE
        assert again is None or np.mean(image) == pytest.approx(np.mean(again), rel=0.05)  # other samples a pass


def test_a_scene_that_fails_to_load_says_so_and_another_can_be_opened(folder):
    broken = folder / "broken.xml"
    broken.write_text('<scene version="3.0.0"><shape type="sphere"><bsdf type="no_such_bsdf"/></shape></scene>')
    with etendue.view(str(broken), size=SIZE) as viewer:

        async def conversation(page):
            state, _ = await page.until("state")
            assert not state["loaded"] and "no_such_bsdf" in state["trouble"] and state["panels"] is not None
            page.send("pick", x=0.5, y=0.5)
            assert "no scene is loaded" in (await told(page))["text"]
            page.send("open", scene="cornell-box")
            opened, _ = await page.until("state", lambda m: m["loaded"])
            assert opened["scene"] == "cornell-box" and not opened["trouble"]
            await page.until("frame")

        talk(viewer, conversation)


def test_a_method_that_refuses_the_scene_says_so(folder):
    """`light` cannot connect surfaces to an orthographic sensor."""
    scene = etendue.scene.bundled_scene("cornell-box").build()
    scene["sensor"] = {"type": "orthographic", "film": scene["sensor"]["film"], "sampler": scene["sensor"]["sampler"]}
    scene["sensor"]["to_world"] = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    with etendue.view(scene, "light", size=SIZE) as viewer:

        async def conversation(page):
            state, _ = await page.until("state", lambda m: m["trouble"])
            assert "cannot be connected to this sensor" in state["trouble"]
            page.send("render", method="path", settings={"max_depth": 2})
            await page.until("progress", lambda m: m["passes"] >= 2)
            # As a second method it is left out, and the picture goes on.
            page.send("compare", method="light")
            assert "the comparison is ended: " in (await told(page))["text"]
            state, _ = await page.until("state")
            assert state["compared"] is None and not state["trouble"]
            await page.until("progress", lambda m: m["passes"] >= 2)

        talk(viewer, conversation)


def test_a_session_that_is_closed_releases_its_scene():
    scene = mi.load_dict(etendue.scene.bundled_scene("cornell-box").build())
    viewer = etendue.view(scene, "path", size=SIZE, max_depth=3)
    session = viewer._session

    async def conversation(page):
        await page.until("progress", lambda m: m["passes"] >= 2)
        page.send("lights.add", kind="sky", colour=[1, 1, 1])
        assert "give its file or its dictionary" in (await told(page))["text"]
        (moving,) = session._preview._made.values()
        return weakref.ref(session.problem), weakref.ref(session.main), weakref.ref(moving)

    kept = talk(viewer, conversation)
    assert all(one() is not None for one in kept)
    viewer.close()
    gc.collect()
    assert all(one() is None for one in kept) and viewer.wait(0)
    assert "ended" in repr(viewer) and "ended" in viewer._repr_html_()
    viewer.close()
    late = SimpleNamespace(said=[], send=lambda kind, text: late.said.append((kind, text)))
    session.join(late)
    assert late.said == [("note", "The session has ended; this page can be closed.")]


def test_a_device_without_memory_while_moving_makes_coarser_pictures(viewer, monkeypatch):
    """The first pass of each resolution fails as Dr.Jit does."""
    from etendue.viewer import preview

    real, failed = preview.Moving.picture, []

    def fails(own, pose):
        if not failed:
            failed.append(own)
            raise RuntimeError("jit_cuda_malloc(): out of memory! Could not allocate 4 GiB")
        return real(own, pose)

    async def conversation(page):
        await page.until("frame")
        monkeypatch.setattr(preview.Moving, "picture", fails)
        monkeypatch.setattr(preview, "_LEAST_PIXELS", 1)
        page.send("camera", orbit=[0.1, 0.0])
        assert "out of memory" in (await told(page))["text"]
        moving, _ = await page.until("frame", lambda m: m["moving"])
        assert moving["width"] < SIZE[0]
        page.send("camera", reset=True)
        await finished(page)

    talk(viewer, conversation)


def test_in_a_notebook_and_with_wrong_arguments():
    with etendue.view("cornell-box", size=SIZE) as viewer:
        assert isinstance(viewer, Viewer)
        assert f'data="{viewer.url}"' in viewer._repr_html_() and viewer.url.startswith("http://127.0.0.1:")
    for arguments, words in (
        ({"method": "vmc"}, "no method"),
        ({"port": 70000}, "a port is"),
        ({"max_depth": "x"}, "whole number"),
        ({"seconds": -1}, "above 0"),
    ):
        with pytest.raises(etendue.OptionError, match=words):
            etendue.view("cornell-box", **arguments)
