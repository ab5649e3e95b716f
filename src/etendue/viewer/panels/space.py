"""The 3-D view: surfaces, rays, photons, trees and grids, radiosity, the guide's directions.

All but the surfaces is made by a process of its own, because compiling a kernel takes seconds, during
which Dr.Jit does nothing else in this one. If a scene cannot be given to another process, the session makes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.core import EtendueError, OptionError, describe, suggest
from etendue.scene import Problem, graph
from etendue.transport import Guide

from ..figures import meshes, trees
from ..figures.packing import joined
from ..refining import Refinement
from ..tracing import Arrays, Desk, Order, Reply, SceneCopy, TracingProcess, View
from . import Panel

if TYPE_CHECKING:
    from ..clients import Client

#: Messages of a page.
_VERBS = ("mesh", "paths", "photons", "tree", "guide", "solve", "stop", "stay")
#: Growth of the number of passes after which rays that follow the picture are traced again.
_GROWTH = 2
#: What the page is told where another process cannot be used.
_HERE = "tracing between pictures, which wait while new kernels are compiled: another process cannot have this scene"

#: Message of a page: its verb, its fields, and the page, ``None`` for all.
Asked = tuple[str, Mapping[str, Any], "Client | None"]


class Space(Panel):
    """Sends the arrays that the page draws."""

    name: ClassVar[str] = "space"
    title: ClassVar[str] = "3-D view"
    script: ClassVar[str] = "space.js"

    def __init__(self, session: Any) -> None:
        super().__init__(session)
        self._scenes = 0  # loaded or edited so far
        self._main: Any = None
        self._runs = 0  # refinements of the picture so far
        self._process: TracingProcess | None = None
        self._has = -1  # number of the scene that the process has
        self._desk: Desk | None = None  # of this thread, if there can be no process
        self._why = ""  # why there can be none
        self._waiting: dict[tuple[Client | None, str], Asked] = {}  # the latest of each page and verb
        self._current: Asked | None = None  # that the process answers
        self._number = self._heard = 0  # of the latest order, and the latest that the process has begun
        self._failed = False  # whether a process has ended before it began an order
        #: Pages whose rays follow the picture: their message, and run and passes for which it was answered.
        self._following: dict[Client, tuple[Mapping[str, Any], int, int]] = {}
        self._solution: dict[str, tuple[Arrays, Mapping[str, Any]]] = {}  # the messages about it, for further pages
        self._solving = False

    def state(self) -> dict[str, Any]:
        """Number of the scene, names of its lights, kinds of trees, and whether radiosity is solved or a guide
        exists."""
        problem, main = self.session.problem, self.session.main
        lights = [] if problem is None else [_light_name(emitter) for emitter in problem.scene.emitters()]
        return {
            "scene": self._scenes,
            "lights": lights,
            "trees": trees.KINDS,
            "solving": self._solving,
            "guided": isinstance(main, Refinement) and isinstance(getattr(main.method, "guide", None), Guide),
        }

    def scene_loaded(self) -> None:
        """Drop everything of the scene before; read a solution that was given with the new scene."""
        self.scene_edited()
        self.close()
        self._why = ""
        asked = self.session.asked
        if asked.solution is not None and self.session.problem is not None:
            self._ask("solve", {"file": str(asked.solution)}, None)

    def scene_edited(self) -> None:
        """Drop rays and solutions, which are outdated after an edit."""
        self._scenes += 1
        for verb, _, client in [*self._waiting.values(), *([self._current] if self._current else [])]:
            self._busy(verb, client)
        self._waiting.clear()
        if self._current is not None or self._solving or self._desk is not None:
            self.close()
        self._solution.clear()
        self._solving = False

    def close(self) -> None:
        """End the process, and release the scene."""
        if self._process is not None:
            self._process.close()
        if self._desk is not None:
            self._desk.close()
        self._process = self._desk = self._current = None
        self._main, self._has = None, -1

    def handle(self, verb: str, message: Mapping[str, Any], client: Client) -> None:
        """``mesh`` answers the page that asks; ``paths``, ``photons``, ``tree`` and ``guide`` do so later; ``solve``
        all pages, until ``stop``. ``paths`` with ``follow`` are traced again when the picture changes, until
        ``stay``."""
        problem = self.session.problem
        if verb not in _VERBS:
            raise OptionError(f"there is no message 'space.{verb}'; {suggest(verb, _VERBS)}")
        if problem is None:
            raise OptionError("no scene is loaded; open one first")
        if verb == "mesh":
            self._mesh(problem, client)
        elif verb == "stay":
            self._following.pop(client, None)
        elif verb in ("solve", "stop"):
            self._solving = verb == "solve"
            self._solution.clear()
            if verb == "solve" or self._process is not None or self._desk is not None:
                self._ask(verb, message, client)
            self.session.changed()
        else:
            if verb == "paths":
                self._following.pop(client, None)
                if message.get("follow"):
                    self._following[client] = message, 0, 0
            self._ask(verb, message, client)

    def after_pass(self) -> None:
        """Trace the rays again that follow the picture, if it is another picture, or has twice as many passes."""
        run, passes = self._run(), getattr(self.session.main, "passes", 0)
        for client, (message, last_run, last_passes) in list(self._following.items()):
            asked = self._waiting.get((client, "paths"), self._current)
            if client.closed:
                del self._following[client]
            elif asked is not None and asked[0] == "paths" and asked[2] is client:
                continue  # it is being answered
            elif run != last_run or passes >= _GROWTH * max(last_passes, 1):
                self._ask("paths", message, client)

    def work(self) -> bool:
        """Refine a solution that is made in this thread."""
        if self._desk is None:
            return False
        try:
            return self._desk.work()
        except Exception:
            self._solved()
            raise

    # ------------------------------------------------------------------ answers of the session

    def _mesh(self, problem: Problem, client: Client) -> None:
        mesh = meshes.scene_mesh(problem)
        width, height = problem.size
        pose = self.session.pose
        assert pose is not None
        camera = {"origin": pose.origin, "target": pose.target, "up": pose.up, "fov": pose.fov}
        arrays: Arrays = {"triangles": mesh.triangles, "shape": mesh.shape, "colours": mesh.colours}
        about: Any = {"names": mesh.names, "left_out": mesh.left_out, "missing": mesh.missing}
        about["space"] = {"centre": problem.space.centre, "scale": problem.space.scale}
        self._send(client, "mesh", arrays, camera=camera | {"aspect": width / height}, size=pose.size, **about)
        for verb, (found, fields) in self._solution.items():
            self._send(client, verb, found, **fields)

    # ------------------------------------------------------------------ answers of the process

    def _ask(self, verb: str, message: Mapping[str, Any], client: Client | None) -> None:
        """Answer a message when those before it are answered; a later one of the same kind replaces it."""
        self._waiting.pop((client, verb), None)  # so that it is the last
        self._waiting[client, verb] = verb, message, client
        if self._current is not None or self._process is None:
            self._busy(verb, client, "waiting for its turn" if self._current else "starting a process of its own")
        self._next()

    def _next(self) -> None:
        """Let the process answer the next message, if it answers none."""
        while self._waiting and self._current is None:
            verb, message, client = self._waiting.pop(next(iter(self._waiting)))
            run, main = self._run(), self.session.main
            if client is not None and client in self._following and verb == "paths":
                self._following[client] = message, run, getattr(main, "passes", 0)
            if not self._why:
                try:
                    self._order(verb, message, client, run)
                except (EtendueError, OSError) as error:  # a scene in memory, or no process
                    self._why = describe(error)
            if self._why:
                self._answer(verb, message, client)

    def _order(self, verb: str, message: Mapping[str, Any], client: Client | None, run: int) -> None:
        scene = SceneCopy.of(self.session) if self._has != self._scenes else None
        if self._process is None:
            later = self.session.later
            process = self._process = TracingProcess(lambda reply: later(lambda: self._replied(process, reply)))
        view = View.of(self.session, run) if verb in ("paths", "tree", "guide") else None
        self._process.send(Order(self._number + 1, verb, message, scene, view))
        self._has, self._number, self._current = self._scenes, self._number + 1, (verb, message, client)

    def _replied(self, process: TracingProcess, reply: Reply) -> None:
        """Take a reply of the process, unless it is about a scene or an order of the past."""
        if process is not self._process:
            return
        verb, message, client = self._current or ("", {}, None)
        if reply.kind == "ended":
            self._ended(reply.content)
            return
        self._heard, self._failed = max(self._heard, reply.number), False
        if reply.kind == "message" and reply.number in (0, self._number):
            self._show(client if reply.number else None, *reply.content)
        elif reply.kind == "failed" and reply.number == 0:
            self.session.tell(reply.content)
            self._solved()
        elif reply.number != self._number or self._current is None:
            return
        elif reply.kind == "doing":
            self._busy(verb, client, reply.content)
        elif reply.kind == "unusable":
            self.close()
            self._why = reply.content
            self._answer(verb, message, client)
            self._next()
        else:
            if reply.kind == "failed":
                self.session.tell(reply.content, client)
                self._solved(verb == "solve")
            self._done(verb, client)

    def _ended(self, reason: str) -> None:
        """The process has ended. Orders that it has not begun are given to another one, unless that ends, too."""
        current, was_solving, begun = self._current, self._solving, self._heard == self._number
        self.close()
        self._solving = False
        if current is not None and not begun:
            self._why, self._failed = reason if self._failed else "", True
            self._solving = current[0] == "solve"
            self._waiting[current[2], current[0]] = current
        elif current is not None or was_solving:  # else it had nothing to do
            verb, client = (current[0], current[2]) if current is not None else ("solve", None)
            self.session.tell(f"{reason}; try again", client)
            self._busy(verb, client)
        if was_solving != self._solving:
            self.session.changed()
        self._next()

    def _answer(self, verb: str, message: Mapping[str, Any], client: Client | None) -> None:
        """Answer in this thread."""
        self._busy(verb, client, f"{_HERE} ({self._why})")
        problem = self.session.problem
        assert problem is not None
        if self._desk is None:
            self._desk = Desk(problem, lambda *message: self._show(None, *message))
        try:
            self._desk.handle(verb, message, self._picture, lambda *message: self._show(client, *message))
        except Exception as error:
            self.session.tell(error, client)
            self._solved(verb == "solve")
        self._busy(verb, client)

    def _picture(self) -> Refinement:
        session = self.session
        if isinstance(session.main, Refinement):
            return session.main
        assert session.problem is not None
        return View.of(session, self._run()).refinement(session.problem)

    def _done(self, verb: str, client: Client | None) -> None:
        self._current = None
        self._busy(verb, client)
        self._next()

    def _run(self) -> int:
        """Number of the picture's refinement."""
        if self.session.main is not self._main:
            self._main, self._runs = self.session.main, self._runs + 1
        return self._runs

    def _show(self, client: Client | None, verb: str, arrays: Arrays, fields: Mapping[str, Any]) -> None:
        if verb in ("solution", "values"):
            if not self._solving and not self._solution and verb == "values":
                return  # it was stopped meanwhile
            self._solution[verb] = arrays, fields
            if fields.get("done"):
                self._solved()
        self._send(client, verb, arrays, **fields)

    def _solved(self, ended: bool = True) -> None:
        """Radiosity is not refined any more."""
        if self._solving and ended:
            self._solving = False
            self.session.changed()

    # ------------------------------------------------------------------ messages

    def _busy(self, verb: str, client: Client | None, text: str = "") -> None:
        """Tell what is being done for an answer; "" at its end."""
        send = self.session.broadcast if client is None else client.send
        send(f"{self.name}.busy", verb=verb, text=text)

    def _send(self, client: Client | None, verb: str, arrays: Arrays, **fields: Any) -> None:
        data, table = joined(arrays)
        send = self.session.broadcast if client is None else client.send
        send(f"{self.name}.{verb}", data, arrays=table, **fields)


def _light_name(emitter: Any) -> str:
    shape = emitter.get_shape()
    own = graph.name(shape) if shape is not None else graph.name(emitter)
    kind = graph.plugin_name(emitter)
    return f"{own} ({kind})" if own and own != "emitter" else kind
