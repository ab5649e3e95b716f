"""Handlers of the messages of pages. They run in the session's thread; errors are shown in the page that asked."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from etendue import film, methods
from etendue.core import Array, OptionError, is_whole, suggest
from etendue.engine import Budget
from etendue.products import DEFAULT, budget_of
from etendue.scene import BundledScene, Problem, graph

from . import saving
from .camera import Pose, held_back, is_placed, place
from .clients import Client
from .comparing import Comparison
from .protocol import number, numbers, text
from .refining import Still, checked
from .shown import LUMINANCE_LAYER

if TYPE_CHECKING:
    import mitsuba as mi

    from .session import ViewerSession

#: Message to the pages at the end.
ENDED = "The session has ended; this page can be closed."

#: Largest and smallest side of a picture, in pixels.
_SIDES = 16, 4096


def handle(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    """Do what a message asks for. Raises :class:`OptionError` for an unknown or invalid message."""
    kind = message["type"]
    if kind not in COMMANDS:
        raise OptionError(f"there is no message '{kind}'; {suggest(kind, COMMANDS)}")
    COMMANDS[kind](session, client, message)


def scene_name(source: Any) -> str:
    """A scene as the page names it."""
    if isinstance(source, (str, os.PathLike)):
        return str(source)
    if isinstance(source, BundledScene):
        return source.name
    return "" if source is None else "a scene in memory"


def _camera(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    problem, pose = _scene(session)
    if message.get("reset"):
        assert session.home is not None
        pose = session.home
    if "set" in message:
        if not isinstance(message["set"], Mapping):
            raise OptionError("a camera is set by origin, target, up and fov")
        pose = pose.placed(message["set"], problem)
    if "grab" in message:
        _, pivot = _seen_at(problem, pose, *numbers(message, "grab", 2))
        pose = replace(pose, pivot=pivot)
    moved = pose.moved(message)
    session.move(held_back(problem, pose, moved) if "orbit" in message and not pose.flat else moved)


def _views(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    _, pose = _scene(session)
    views = session.views
    if message.get("save"):
        views.append(pose)
    elif "remove" in message:
        del views[_index(message["remove"], len(views))]
    elif message.get("show") == "next":
        if not views:
            raise OptionError("there is no saved view; save one first")
        places = [k for k, view in enumerate(views) if view is pose]
        session.move(views[(places[0] + 1) % len(views) if places else 0])
    elif "show" in message:
        session.move(views[_index(message["show"], len(views))])
    session.changed()


def _pick(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    x, y = number(message, "x"), number(message, "y")
    _check_place(x, y)
    if isinstance(session.main, Still):
        client.send("picked", x=x, y=y, radiance=_radiance(session, x, y), shape=None)
        return
    problem, pose = _scene(session)
    si, point = _seen_at(problem, pose, x, y)
    session.pose = replace(pose, pivot=point)
    found: dict[str, Any] = {"x": x, "y": y, "radiance": _radiance(session, x, y), "shape": None}
    if point is not None:
        shape = _pointed(si.shape)
        bsdf = shape.bsdf() if shape is not None else None
        found |= {
            "shape": graph.describe(shape, "shape") if shape is not None else "a shape",
            "material": graph.describe(bsdf, "material") if bsdf is not None else "",
            "emits": bool(shape is not None and shape.is_emitter()),
            "position": problem.space.to_scene(point).tolist(),
            "point": point.tolist(),  # in render space, for `project`
            "normal": (_triple(si.sh_frame.n) * math.copysign(1.0, _triple(si.wi)[2])).tolist(),  # towards the camera
            "uv": np.asarray(si.uv, dtype=float).ravel().tolist(),
            "depth": float(np.asarray(si.t).ravel()[0]) / problem.space.scale,
            "triangle": int(np.asarray(si.prim_index).ravel()[0]),
        }
    client.send("picked", **found)


def _render(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    asked = session.asked
    if isinstance(session.main, Still):
        _scene(session)
    if "method" in message or "settings" in message:
        method = methods.get(text(message, "method", asked.method)).name
        settings = message.get("settings", asked.settings if method == asked.method else {})
        asked = replace(asked, method=method, settings=_settings(session, method, settings))
    if "budget" in message:
        asked = replace(asked, budget=_budget(message["budget"]))
    if "size" in message:
        asked = replace(asked, size=_size(message["size"]))
    resize = asked.size != session.asked.size
    is_new = asked != session.asked
    if resize:
        _scene(session)
        session.open(asked, keep_pose=True)
    session.asked = asked
    if "paused" in message:
        session.paused = bool(message["paused"])
    if is_new or message.get("again"):
        session.again()
    session.changed()


def _show(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    shown = session.show.changed(message)
    if "layer" in message and shown.layer not in {"image", LUMINANCE_LAYER, *session.layers}:
        raise OptionError(f"there is no layer '{shown.layer}'; {suggest(shown.layer, session.layers)}")
    session.show = shown
    session.refresh()
    session.changed()


def _compare(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    as_map = bool(message.get("map", session.compared.map if session.compared is not None else False))
    if message.get("reference"):
        name = text(message, "reference")
        before = session.compared
        if before is not None and before.name == name:  # shown in another way
            before.map = as_map
            session.compare(before)
            return
        picture = film.read_image(name)
        size = picture.shape[1], picture.shape[0]
        if isinstance(session.main, Still):
            if session.main.size != size:
                raise OptionError(f"the reference has {_by(size)} pixels, the picture {_by(session.main.size)}")
            session.compare(Comparison(name=name, reference=picture, map=as_map))
            return
        problem, _ = _scene(session)
        _fit(session, problem, size)
        assert session.home is not None
        session.move(session.home)  # the camera with which the reference was made
        session.compare(Comparison(name=name, reference=picture, map=as_map))
    elif message.get("method"):
        _scene(session)
        method = methods.get(text(message, "method")).name
        settings = _settings(session, method, message.get("settings", {}))
        before = session.compared
        if before is not None and (before.method, before.settings) == (method, settings):
            before.map = as_map
            session.compare(before)
        else:
            session.compare(Comparison(method, settings, map=as_map))
    else:
        session.compare(None)


def _fit(session: ViewerSession, problem: Problem, size: tuple[int, int]) -> None:
    """Give the picture a size. Raises :class:`OptionError` if it cannot have it."""
    if problem.size == size:
        return
    whole = [int(v) for v in problem.sensor.film().size()]
    width, height = (max(1, round(f * s / w)) for f, s, w in zip(whole, size, problem.size, strict=True))
    session.open(replace(session.asked, size=(width, height)), keep_pose=True)
    assert session.problem is not None
    if session.problem.size != size:
        raise OptionError(
            f"the reference has {size[0]}x{size[1]} pixels, which the film's crop window cannot have: the nearest is "
            f"{session.problem.size[0]}x{session.problem.size[1]}; make the reference at that size"
        )


def _open(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    name = text(message, "scene").strip()
    if not name:
        raise OptionError("give a scene file, the name of a bundled scene, or a picture")
    fresh = type(session.asked.lights)()
    session.open(replace(session.asked, scene=name, parameters=None, sensor=0, lights=fresh, solution=None))
    session.changed()


def _save(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    path = saving.save(session, text(message, "what"), text(message, "name", ""), text(message, "times", ""))
    session.saved[path.name] = path
    client.send("saved", path=str(path), file=path.name)


def _quit(session: ViewerSession, client: Client, message: Mapping[str, Any]) -> None:
    session.broadcast("note", text=ENDED)
    session.close(wait=False)


COMMANDS: Final[dict[str, Callable[[ViewerSession, Client, Mapping[str, Any]], None]]] = {
    "camera": _camera,
    "views": _views,
    "pick": _pick,
    "render": _render,
    "show": _show,
    "compare": _compare,
    "open": _open,
    "save": _save,
    "quit": _quit,
}


# -- values of messages ----------------------------------------------------------------------------------------------


def _scene(session: ViewerSession) -> tuple[Any, Any]:
    """(problem, pose). Raises :class:`OptionError` if no scene is loaded."""
    if session.problem is None or session.pose is None:
        what = "this is a picture without a scene" if isinstance(session.main, Still) else "no scene is loaded"
        raise OptionError(f"{what}; open one first")
    return session.problem, session.pose


def _check_place(x: float, y: float) -> None:
    if not (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
        raise OptionError("a place in the picture has x and y from 0 to 1")


def _seen_at(problem: Problem, pose: Pose, x: float, y: float) -> tuple[mi.SurfaceInteraction3f, Array | None]:
    """(the surface at a place in the picture, its point in render space; ``None`` if there is none)."""
    import drjit as dr
    import mitsuba as mi

    _check_place(x, y)
    if not is_placed(problem.sensor, pose):
        place(problem.sensor, pose)
    on_film = mi.Point2f(dr.opaque(mi.Float, x), dr.opaque(mi.Float, y))  # literals would make a kernel for each place
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, on_film, mi.Point2f(0.5))
    si = problem.scene.ray_intersect(ray)
    dr.eval(si)
    return si, _triple(si.p) if bool(np.asarray(si.is_valid()).ravel()[0]) else None


def _settings(session: ViewerSession, method: str, values: Any) -> dict[str, Any]:
    if not isinstance(values, Mapping):
        raise OptionError("settings are names with values")
    given = {str(name): value for name, value in values.items()}
    kind = methods.get(method)
    kind.Settings.from_mapping(given, owner=f"method '{method}'")
    if session.problem is not None:
        checked(session.problem, method, given)
    return given


def _budget(values: Any) -> Budget:
    if not isinstance(values, Mapping) or values.keys() - {"seconds", "spp", "error"}:
        raise OptionError("a budget has seconds, spp or error")
    return budget_of(methods.get(DEFAULT), values)


def _size(values: Any) -> tuple[int, int]:
    low, high = _SIDES
    if not isinstance(values, list) or len(values) != 2 or not all(is_whole(v) and low <= v <= high for v in values):
        raise OptionError(f"the sides of a picture are whole numbers from {low} to {high}, not {values!r}")
    return int(values[0]), int(values[1])


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _index(value: Any, count: int) -> int:
    if not is_whole(value) or not 0 <= value < count:
        raise OptionError(f"there is no view {value!r}; there are {count}")
    return int(value)


def _radiance(session: ViewerSession, x: float, y: float) -> list[float] | None:
    """Radiance of the picture at a place; ``None`` before the first picture of this view."""
    if "image" not in session.layers or session.main is None or not session.main.passes:
        return None
    image = session.layers["image"]
    height, width = image.shape[:2]
    return [float(v) for v in image[min(int(y * height), height - 1), min(int(x * width), width - 1)]]


def _pointed(shapes: Any) -> Any:
    """The object of an array of one pointer."""
    try:
        return shapes[0]
    except (TypeError, IndexError):
        return None


def _triple(vector: Any) -> Any:
    return np.asarray(vector, dtype=np.float64).ravel()[:3]
