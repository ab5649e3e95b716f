"""A session: a scene, its camera and a picture that is refined, in a thread of its own.

Only this thread uses Mitsuba and Dr.Jit. Between two passes it handles the messages of the pages; while the camera
moves it makes small pictures, afterwards passes of the chosen method.
"""

from __future__ import annotations

import contextlib
import gc
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import EtendueError, describe, logger, own_kernels, use_variant
from etendue.engine import jit_flags, set_jit_flags
from etendue.scene import Problem, name_elements, require_colours

from . import commands, states
from .camera import Pose, place
from .clients import Audience, Client
from .comparing import Comparison
from .panels import Panel, panels
from .preview import Preview
from .refining import Refinement, Still, is_picture
from .shown import Show
from .states import Asked

if TYPE_CHECKING:
    import mitsuba as mi

Picture = NDArray[np.float32]

#: The camera is at rest so many seconds after its last movement.
_REST = 0.25
#: Least seconds between two pictures of the refinement, and the share of the time that showing them may take.
_EVERY, _SHARE = 0.1, 0.15
#: Name of the session's thread.
_THREAD = "etendue-viewer"


class ViewerSession:
    """See the module. The public attributes belong to the session's thread; :meth:`join`, :meth:`leave`, :meth:`post`,
    :meth:`file`, :meth:`close`, :attr:`opened` and :attr:`ended` may be used from any thread."""

    def __init__(self, asked: Asked) -> None:
        self.asked = asked
        self.problem: Problem | None = None
        self.pose: Pose | None = None
        self.views: list[Pose] = []
        self.show = Show()
        self.layers: Mapping[str, Picture] = {}  #: layers of the method's latest picture; empty before it
        self.main: Refinement | Still | None = None
        self.compared: Comparison | None = None
        self.paused = False
        self.trouble = ""  #: why there is no picture, or no more passes
        self.saved: dict[str, Path] = {}
        self.clients = Audience()
        self.panels: dict[str, Panel] = {}
        self.opened, self.ended = threading.Event(), threading.Event()
        self.on_picture: Callable[[Mapping[str, Picture]], object] | None = None  #: gets the layers that are shown
        self.home: Pose | None = None  #: pose of the scene's own camera
        self._preview: Preview | None = None
        self._moving_until = 0.0  # 0 at rest
        self._moved = False  # since the last moving picture
        self._dirty = True  # whether the shown picture is outdated
        self._shown_at, self._show_seconds, self._stops = 0.0, 0.0, 0.0
        self._progress: dict[str, Any] = {}  # the last that was sent
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._closing = threading.Event()
        self._flags = jit_flags()
        self._thread = threading.Thread(target=self._work, name=_THREAD, daemon=True)

    # ------------------------------------------------------------------ for other threads

    def start(self) -> None:
        """Load the scene and begin, in the session's thread."""
        self._thread.start()

    def join(self, client: Client) -> None:
        """A page has connected: it gets the state and the latest pictures."""
        if self._closing.is_set():
            client.send("note", text=commands.ENDED)
            return

        def welcome() -> None:
            client.send("about", **states.about(self))
            client.send("state", **self.state())
            self.clients.add(client)
            if self._progress:
                client.send("progress", **self._progress)

        self._inbox.put(welcome)

    def leave(self, client: Client) -> None:
        """A page has disconnected. Without pages no passes are made."""
        self._inbox.put(lambda: self.clients.remove(client))

    def post(self, client: Client, message: Mapping[str, Any]) -> None:
        """Handle a message of a page, after the current pass."""
        self._inbox.put(lambda: self._handle(client, message))

    def file(self, name: str) -> bytes | None:
        """The content of a file that was saved, ``None`` for other files."""
        path = self.saved.get(name)
        with contextlib.suppress(OSError):
            return path.read_bytes() if path is not None else None
        return None

    def close(self, wait: bool = True) -> None:
        """End the thread after the current pass, and release the scene. May be called twice."""
        self._closing.set()
        self._inbox.put(lambda: None)
        if wait and self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join()

    # ------------------------------------------------------------------ for commands and panels

    def state(self) -> dict[str, Any]:
        """Everything that the controls of a page show."""
        return states.state(self)

    @property
    def stops(self) -> float:
        """The exposure of the picture that is shown."""
        return self._stops

    def changed(self) -> None:
        """Send the new state to the pages."""
        self.broadcast("state", **self.state())

    def broadcast(self, kind: str, payload: bytes | None = None, /, **fields: Any) -> None:
        """Send a message to all pages."""
        self.clients.send(kind, payload, **fields)

    def tell(self, error: BaseException | str, client: Client | None = None) -> None:
        """Show an error in the page of ``client``, or in all pages, and in the terminal."""
        text = describe(error) if isinstance(error, BaseException) else error
        logger.warning("%s", text)
        if isinstance(error, BaseException):
            logger.debug("viewer", exc_info=error)
        for one in self.clients if client is None else [client]:
            one.send("error", text=text)

    def move(self, pose: Pose | None) -> None:
        """Show the scene from another pose; ``None`` for a picture from a file."""
        self.pose = pose
        self._moved = True
        self._moving_until = time.monotonic() + _REST
        self.again()

    def later(self, work: Callable[[], None]) -> None:
        """Run ``work`` in the session's thread, after the current pass. May be called from any thread."""
        self._inbox.put(work)

    def again(self) -> None:
        """Start the picture anew, because scene, camera or method has changed."""
        self.main = self.main if isinstance(self.main, Still) else None
        self.trouble = ""
        if self.compared is not None:
            self.compared.restart()

    def refresh(self) -> None:
        """Show the picture again, because layer, exposure or another view setting has changed."""
        self._dirty = True
        # If there is only a moving picture, make that again.
        self._moved |= self.paused and self.main is None and self.problem is not None

    def compare(self, other: Comparison | None) -> None:
        """Show a second picture beside the first, or none."""
        self.compared = other
        self.clients.hide("b")
        self.refresh()
        self.changed()

    def scene_edited(self) -> None:
        """Drop everything computed from the scene, because parameters were changed in place (``mi.traverse``)."""
        self._preview = None
        self._moved = True
        for panel in self.panels.values():
            self._guarded(panel.scene_edited)
        self.again()

    def open(self, asked: Asked, keep_pose: bool = False) -> None:
        """Load a scene, or a picture, and show it. Raises the errors of loading; the previous scene is then kept.
        ``keep_pose``: it is the previous scene, and its camera and views are kept."""
        still = Still(asked.scene) if is_picture(asked.scene) else None
        problem = None if still is not None else asked.load(lambda state: self._change(asked, state))
        if problem is not None:
            require_colours(problem.sensor.film(), "the viewer")
        home, before = None if problem is None else Pose.of(problem), self.problem

        def kept(pose: Pose) -> Pose:
            assert before is not None and problem is not None and home is not None
            return home if pose is self.home else pose.carried(before.space, problem.space)

        pose, views = home, list[Pose]()
        if keep_pose and self.pose is not None and before is not None and problem is not None:
            pose, views = kept(self.pose), [kept(view) for view in self.views]
        self.asked, self.problem, self.home, self.views = asked, problem, home, views
        self._preview, self.layers = None, {}  # the preview is made with the first moving picture
        self.main = self.compared = None
        self._progress = {}
        self.clients.hide("b")
        for panel in self.panels.values():  # they release the previous scene
            self._guarded(panel.scene_loaded)
        gc.collect()  # every living scene is a part of later kernels
        self.move(pose)
        self.main, self._moved, self._dirty = still, pose is not None, True
        self._moving_until = 0.0

    def _change(self, asked: Asked, state: mi.parser.ParserState) -> None:
        """Change a parsed scene before its objects are built: names of elements, lights, and the edits of panels."""
        name_elements(state)
        asked.lights(state)
        same = asked.scene is self.asked.scene and asked.parameters == self.asked.parameters
        for panel in self.panels.values():
            panel.loading(state, same)

    # ------------------------------------------------------------------ the thread

    @own_kernels(optimise=False)  # a person waits for them, and an edit may need others
    def _work(self) -> None:
        try:
            self._guarded(self._begin, fatal=True)
            self.opened.set()
            while not self._closing.is_set():
                busy = self._guarded(self._advance)
                self._take_messages(wait=not busy)
        finally:
            for panel in self.panels.values():
                self._guarded(panel.close)
            self.problem = self.main = self.compared = self._preview = None
            self.layers, self.panels, self.views = {}, {}, []
            self.asked, self.clients = Asked(), Audience()
            gc.collect()
            self.ended.set()

    def _begin(self) -> None:
        set_jit_flags(self._flags)
        use_variant()
        self.panels = panels(self)
        self.open(self.asked)

    def _take_messages(self, wait: bool) -> None:
        """Handle all messages in the inbox; ``wait``: for the first one, or until the camera is at rest."""
        rests = self._moving_until > 0.0 and self.problem is not None and self.clients
        until = max(self._moving_until - time.monotonic(), 1e-3) if rests else None
        with contextlib.suppress(queue.Empty):
            if wait:
                self._guarded(self._inbox.get(timeout=until))
            while not self._closing.is_set():
                self._guarded(self._inbox.get_nowait())

    def _handle(self, client: Client, message: Mapping[str, Any]) -> None:
        try:
            name, dot, verb = message["type"].partition(".")
            if dot and name in self.panels:
                self.panels[name].handle(verb, message, client)
            else:
                commands.handle(self, client, message)
        except Exception as error:  # no error of a message may end the session
            self.tell(error, client)
            client.send("state", **self.state())  # so that its fields show the current values

    def _guarded(self, work: Callable[[], object], fatal: bool = False) -> bool:
        """Run ``work``; its errors are shown. Returns whether its result is true."""
        try:
            return bool(work())
        except Exception as error:
            if fatal:
                self.trouble = describe(error)
            self.tell(error)
            return False

    def _advance(self) -> bool:
        """Do the next small part of the work; returns whether there is more to do without a message."""
        if self.problem is None or self.pose is None or not self.clients:
            if isinstance(self.main, Still) and self._dirty and self.clients:
                self._publish()
            return False
        if self._moved:
            self._guarded(self._show_moving)
            return True
        if time.monotonic() < self._moving_until:
            return False
        self._moving_until = 0.0
        working = any([self._guarded(panel.work) for panel in self.panels.values()])
        if not (self.paused or self.trouble):
            working |= self._refine()
        if self._dirty:
            try:
                self._publish()
            except Exception as error:
                self._stop(error)
        return working

    def _show_moving(self) -> None:
        assert self.problem is not None and self.pose is not None
        self._moved = False
        if self._preview is None:
            self._preview = Preview(self.problem)
        try:
            picture = self._preview.picture(self.pose)
        except (RuntimeError, MemoryError) as error:
            if not self._preview.coarser():
                raise
            self.tell(f"the moving picture failed, and is made coarser: {describe(error)}")
            self._moved = True
            return
        if not self.layers or self.show.exposure != "auto":
            self._stops = self.show.stops(picture)
        layers = {"image": picture}
        self.clients.show("a", replace(self.show, denoise="").colours(layers, self._stops), moving=True)
        self.broadcast("camera", **states.camera(self.problem, self.pose))

    def _refine(self) -> bool:
        """A pass of the method or of the second method; returns whether there are more."""
        assert self.problem is not None and self.pose is not None
        try:
            if not isinstance(self.main, Refinement):
                place(self.problem.sensor, self.pose)
                self.problem = replace(self.problem)  # without values computed from the previous sensor
                asked = self.asked
                self.main = Refinement(self.problem, asked.method, asked.settings, asked.budget, asked.seed)
                self.changed()
            made = self._refine_other(self.main)
            if made is None and not self.main.is_done:
                made = self.main
                made.step()
        except Exception as error:
            self._stop(error)
            return False
        if made is None:
            return False
        now = time.monotonic()
        if now - self._shown_at >= max(_EVERY, self._show_seconds / _SHARE) or made.is_done:
            self._dirty = True
        return True

    def _refine_other(self, main: Refinement) -> Refinement | None:
        """A pass of the second method, if it is its turn. If the pass fails, the comparison ends."""
        if self.compared is None:
            return None
        try:
            other = self.compared.turn(main, self.asked)
            if other is not None:
                other.step()
            return other
        except Exception as error:
            self.tell(f"the comparison is ended: {describe(error)}")
            self.compare(None)
            return None

    def _stop(self, error: Exception) -> None:
        """Make no more passes until something is changed."""
        self.trouble = describe(error)
        self.tell(error)
        self.changed()

    def _publish(self) -> None:
        """Show the current picture."""
        begin = time.perf_counter()
        if self.main is None or (result := self.main.result()) is None:
            return
        self._dirty = False
        names = list(self.layers)
        self.layers = result.layers
        if self.on_picture is not None:
            self.on_picture(result.layers)
        self._stops = self.show.stops(result.image)
        try:
            self.clients.show("a", self.show.colours(result.layers, self._stops))
        except EtendueError as error:  # such as a filter whose layer is missing
            plain = replace(self.show, denoise="", layer="image")
            if self.main.passes > 1 or self.main.is_done:  # before the second pass there is no variance
                self.tell(error)
                self.show = plain
                self.changed()
            self.clients.show("a", plain.colours(result.layers, self._stops))
        compared: dict[str, Any] = {}
        if self.compared is not None:
            other = self.compared.shown(self.show, self._stops, result.image, self.tell)
            if other is not None:
                picture, compared = other
                self.clients.show("b", picture)
        if names != list(self.layers):
            self.changed()
        self._progress = {**self.main.progress(), "exposure": self._stops, **compared}
        self.broadcast("progress", **self._progress)
        for panel in self.panels.values():
            self._guarded(panel.after_pass)
        self._show_seconds = time.perf_counter() - begin
        self._shown_at = time.monotonic()
