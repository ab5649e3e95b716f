"""Answers to pages about one scene: paths, photons, trees, and radiosity, which is refined between answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from etendue import methods
from etendue.core import OptionError, prepared, suggest
from etendue.scene import Problem
from etendue.transport import Guide, Rays

from ..camera import Pose
from ..figures import particles, paths, trees
from ..figures.solution import LiveSolution, SavedSolution, ShownSolution
from ..protocol import number, numbers, text
from ..refining import Refinement

Arrays = Mapping[str, NDArray[Any]]
#: Sends a message to pages: its verb, arrays, and further fields.
Send = Callable[[str, Arrays, Mapping[str, Any]], object]

#: Most paths that are drawn, and most light paths that make photons.
_MOST_PATHS, _MOST_PHOTONS = 2000, 50_000
#: Rows of the picture of a guide's directions.
_ROWS = 64
#: Radius of a hash grid, relative to half the diagonal of the scene.
_REACH = 0.02


class Desk:
    """Answers about a scene. ``tell`` gets the messages for all pages."""

    def __init__(self, problem: Problem, tell: Send) -> None:
        self._problem, self._tell = problem, tell
        self._solution: ShownSolution | None = None
        self._lights: methods.LightRays | None = None
        self._plain: tuple[Problem, int, methods.Path] | None = None
        self._seed = 0

    def handle(self, verb: str, message: Mapping[str, Any], picture: Callable[[], Refinement], send: Send) -> None:
        """Answer ``paths``, ``photons``, ``tree``, ``guide`` by ``send``; ``solve`` and ``stop`` radiosity, for all
        pages. ``picture``: returns the refinement of the picture, with its prepared method."""
        if verb == "paths":
            self._paths(message, picture, send)
        elif verb == "photons":
            self._photons(message, send)
        elif verb == "tree":
            self._tree(message, picture, send)
        elif verb == "guide":
            self._directions(message, picture, send)
        else:
            self.close()
            if verb == "solve":
                self._solve(message)

    def work(self) -> bool:
        """Cast lines for the solution, and send a new one; returns whether there is more to do."""
        live = self._solution
        if live is None or live.is_done:
            return False
        try:
            if live.step():
                self._send_values(live)
        except Exception:
            self.close()
            raise
        return not live.is_done

    def close(self) -> None:
        """End the solution."""
        if self._solution is not None:
            self._solution.close()
            self._solution = None

    # ------------------------------------------------------------------ rays

    def _paths(self, message: Mapping[str, Any], picture: Callable[[], Refinement], send: Send) -> None:
        count, source = _count(message, _MOST_PATHS), text(message, "source", "camera")
        self._seed += 1
        if source == "camera":
            main = picture()
            width, height = main.problem.size
            x, y = number(message, "x", 0.5) * width, number(message, "y", 0.5) * height
            own = main.rays(x, y, count)
            rays = self._plain_rays(main, x, y, count) if own is None else own
            name, shown = main.method.name, "path" if own is None else main.method.name
        else:
            light = None if source == "lights" else int(number({"light": _whole(source)}, "light"))
            rays, name, shown = self._light_rays().trace(light, count, self._seed), "", ""
        send("paths", paths.lines(rays), {"count": count, "method": name, "shown": shown, "dropped": rays.dropped})

    def _plain_rays(self, main: Refinement, x: float, y: float, count: int) -> Rays:
        """Paths of path tracing, for a method whose own paths do not belong to pixels."""
        depth = main.settings.max_depth
        if self._plain is None or self._plain[:2] != (main.problem, depth):
            settings = methods.Path.Settings.from_mapping({"max_depth": depth, "samples_per_pass": 1})
            self._plain = main.problem, depth, prepared(methods.Path(settings), main.problem, 0)
        rays = methods.rays_through(self._plain[2], x, y, count, self._seed)
        assert rays is not None
        return rays

    def _light_rays(self) -> methods.LightRays:
        if self._lights is None:
            self._lights = methods.LightRays(self._problem)
        return self._lights

    def _photons(self, message: Mapping[str, Any], send: Send) -> None:
        if file := text(message, "file", "").strip():
            found: Arrays = particles.points(self._problem, Path(file))
        else:
            found = self._hits(message)
        send("photons", found, {"total": float(found["power"].sum(axis=0).mean())})

    def _hits(self, message: Mapping[str, Any]) -> Arrays:
        count = _count(message, _MOST_PHOTONS)
        return paths.hits(self._light_rays().trace(None, count, self._seed), count)

    def _tree(self, message: Mapping[str, Any], picture: Callable[[], Refinement], send: Send) -> None:
        kind = text(message, "kind")
        if kind not in trees.KINDS:
            raise OptionError(f"there is no tree '{kind}'; {suggest(kind, trees.KINDS)}")
        if kind == "spheres":
            found: Arrays = trees.spheres(self._problem)
        elif kind == "boxes":
            found = trees.multipath_boxes(self._problem)
        elif kind == "guide":
            found = trees.guide_cells(_guide(picture()))
        elif kind == "kd-tree":
            found = trees.kd_tree(self._hits(message)["points"])
        else:
            reach = number(message, "radius", 0.0) * self._problem.space.scale or _REACH * Pose.of(self._problem).size
            found = trees.hash_grid(self._hits(message)["points"], reach)
        send("trees", found, {"tree": kind})

    def _directions(self, message: Mapping[str, Any], picture: Callable[[], Refinement], send: Send) -> None:
        guide = _guide(picture())
        cell = guide.cell_at(numbers(message, "position", 3), numbers(message, "normal", 3))
        about = {"cell": cell, "cells": guide.cells, "facing": int(guide.boxes()[2][cell])}
        send("guide", {"density": guide.picture(cell, _ROWS)}, about | {"width": 2 * _ROWS, "height": _ROWS})

    # ------------------------------------------------------------------ radiosity

    def _solve(self, message: Mapping[str, Any]) -> None:
        area = None if message.get("area") is None else number(message, "area")
        file = text(message, "file", "").strip()
        live = SavedSolution(self._problem, Path(file)) if file else LiveSolution(self._problem, area)
        self._solution = live
        names, shape = live.names()
        self._tell("solution", live.mesh() | {"shape": shape}, {"names": names, "max_area": live.max_area})
        if live.solution is not None:
            self._send_values(live)

    def _send_values(self, live: ShownSolution) -> None:
        values = live.values()
        luminance, error = values["luminance"], values["error"]
        areas = live.patches.areas
        whole = max((luminance * areas).sum(), 1e-30)
        relative = float((error * areas).sum() / whole) if live.error is not None else None
        self._tell("values", values, {"bundles": live.bundles, "relative": relative, "done": live.is_done})


def _guide(main: Refinement) -> Guide:
    """The guide of a picture's method. Raises :class:`OptionError` if it has none."""
    guide = getattr(main.method, "guide", None)
    if not isinstance(guide, Guide):
        raise OptionError("the picture has no guide: render it by guided")
    return guide


def _count(message: Mapping[str, Any], most: int) -> int:
    count = number(message, "count")
    if not (count.is_integer() and 1 <= count <= most):
        raise OptionError(f"the number of paths is a whole number from 1 to {most}, not {count:g}")
    return int(count)


def _whole(text: str) -> int | str:
    return int(text) if text.isdecimal() else text
