"""The 3-D view: surfaces, paths, photons, trees and grids, radiosity, the guide's directions."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from numpy.typing import NDArray

from etendue.core import OptionError, suggest
from etendue.scene import Problem, graph
from etendue.transport import Guide, PathRecorder

from ..figures import meshes, particles, paths, trees
from ..figures.packing import joined
from ..figures.solution import LiveSolution, SavedSolution, ShownSolution
from ..protocol import number, numbers, text
from ..refining import Refinement
from . import Panel

if TYPE_CHECKING:
    from ..clients import Client

Arrays = Mapping[str, NDArray[Any]]

#: Most paths that are drawn, and most light paths that make photons.
_MOST_PATHS, _MOST_PHOTONS = 2000, 50_000
#: Message to a page that asks for the first paths of a scene.
_FIRST = "The first paths of a scene: their kernels are compiled, which takes seconds in a large scene; wait a moment."
#: Rows of the picture of a guide's directions.
_ROWS = 64
#: Radius of a hash grid, relative to half the diagonal of the scene.
_REACH = 0.02


class Space(Panel):
    """Sends the arrays that the page draws; a solution of radiosity is refined between passes of the picture."""

    name: ClassVar[str] = "space"
    title: ClassVar[str] = "3-D view"
    script: ClassVar[str] = "space.js"

    def __init__(self, session: Any) -> None:
        super().__init__(session)
        self._scenes = 0  # loaded so far
        self._solution: ShownSolution | None = None
        self._recorder: tuple[Problem, int, PathRecorder] | None = None
        self._seed = 0

    def state(self) -> dict[str, Any]:
        """Number of the scene, names of its lights, kinds of trees, and whether a solution or a guide exists."""
        problem = self.session.problem
        lights = [] if problem is None else [_light_name(emitter) for emitter in problem.scene.emitters()]
        return {
            "scene": self._scenes,
            "lights": lights,
            "trees": trees.KINDS,
            "solving": self._solution is not None and not self._solution.is_done,
            "guided": self._guide() is not None,
        }

    def scene_loaded(self) -> None:
        """Drop everything of the scene before; read a solution that was given with the new scene."""
        self.scene_edited()
        asked = self.session.asked
        if asked.solution is not None and self.session.problem is not None:
            self._solution = SavedSolution(self.session.problem, asked.solution)

    def scene_edited(self) -> None:
        """Drop paths and solutions, which are outdated after an edit."""
        self._scenes += 1
        self.close()

    def close(self) -> None:
        """Release the scene."""
        if self._solution is not None:
            self._solution.close()
        self._solution = self._recorder = None

    def handle(self, verb: str, message: Mapping[str, Any], client: Client) -> None:
        """``mesh``, ``paths``, ``photons``, ``tree``, ``solve``, ``stop``, ``guide``; the first four and
        ``guide`` answer the page that asks, ``solve`` all pages."""
        handlers = {
            "mesh": self._mesh,
            "paths": self._paths,
            "photons": self._photons,
            "tree": self._tree,
            "solve": self._solve,
            "stop": self._stop,
            "guide": self._show_guide,
        }
        if verb not in handlers:
            raise OptionError(f"there is no message 'space.{verb}'; {suggest(verb, handlers)}")
        problem = self.session.problem
        if problem is None:
            raise OptionError("no scene is loaded; open one first")
        handlers[verb](problem, message, client)

    def work(self) -> bool:
        """Cast lines for the solution, and send a new solution."""
        live = self._solution
        if live is None or live.is_done:
            return False
        try:
            if live.step():
                self._send_values(live)
        except Exception:
            self.close()
            self.session.changed()
            raise
        return True

    # ------------------------------------------------------------------ answers

    def _mesh(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        mesh = meshes.scene_mesh(problem)
        width, height = problem.size
        pose = self.session.pose
        assert pose is not None
        camera = {"origin": pose.origin, "target": pose.target, "up": pose.up, "fov": pose.fov}
        arrays: Arrays = {"triangles": mesh.triangles, "shape": mesh.shape, "colours": mesh.colours}
        about: Any = {"names": mesh.names, "left_out": mesh.left_out, "missing": mesh.missing}
        about["space"] = {"centre": problem.space.centre, "scale": problem.space.scale}
        self._send(client, "mesh", arrays, camera=camera | {"aspect": width / height}, size=pose.size, **about)
        if self._solution is not None:
            self._send_solution(self._solution, client)

    def _paths(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        count = _count(message, _MOST_PATHS)
        recorder = self._recorded(problem, int(number(message, "depth", -1)), client)
        source = text(message, "source", "camera")
        self._seed += 1
        if source == "camera":
            width, height = problem.size
            x, y = number(message, "x", 0.5) * width, number(message, "y", 0.5) * height
            tracks = recorder.from_camera(x, y, count, self._seed)
        else:
            light = None if source == "lights" else int(number({"light": _whole(source)}, "light"))
            tracks = recorder.from_light(light, count, self._seed)
        self._send(client, "paths", paths.lines(tracks), count=count)

    def _photons(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        if file := text(message, "file", "").strip():
            found: Arrays = particles.points(problem, Path(file))
        else:
            found = self._hits(problem, message, client)
        self._send(client, "photons", found, total=float(found["power"].sum(axis=0).mean()))

    def _hits(self, problem: Problem, message: Mapping[str, Any], client: Client) -> Arrays:
        recorder = self._recorded(problem, -1, client)
        return paths.hits(recorder.from_light(None, _count(message, _MOST_PHOTONS), self._seed))

    def _tree(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        kind = text(message, "kind")
        if kind not in trees.KINDS:
            raise OptionError(f"there is no tree '{kind}'; {suggest(kind, trees.KINDS)}")
        if kind == "spheres":
            found: Arrays = trees.spheres(problem)
        elif kind == "boxes":
            found = trees.multipath_boxes(problem)
        elif kind == "guide":
            if (guide := self._guide()) is None:
                raise OptionError("the picture has no guide: render it by guided")
            found = trees.guide_cells(guide)
        elif kind == "kd-tree":
            found = trees.kd_tree(self._hits(problem, message, client)["points"])
        else:
            assert self.session.pose is not None
            reach = number(message, "radius", 0.0) * problem.space.scale or _REACH * self.session.pose.size
            found = trees.hash_grid(self._hits(problem, message, client)["points"], reach)
        self._send(client, "trees", found, tree=kind)

    def _solve(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        self._stop(problem, message, client)
        area = None if message.get("area") is None else number(message, "area")
        file = text(message, "file", "").strip()
        self._solution = SavedSolution(problem, Path(file)) if file else LiveSolution(problem, area)
        self._send_solution(self._solution, None)
        self.session.changed()

    def _stop(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        if self._solution is not None:
            self._solution.close()
            self._solution = None
            self.session.changed()

    def _show_guide(self, problem: Problem, message: Mapping[str, Any], client: Client) -> None:
        guide = self._guide()
        if guide is None:
            raise OptionError("the picture has no guide: render it by guided")
        cell = guide.cell_at(numbers(message, "position", 3), numbers(message, "normal", 3))
        facing = int(guide.boxes()[2][cell])
        picture = guide.picture(cell, _ROWS)
        about: Any = {"cell": cell, "cells": guide.cells, "facing": facing, "width": 2 * _ROWS, "height": _ROWS}
        self._send(client, "guide", {"density": picture}, **about)

    # ------------------------------------------------------------------ parts

    def _guide(self) -> Guide | None:
        """The guide of the picture's method; ``None`` without one."""
        main = self.session.main
        guide = getattr(main.method, "guide", None) if isinstance(main, Refinement) else None
        return guide if isinstance(guide, Guide) else None

    def _recorded(self, problem: Problem, depth: int, client: Client) -> PathRecorder:
        """A recorder for the current scene. It is kept for further paths, because making tables of lights is slow. The
        page is told of the wait for the first paths."""
        if self._recorder is None or self._recorder[0].scene is not problem.scene:
            client.send("note", text=_FIRST)
        if self._recorder is None or self._recorder[0].scene is not problem.scene or self._recorder[1] != depth:
            self._recorder = problem, depth, PathRecorder(problem, depth)
        recorder = self._recorder[2]
        recorder.look(problem)  # the camera may have moved
        return recorder

    def _send_solution(self, live: ShownSolution, client: Client | None) -> None:
        names, shape = live.names()
        self._send(client, "solution", live.mesh() | {"shape": shape}, names=names, max_area=live.max_area)
        if live.solution is not None:
            self._send_values(live, client)

    def _send_values(self, live: ShownSolution, client: Client | None = None) -> None:
        values = live.values()
        luminance, error = values["luminance"], values["error"]
        areas = live.patches.areas
        whole = max((luminance * areas).sum(), 1e-30)
        relative = float((error * areas).sum() / whole) if live.error is not None else None
        about = {"bundles": live.bundles, "relative": relative, "done": live.is_done, "at": time.time()}
        self._send(client, "values", values, **about)

    def _send(self, client: Client | None, verb: str, arrays: Arrays, **fields: Any) -> None:
        data, table = joined(arrays)
        send = self.session.broadcast if client is None else client.send
        send(f"{self.name}.{verb}", data, arrays=table, **fields)


def _count(message: Mapping[str, Any], most: int) -> int:
    count = number(message, "count")
    if not (count.is_integer() and 1 <= count <= most):
        raise OptionError(f"the number of paths is a whole number from 1 to {most}, not {count:g}")
    return int(count)


def _whole(text: str) -> int | str:
    return int(text) if text.isdecimal() else text


def _light_name(emitter: Any) -> str:
    shape = emitter.get_shape()
    own = graph.name(shape) if shape is not None else graph.name(emitter)
    kind = graph.plugin_name(emitter)
    return f"{own} ({kind})" if own and own != "emitter" else kind
