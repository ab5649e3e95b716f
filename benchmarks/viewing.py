"""The viewer: the first picture, pictures a second while the camera moves, and what a frozen function saves."""

from __future__ import annotations

import asyncio
import json
import statistics
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from typing import Annotated, Any

import typer

from etendue import view
from etendue.scene import load, resized
from etendue.viewer import Viewer
from etendue.viewer.camera import Pose
from etendue.viewer.preview import Moving
from etendue.viewer.protocol import unpacked

from .measuring import PUBLIC_SCENES, Record, interleaved, spread, verdict
from .options import Names, Rounds, Size

#: Pictures a second that must reach a page; seconds until the first one after a warm start; and ms from an input, while
#: passes are made, to the picture.
BARS = {"cornell-box": 30.0, "caustics": 10.0, "grey-white-room": 4.0}
FIRST, REACTION = 1.0, 100.0
#: Inputs whose reactions are measured; seconds between them, and the range of what is added to these, since a person's
#: inputs do not wait for the begin of a pass.
_INPUTS, _BETWEEN, _MORE = 15, 1.2, 0.5
#: Most times of moving before that which counts.
_WARM_UPS = 8
#: Size of the moving picture by which a frozen function is compared.
_SMALL = 240, 180


def measure(
    scenes: Names = "cornell-box,caustics,grey-white-room",
    size: Size = "480x360",
    seconds: Annotated[float, typer.Option(help="Time of moving, after as much to warm up.")] = 5.0,
    rounds: Rounds = 11,
) -> Iterator[Record]:
    """Pictures that reach a plain client while the camera swings."""
    width, height = size
    record = Record(
        f"Viewer, {width}x{height}: pictures while the camera moves",
        ("scene", "first, s", "pictures/s", "of size", "CPU ms each", "bar", "input to picture, ms"),
    )
    for name in scenes:
        with view(_source(name), "path", size=size) as viewer:
            for _ in range(_WARM_UPS):  # kernels, and the resolution that keeps the pace
                if len(asyncio.run(_moved(viewer, seconds))[1]) > 1:
                    break
            first, frames, cpu = asyncio.run(_moved(viewer, seconds))
            waits = [1e3 * wait for wait in asyncio.run(_reactions(viewer))]
        reaction = f"{spread(waits, '.0f')}, {verdict(statistics.median(waits), REACTION)}"
        if not frames:
            record.add(name, f"{first:.2f}", "0", "", "", f"≥ {BARS[name]:g}: missed" if name in BARS else "", reaction)
            continue
        pace = len(frames) / seconds
        small = statistics.mode(f"{f['width']}x{f['height']}" for f in frames)
        bar = f"≥ {BARS[name]:g}: {'reached' if pace >= BARS[name] else 'missed'}" if name in BARS else ""
        record.add(name, f"{first:.2f}", f"{pace:.1f}", small, f"{1e3 * cpu / len(frames):.0f}", bar, reaction)
    record.notes.append(
        f"frames that reach a client over a WebSocket in {seconds:g} s of moving; first: from connecting to a session "
        f"whose scene is loaded and kernels compiled (bar {FIRST:g} s); a busy machine lowers both"
    )
    record.notes.append(
        f"input to picture: {_INPUTS} movements of the camera at any time while passes of path are made, each to "
        "the arrival of the first picture from there"
    )
    yield record
    yield _frozen(list(scenes), rounds)


def _frozen(scenes: list[str], rounds: int) -> Record:
    """CPU time of a moving picture by a frozen function and by one that is traced anew."""
    tasks: dict[str, Any] = {}
    for name in scenes:
        problem = resized(load(_source(name)), _SMALL)
        pose = Pose.of(problem)
        for way in (True, False):
            tasks[f"{name} {way}"] = _picture(Moving(problem, frozen=way), pose)
    clocks = interleaved(tasks, rounds, 3)
    record = Record(
        f"A moving picture of {_SMALL[0]}x{_SMALL[1]}, frozen and traced anew",
        ("scene", "frozen, CPU ms", "anew, CPU ms", "ratio"),
    )
    for name in scenes:
        frozen, anew = (1e3 * statistics.median(c.cpu for c in clocks[f"{name} {way}"]) for way in (True, False))
        record.add(name, f"{frozen:.0f}", f"{anew:.0f}", f"{anew / frozen:.2f}")
    record.notes.append(f"median of {rounds} rounds in turn, all scenes alive, which makes kernels larger")
    return record


def _picture(moving: Moving, pose: Pose) -> Any:
    return lambda number: moving.picture(pose.orbited(0.002 * number, 0.0))


class _Page:
    """A client that draws every picture at once."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket

    async def frame(self) -> dict[str, Any]:
        """The fields of the next picture."""
        while True:
            message = await self._socket.read_message()
            assert message is not None
            fields, _ = unpacked(message)
            if fields["type"] == "frame":
                self._socket.write_message(json.dumps({"type": "drawn", "frame": fields["frame"]}))
                return fields

    def turn(self, angle: float) -> None:
        """Turn the camera."""
        self._socket.write_message(json.dumps({"type": "camera", "orbit": [angle, 0.0]}))


@asynccontextmanager
async def _page(viewer: Viewer) -> AsyncIterator[_Page]:
    from tornado.websocket import websocket_connect

    await asyncio.to_thread(viewer.loaded)
    socket = await websocket_connect(viewer.url.replace("http:", "ws:", 1) + "socket", max_message_size=1 << 26)
    yield _Page(socket)
    socket.close()


async def _moved(viewer: Viewer, seconds: float) -> tuple[float, list[dict[str, Any]], float]:
    """(seconds to the first picture, frames while moving, CPU time)."""
    await asyncio.to_thread(viewer.loaded)
    begin = time.perf_counter()
    async with _page(viewer) as page:
        await page.frame()
        first = time.perf_counter() - begin
        ending = time.perf_counter() + seconds
        cpu = time.process_time()

        async def swing() -> None:
            number = 0
            while time.perf_counter() < ending:
                page.turn(0.004 if number % 64 < 32 else -0.004)
                number += 1
                await asyncio.sleep(1 / 60)

        moving, frames = asyncio.ensure_future(swing()), []
        while (left := ending - time.perf_counter()) > 0:
            try:
                found = await asyncio.wait_for(page.frame(), left)
            except TimeoutError:
                break
            if found["moving"]:
                frames.append(found)
        cpu = time.process_time() - cpu
        await moving
    return first, frames, cpu


async def _reactions(viewer: Viewer) -> list[float]:
    """Seconds from a movement of the camera to the picture, at any time while passes are made."""
    waits = []
    async with _page(viewer) as page:
        for number in range(_INPUTS):
            while (await page.frame())["moving"]:
                pass
            rest = time.perf_counter() + _BETWEEN + _MORE * (0.618034 * number % 1.0)
            while (left := rest - time.perf_counter()) > 0:
                with suppress(TimeoutError):
                    await asyncio.wait_for(page.frame(), left)
            begin = time.perf_counter()
            page.turn(0.004)
            while not (await page.frame())["moving"]:
                pass
            waits.append(time.perf_counter() - begin)
    return waits


def _source(name: str) -> str:
    path = PUBLIC_SCENES / name / "scene.xml"
    return str(path) if path.is_file() and name not in ("cornell-box",) else name
