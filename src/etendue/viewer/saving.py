"""Files that a session writes, in its folder: the picture, the scene, and a run file that repeats the whole."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from etendue.core import OptionError
from etendue.display import tonemap, write_png
from etendue.film import write_bytes
from etendue.jobs import check_picture, save_result
from etendue.scene import BundledScene, graph, locate, scene_xml

from .camera import vertical_fov
from .refining import Refinement

if TYPE_CHECKING:
    from .session import Session

#: What can be saved, with the ending of the name.
KINDS = {"picture": (".exr", ".png"), "scene": (".xml",), "run": (".toml",)}


def save(session: Session, what: str, name: str) -> Path:
    """Write a file and return its path. Raises :class:`OptionError` for a name that is not that of a plain file with
    the right ending, :class:`OutputError` if it cannot be written, :class:`SceneError` for a scene in memory."""
    if what not in KINDS:
        raise OptionError(f"what can be saved is {', '.join(KINDS)}, not '{what}'")
    endings = KINDS[what]
    name = name.strip() or f"view{endings[0]}"
    if name.startswith(".") or any(c in '/\\:*?"<>|' or ord(c) < 32 for c in name):
        raise OptionError(
            f"give a file name without a folder, not '{name}': files are written to {session.asked.folder}"
        )
    if Path(name).suffix.lower() not in endings:
        raise OptionError(f"a {what} is written as {' or '.join(endings)}, not as '{name}'; change the name")
    if session.problem is None and (what != "picture" or session.main is None):
        raise OptionError("no scene is loaded; open one first")
    path = session.asked.folder / name
    {"picture": _save_picture, "scene": _save_scene, "run": _save_run}[what](session, path)
    return path


def _save_picture(session: Session, path: Path) -> None:
    """EXR: all layers, linear, as rendered. PNG: as shown."""
    result = session.main.result() if session.main is not None else None
    if result is None:
        raise OptionError("there is no picture yet; wait for the first pass")
    if session.problem is not None and session.pose is not None:
        result.metadata["camera"] = session.pose.plain(session.problem)
    show = session.show
    if check_picture(path) == ".exr":
        if show.denoise:
            result.layers["denoised"] = show.picture(result.layers)
        save_result(path, result)
    elif show.layer == "image":
        write_png(path, tonemap(show.picture(result.layers), show.stops(result.image), show.curve))
    else:
        write_png(path, show.colours(result.layers, show.stops(result.image)))


def _save_scene(session: Session, path: Path) -> None:
    """The scene as XML: with the session's camera and size, its lights, and the edits of panels. Meshes and pictures
    that it has in memory are written to a folder beside it."""

    def change(state: mi.parser.ParserState) -> None:
        session.asked.lights(state)
        for panel in session.panels.values():
            panel.describe(state)
        _set_camera(session, state)

    text = scene_xml(session.asked.scene, session.asked.parameters, change, path.with_name(f"{path.stem}-files"))
    write_bytes(path, text.encode())


def _set_camera(session: Session, state: mi.parser.ParserState) -> None:
    assert session.problem is not None and session.pose is not None
    pose, problem = session.pose, session.problem
    matrix = pose.matrix()
    matrix[:3, 3] = problem.space.to_scene(pose.origin)
    if graph.plugin_name(problem.sensor) == "orthographic":  # whose transform has the size of the view
        matrix[:3, :2] /= problem.space.scale
    sensors = [node for node in state.nodes if node.type == mi.ObjectType.Sensor]
    if session.asked.sensor >= len(sensors):
        return
    props = sensors[session.asked.sensor].props
    props["to_world"] = mi.ScalarTransform4d(matrix)
    if pose.fov is not None:
        for key in {"focal_length", "fov", "fov_axis"} & set(props.keys()):
            del props[key]
        props["fov"], props["fov_axis"] = float(pose.fov), "x"


def _save_run(session: Session, path: Path) -> None:
    """A run file. The scene is written beside it if it is not as it was opened."""
    assert session.problem is not None and session.pose is not None
    asked, scene = session.asked, path.with_name(f"{path.stem}-scene.xml")
    own = _source(asked.scene)
    if own is None or asked.lights or _is_edited(session) or not session.pose.is_plain:
        _save_scene(session, scene)
        session.saved[scene.name] = scene
        own = {"file": scene.name}
    write_bytes(path, run_text(session, own, f"{path.stem}-run").encode())


def run_text(session: Session, scene: Mapping[str, Any], name: str) -> str:
    """The text of a run file that repeats the session's picture, in files of that name."""
    assert session.problem is not None and session.pose is not None
    asked, problem = session.asked, session.problem
    camera = session.pose.plain(problem)
    if session.pose.fov is not None:
        camera["fov"] = vertical_fov(session.pose.fov, _film(problem))
    else:
        del camera["fov"]
    budget = asked.budget.to_dict()
    if not budget and isinstance(session.main, Refinement):
        budget = {"samples": max(1, session.main.samples)}
    tables: dict[str, Mapping[str, Any]] = {
        "scene": {**scene, "sensor": asked.sensor, "size": list(problem.size), "parameters": asked.parameters},
        "camera": camera if graph.plugin_name(problem.sensor) in ("perspective", "thinlens") else {},
        "method": {"name": asked.method, "settings": asked.settings},
        "budget": budget,
        "output": {"name": name, "png": True},
    }
    if scene.get("file", "").endswith("-scene.xml"):  # which has the camera
        tables["camera"] = {}
        tables["scene"] = {k: v for k, v in tables["scene"].items() if k != "parameters"}
    head = [f"seed = {asked.seed}"] + ([f"memory = {asked.memory}"] if asked.memory else [])
    lines = [*head]
    for name, table in tables.items():
        rows = [f"{key} = {_toml(value)}" for key, value in table.items() if value not in (None, {}, [])]
        lines += ["", f"[{name}]", *rows] if rows else []
    return "\n".join(lines) + "\n"


def _film(problem: Any) -> tuple[int, int]:
    width, height = (int(v) for v in problem.sensor.film().size())
    return width, height


def _source(scene: Any) -> dict[str, Any] | None:
    """The scene as a run file names it; ``None`` if it has no name."""
    if isinstance(scene, BundledScene):
        return {"bundled": scene.name}
    if not isinstance(scene, (str, os.PathLike)):
        return None
    found = locate(scene, lambda _: None)
    return {"bundled": found.name} if isinstance(found, BundledScene) else {"file": str(found.absolute())}


def _is_edited(session: Session) -> bool:
    return any(panel.is_edited() for panel in session.panels.values())


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, (int, float, np.number)):
        return repr(float(value)) if isinstance(value, (float, np.floating)) else str(int(value))
    return json.dumps(str(value), ensure_ascii=False)
