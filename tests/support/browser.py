"""A headless Chromium, driven over its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import itertools
import json
import shutil
import tempfile
from pathlib import Path

from tornado.httpclient import AsyncHTTPClient
from tornado.websocket import websocket_connect

PROGRAM = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run", "--mute-audio"),
    *(
        "--disable-extensions",
        "--disable-background-networking",
        "--remote-debugging-port=0",
        "--disable-dev-shm-usage",
    ),
)
#: What keys are called: code, key, number.
KEYS = {
    "ArrowLeft": ("ArrowLeft", 37),
    "ArrowRight": ("ArrowRight", 39),
    "Tab": ("Tab", 9),
    "Enter": ("Enter", 13),
    "Space": (" ", 32),
    "Escape": ("Escape", 27),
    "KeyV": ("v", 86),
    "KeyP": ("p", 80),
    "Home": ("Home", 36),
}


class Browser:
    """One tab. Use as ``async with Browser(width, height) as tab``."""

    def __init__(self, width=1280, height=800, dark=False, touch=False, more=()):
        self.size, self.dark, self.touch = (width, height), dark, touch
        self.more = more  # further options of Chromium
        self.errors = []
        self._numbers = itertools.count(1)
        self._answers = {}

    async def __aenter__(self):
        self.folder = tempfile.mkdtemp(prefix="etendue-chromium-")
        self.process = await asyncio.create_subprocess_exec(
            PROGRAM,
            *FLAGS,
            *self.more,
            f"--user-data-dir={self.folder}",
            "about:blank",
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        place = Path(self.folder) / "DevToolsActivePort"
        for _ in range(600):
            if place.is_file() and "\n" in place.read_text():
                break
            await asyncio.sleep(0.1)
        port = place.read_text().splitlines()[0]
        answer = await AsyncHTTPClient(force_instance=True).fetch(f"http://127.0.0.1:{port}/json/list")
        target = next(t for t in json.loads(answer.body) if t["type"] == "page")
        self._socket = await websocket_connect(target["webSocketDebuggerUrl"], max_message_size=1 << 28)
        self._reader = asyncio.ensure_future(self._read())
        for domain in ("Page", "Runtime", "Log"):
            await self.call(f"{domain}.enable")
        width, height = self.size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": self.touch}
        await self.call("Emulation.setDeviceMetricsOverride", **metrics)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if self.dark else "light"}]
        await self.call("Emulation.setEmulatedMedia", features=scheme)
        return self

    async def __aexit__(self, *_):
        self._reader.cancel()
        self._socket.close()
        self.process.terminate()
        await self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    async def _read(self):
        while (text := await self._socket.read_message()) is not None:
            message = json.loads(text)
            if "id" in message:
                self._answers.pop(message["id"]).set_result(message)
            elif message["method"] == "Runtime.exceptionThrown":
                details = message["params"]["exceptionDetails"]
                self.errors.append(details.get("exception", {}).get("description", details["text"]))
            elif message["method"] == "Log.entryAdded" and message["params"]["entry"]["level"] == "error":
                self.errors.append(message["params"]["entry"]["text"])

    async def call(self, method, **parameters):
        number = next(self._numbers)
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        self._socket.write_message(json.dumps({"id": number, "method": method, "params": parameters}))
        message = await asyncio.wait_for(answer, 120)
        assert "error" not in message, message["error"]
        return message["result"]

    async def open(self, url):
        await self.call("Page.navigate", url=url)

    async def value(self, expression):
        """The value of a JavaScript expression."""
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    async def until(self, expression, timeout=120):
        """Wait until a JavaScript expression is true."""
        for _ in range(int(timeout / 0.1)):
            if await self.value(f"!!(document.body && ({expression}))"):
                return
            await asyncio.sleep(0.1)
        raise AssertionError(f"not in {timeout} s: {expression}")

    async def press(self, code, modifiers=0, hold=0.0):
        key, number = KEYS[code]
        common = {"code": code, "key": key, "windowsVirtualKeyCode": number, "modifiers": modifiers}
        text = {"text": "\r" if code == "Enter" else key} if len(key) == 1 or code == "Enter" else {}
        await self.call("Input.dispatchKeyEvent", type="keyDown", **common, **text)
        await asyncio.sleep(hold)
        await self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    async def type(self, text):
        await self.call("Input.insertText", text=text)

    async def mouse(self, kind, x, y, **more):
        await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    async def screenshot(self, path, full=False):
        parameters = {"format": "png"}
        if full:
            size = (await self.call("Page.getLayoutMetrics"))["cssContentSize"]
            parameters |= {"captureBeyondViewport": True, "clip": {**size, "x": 0, "y": 0, "scale": 1}}
        Path(path).write_bytes(base64.b64decode((await self.call("Page.captureScreenshot", **parameters))["data"]))
