"""Files that a session writes to its folder: the picture, the scene, and a run file that repeats the picture."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from etendue.core import OptionError
from etendue.display import luminance_picture, tonemap, write_png
from etendue.engine import check_save_times
from etendue.film import write_bytes
from etendue.products import check_picture, limits_of, save_result
from etendue.scene import MOVABLE, BundledScene, graph, is_sensor, locate, scene_xml

from .refining import Refinement, Still
from .shown import LUMINANCE_LAYER, luminances

if TYPE_CHECKING:
    from .session import ViewerSession

#: Kinds of files, with the endings of their names.
KINDS = {"picture": (".exr", ".png"), "scene": (".xml",), "run": (".toml",)}


def save(session: ViewerSession, what: str, name: str, times: str = "") -> Path:
    """Write a file and return its path. ``times``: seconds of the autosaves of a run file, as "20, 60".

    Raises :class:`OptionError` for such text and unless the name is that of a plain file with the right ending,
    :class:`OutputError` if the file cannot be written, :class:`SceneError` for a scene in memory."""
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
    _spare_scene(session, path)
    if what == "run":
        _save_run(session, path, _times(times))
    else:
        {"picture": _save_picture, "scene": _save_scene}[what](session, path)
    return path


def _times(text: str) -> list[float]:
    try:
        times = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        raise OptionError(f"the times of autosaves are seconds, as 20, 60, not '{text}'") from None
    check_save_times(times)
    return times


def _spare_scene(session: ViewerSession, path: Path) -> None:
    """Raise :class:`OptionError` if ``path`` is the open scene or the open picture."""
    is_still = isinstance(session.main, Still)
    own = session.asked.scene if is_still else (_source(session.asked.scene) or {}).get("file")
    if own is not None and path.exists() and os.path.samefile(path, own):
        what = "picture" if is_still else "scene"
        raise OptionError(f"'{path.name}' is the {what} that is open, which is not written over; give another name")


def _save_picture(session: ViewerSession, path: Path) -> None:
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
    elif show.layer == LUMINANCE_LAYER:
        low, high = luminances(show.stops(result.image))
        write_png(path, luminance_picture(show.picture(result.layers), low=low, high=high))
    else:
        write_png(path, show.colours(result.layers, show.stops(result.image)))


def _save_scene(session: ViewerSession, path: Path) -> None:
    """The scene as XML: with the session's camera, its lights, the edits of panels, and the requested size. Meshes
    and pictures that the scene has in memory are written to a folder beside the file."""

    def change(state: mi.parser.ParserState) -> None:
        session.asked.lights(state)
        for panel in session.panels.values():
            panel.describe(state)
        _set_camera(session, state)

    asked, folder = session.asked, path.with_name(f"{path.stem}-files")
    write_bytes(path, scene_xml(asked.scene, asked.parameters, change, asked.size, folder).encode())


def _set_camera(session: ViewerSession, state: mi.parser.ParserState) -> None:
    assert session.problem is not None and session.pose is not None
    pose, problem = session.pose, session.problem
    matrix = pose.matrix()
    matrix[:3, 3] = problem.space.to_scene(pose.origin)
    if graph.plugin_name(problem.sensor) == "orthographic":  # the transform contains the size of the view
        matrix[:3, :2] /= problem.space.scale
    sensors = [node for node in state.nodes if is_sensor(node)]
    if session.asked.sensor >= len(sensors):
        return
    props = sensors[session.asked.sensor].props
    props["to_world"] = mi.ScalarTransform4d(matrix)
    if pose.fov is not None:
        for key in {"focal_length", "fov", "fov_axis"} & set(props.keys()):
            del props[key]
        props["fov"], props["fov_axis"] = float(pose.fov), "x"


def _save_run(session: ViewerSession, path: Path, times: Sequence[float]) -> None:
    """A run file, which ends with the last of ``times`` if there are any. The scene is written beside it unless the
    scene's file and a camera table describe it completely."""
    assert session.problem is not None and session.pose is not None
    asked, moved = session.asked, session.pose is not session.home
    own, camera = _source(asked.scene), _run_camera(session)
    if own is None or asked.lights or _is_edited(session) or (moved and camera is None):
        scene = path.with_name(f"{path.stem}-scene.xml")
        _spare_scene(session, scene)
        _save_scene(session, scene)
        session.saved[scene.name] = scene
        tables: dict[str, Any] = {"scene": {"file": scene.name}}
    else:
        tables = {"scene": {**own, "parameters": asked.parameters}, "camera": camera if moved else {}}
    if times:
        tables["autosave"] = {"times": times, "exit_after_last": True}
    write_bytes(path, run_text(session, tables, f"{path.stem}-run").encode())


def run_text(session: ViewerSession, tables: Mapping[str, Mapping[str, Any]], name: str) -> str:
    """The text of a run file that repeats the session's picture, in files called ``name``. ``tables``: those of the
    scene, its camera, and autosaves in place of the session's budget."""
    assert session.problem is not None
    asked, problem = session.asked, session.problem
    budget = limits_of(asked.budget) or {"spp": _samples(session)}
    every: dict[str, Mapping[str, Any]] = {
        "scene": {**tables["scene"], "sensor": asked.sensor, "size": list(_film(problem))},
        "camera": tables.get("camera", {}),
        "method": {"name": asked.method, "settings": asked.settings},
        **({"autosave": tables["autosave"]} if "autosave" in tables else {"budget": budget}),
        "output": {"name": name, "png": True},
    }
    lines = [f"seed = {asked.seed}"] + ([f"memory = {asked.memory}"] if asked.memory else [])
    for title, table in every.items():
        rows = [f"{key} = {_toml(value)}" for key, value in table.items() if value not in (None, {}, [])]
        lines += ["", f"[{title}]", *rows] if rows else []
    return "\n".join(lines) + "\n"


def _run_camera(session: ViewerSession) -> dict[str, Any] | None:
    """The table of a run file for the camera; ``None`` if a table cannot describe this camera."""
    assert session.problem is not None and session.pose is not None
    problem, pose = session.problem, session.pose
    if graph.plugin_name(problem.sensor) not in MOVABLE or not pose.is_plain or pose.fov is None:
        return None
    return pose.plain(problem) | {"fov": pose.fov}


def _samples(session: ViewerSession) -> int:
    """Samples per pixel of the picture; before the first pass, of the scene's file."""
    assert session.problem is not None
    main = session.main
    return main.samples if isinstance(main, Refinement) and main.samples else max(1, session.problem.spp)


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


def _is_edited(session: ViewerSession) -> bool:
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
