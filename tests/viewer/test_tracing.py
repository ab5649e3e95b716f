"""The process beside a session: pictures go on while it works, it has the scene as it is shown, and it ends."""

from __future__ import annotations

import asyncio
import math
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.viewing import Page

import etendue
from etendue.scene import load
from etendue.transport import Edge, Event
from etendue.viewer.camera import Pose, held_back, place
from etendue.viewer.commands import _seen_at
from etendue.viewer.refining import Budget, Refinement
from etendue.viewer.tracing import TracingProcess, child

SIZE = (48, 36)


def talk(viewer: Any, conversation: Any) -> Any:
    async def go() -> Any:
        page = await Page.open(viewer.url)
        try:
            return await conversation(page)
        finally:
            page.close()

    return asyncio.run(go())


def arrays(message: Any, data: bytes) -> dict[str, np.ndarray]:
    found = {}
    for row in message["arrays"]:
        kind = {"float32": "<f4", "uint32": "<u4", "uint8": "u1"}[row["type"]]
        found[row["name"]] = np.frombuffer(data, kind, math.prod(row["shape"]), row["offset"]).reshape(row["shape"])
    return found


async def rays(page: Page, test: Any = lambda message: True, **fields: Any) -> tuple[Any, dict[str, np.ndarray]]:
    page.send("space.paths", **{"source": "camera", "x": 0.5, "y": 0.9, "count": 50} | fields)
    message, data = await page.until("space.paths", test)
    return message, arrays(message, data)


async def passes(page: Page, least: int) -> None:
    await page.until("progress", lambda m: m["passes"] >= least)


# -- pictures go on ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_solution_of_radiosity_is_made_by_the_process(tmp_path: Any) -> None:
    async def conversation(page: Page) -> None:
        await passes(page, 2)
        before = len(page.frames)
        page.send("space.solve", area=0.5, file="")
        await page.until("space.solution")
        await page.until("space.values", lambda m: m["bundles"] > 0)
        assert len(page.frames) - before >= 3
        page.send("space.mesh")  # as a page that is opened later
        await page.until("space.mesh")
        for verb in ("solution", "values"):
            await page.until(f"space.{verb}")
        page.send("space.stop")
        await page.until("state", lambda m: not m["panels"]["space"]["solving"])

    with etendue.view("cornell-box", "path", size=SIZE, max_depth=4, folder=tmp_path) as viewer:
        talk(viewer, conversation)


def kernels(work: Any) -> set[Any]:
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        work()
        history = dr.kernel_history()
    return {entry["hash"] for entry in history if entry["type"] == dr.KernelType.JIT}


def test_clicks_and_orbits_have_the_same_kernels_everywhere() -> None:
    """Each new kernel takes a tenth of a second or more, during which the picture stands still."""
    problem = load("cornell-glass", size=(32, 32))
    pose = Pose.of(problem)

    def click(x: float, y: float) -> None:
        si, _ = _seen_at(problem, pose, x, y)
        for value in (si.p, si.sh_frame.n, si.uv, si.t, si.prim_index):
            np.asarray(value)

    def orbit(angle: float) -> None:
        held_back(problem, pose, pose.orbited(angle, 0.1 * angle))

    clicked, moved = kernels(lambda: click(0.5, 0.5)), kernels(lambda: orbit(0.1))
    assert clicked and moved
    assert not kernels(lambda: [click(0.1 * k, 0.07 * k) for k in range(1, 6)]) - clicked
    assert not kernels(lambda: [orbit(0.1 * k) for k in range(2, 6)]) - moved


def test_a_pass_after_a_click_has_the_kernels_of_the_pass_before() -> None:
    problem = load("cornell-glass", size=(32, 32))
    pose = Pose.of(problem)
    place(problem.sensor, pose)
    picture = Refinement(problem, "vcm", {}, Budget())
    before = kernels(lambda: [picture.step() for _ in range(3)])
    _seen_at(problem, pose, 0.4, 0.3)
    assert not kernels(picture.step) - before


# -- the scene as it is shown --------------------------------------------------------------------------------------


def test_the_process_has_the_lights_the_changes_and_the_camera_of_the_session(tmp_path: Any) -> None:
    """Light paths begin at an added light, where it was moved to; camera paths at the camera. Between question and
    answer several pictures are shown; each is a pass or more."""

    async def conversation(page: Page) -> None:
        await passes(page, 1)
        page.send("lights.add", kind="point", position=[0, 0.5, 0.5], colour=[1, 1, 1], strength=0.2)
        page.send("lights.switch", index=0)
        await page.until("state", lambda m: any(light["off"] for light in m["panels"]["lights"]["own"]))
        page.send("parameters.set", key="added-light-1.position", value=[0.25, 0.5, -0.25])
        await page.until("state", lambda m: m["panels"]["parameters"]["changes"])
        page.send("camera", set={"origin": [0.1, 0.2, 3.5], "target": [0, 0, 0]})
        await passes(page, 3)
        before = len(page.frames)
        message, found = await rays(page, source="lights")
        assert len(page.frames) - before >= 3
        assert message["arrays"][0]["name"] == "edges"
        first = found["number"] == 1
        assert (found["kind"] == Edge.LIGHT).all() and first.sum() == 50
        np.testing.assert_allclose(found["edges"][first, 0], [[0.25, 0.5, -0.25]] * 50, atol=1e-5)
        _, found = await rays(page)
        first = (found["kind"] == Edge.CAMERA) & (found["number"] == 1)
        away = found["edges"][first, 0] - [0.1, 0.2, 3.5]
        assert np.linalg.norm(away, axis=1).max() < 0.1  # at the near plane

    with etendue.view("cornell-box", "path", size=SIZE, max_depth=4, folder=tmp_path) as viewer:
        talk(viewer, conversation)


@pytest.mark.slow
def test_the_process_has_what_the_method_has_learned(tmp_path: Any) -> None:
    async def conversation(page: Page) -> None:
        await passes(page, 8)
        message, found = await rays(page, count=200)
        assert message["shown"] == "guided" and (found["event"] == Event.GUIDED).sum() > 20

    with etendue.view("cornell-box", "guided", size=SIZE, max_depth=6, samples_per_pass=8, folder=tmp_path) as viewer:
        talk(viewer, conversation)


@pytest.mark.slow
def test_rays_follow_the_method_and_the_passes(tmp_path: Any) -> None:
    async def conversation(page: Page) -> None:
        await passes(page, 1)
        message, found = await rays(page, follow=True)
        assert message["method"] == "path" and set(found["kind"]) == {Edge.CAMERA, Edge.NEXT_EVENT}
        page.send("render", method="vcm", settings={})
        message, data = await page.until("space.paths", lambda m: m["method"] == "vcm")
        assert {Edge.CAMERA, Edge.LIGHT, Edge.CONNECTION, Edge.MERGE} <= set(arrays(message, data)["kind"])
        page.send("render", method="pssmlt", settings={})
        message, _ = await page.until("space.paths", lambda m: m["method"] == "pssmlt")
        assert message["shown"] == "path"
        page.send("space.stay")
        page.send("render", method="path", settings={})
        for _ in range(8):
            found, _ = await page.next()
            assert found["type"] != "space.paths" or found["method"] != "path"
        await passes(page, 20)

    with etendue.view("cornell-box", "path", size=SIZE, folder=tmp_path) as viewer:
        talk(viewer, conversation)


# -- its end -------------------------------------------------------------------------------------------------------


def started(monkeypatch: pytest.MonkeyPatch) -> list[TracingProcess]:
    """The processes that panels start from now on."""
    found: list[TracingProcess] = []

    def start(reply: Any) -> TracingProcess:
        found.append(TracingProcess(reply))
        return found[-1]

    monkeypatch.setattr("etendue.viewer.panels.space.TracingProcess", start)
    return found


def test_the_process_ends_with_the_viewer_while_it_works(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    processes = started(monkeypatch)

    async def conversation(page: Page) -> None:
        await passes(page, 1)
        page.send("space.paths", source="camera", x=0.5, y=0.5, count=50)
        await page.until("space.busy", lambda m: m["text"])

    with etendue.view("cornell-box", "vcm", size=SIZE, folder=tmp_path) as viewer:
        talk(viewer, conversation)
    (process,) = processes
    assert process._process.wait(10) != 0


@pytest.mark.slow
def test_a_process_that_dies_is_told_and_replaced(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    processes = started(monkeypatch)

    async def conversation(page: Page) -> None:
        await passes(page, 1)
        page.send("space.paths", source="camera", x=0.5, y=0.5, count=50)
        await page.until("space.busy", lambda m: "loading" in m["text"])
        processes[0]._process.kill()
        error, _ = await page.until("error")
        assert "has ended" in error["text"] and "try again" in error["text"]
        message, _ = await rays(page)
        assert message["method"] == "path" and len(processes) == 2
        processes[1]._process.kill()  # idle: nobody need be told
        processes[1]._process.wait()
        assert (await rays(page))[0]["method"] == "path"

    with etendue.view("cornell-box", "path", size=SIZE, max_depth=4, folder=tmp_path) as viewer:
        talk(viewer, conversation)


def test_the_process_ends_when_nobody_reads_or_writes() -> None:
    """As when the session's process was killed."""
    process = TracingProcess(lambda reply: None)
    process._process.stdin.close()  # type: ignore[union-attr]
    assert process._process.wait(60) == 0


def test_the_process_ends_when_there_is_nothing_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    import io
    import queue

    monkeypatch.setattr(child, "_PATIENCE", 0.05)
    begin = time.monotonic()
    child._Worker(io.BytesIO()).run(queue.SimpleQueue())
    assert time.monotonic() - begin < 10


# -- scenes that cannot be given away ------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["loaded", "object"])
def test_a_scene_in_memory_is_traced_by_the_session(kind: str, tmp_path: Any) -> None:
    """And the page is told why the picture waits."""
    scene: Any = {
        "type": "scene",
        "camera": {"type": "perspective", "to_world": mi.ScalarTransform4f().translate([0, 0, -0.9])},
        "room": {"type": "cube", "flip_normals": True, "bsdf": {"type": "diffuse"}},
        "lamp": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0.9, 0]).rotate([1, 0, 0], 90).scale(0.2),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5}},
        },
    }
    if kind == "loaded":
        scene = mi.load_dict(scene)
    else:
        scene["ball"] = mi.load_dict({"type": "sphere", "radius": 0.2})

    async def conversation(page: Page) -> None:
        await passes(page, 1)
        page.send("space.paths", source="camera", x=0.5, y=0.5, count=20)
        busy, _ = await page.until("space.busy", lambda m: "another process" in m["text"])
        assert "in memory" in busy["text"]
        await page.until("space.paths")
        page.send("space.solve", area=1.0, file="")
        await page.until("space.values", lambda m: m["bundles"] > 0)
        page.send("space.stop")
        page.send("space.paths", source="9", count=20)
        assert "no light 9" in (await page.until("error"))[0]["text"]

    with etendue.view(scene, "path", size=SIZE, max_depth=4, folder=tmp_path) as viewer:
        talk(viewer, conversation)


@pytest.mark.slow
@pytest.mark.parametrize(("change", "words"), [("larger", "has changed"), ("broken", "")])
def test_a_scene_that_the_process_cannot_load_is_traced_by_the_session(change: str, words: str, tmp_path: Any) -> None:
    """Its file is another one now, or it has plugins that only this process has registered."""
    file = tmp_path / "room.xml"
    room = """<scene version="3.0.0"><sensor type="perspective"/><shape type="cube">
        <boolean name="flip_normals" value="true"/></shape>
        <emitter type="point"><point name="position" x="0" y="0" z="0"/></emitter></scene>"""
    file.write_text(room)
    larger = """<transform name="to_world"><scale value="2"/></transform></shape>"""

    async def conversation(page: Page) -> None:
        await passes(page, 1)
        file.write_text(room.replace("</shape>", larger) if change == "larger" else "this is no scene any more")
        page.send("space.paths", source="camera", x=0.5, y=0.5, count=20)
        await page.until("space.busy", lambda m: "another process" in m["text"] and words in m["text"])
        await page.until("space.paths")

    with etendue.view(str(file), "path", size=SIZE, max_depth=4, folder=tmp_path) as viewer:
        talk(viewer, conversation)


@pytest.mark.slow
def test_only_the_latest_click_of_a_page_is_answered(tmp_path: Any) -> None:
    async def conversation(page: Page) -> None:
        await passes(page, 1)
        for count in (11, 12, 13, 14):
            page.send("space.paths", source="camera", x=0.5, y=0.5, count=count)
        counts = []
        while 14 not in counts:
            counts.append((await page.until("space.paths"))[0]["count"])
        assert counts == [11, 14]

    with etendue.view("cornell-box", "path", size=SIZE, max_depth=4, folder=tmp_path) as viewer:
        talk(viewer, conversation)
