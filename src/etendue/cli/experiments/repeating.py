"""Command lines that make a picture again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from etendue.engine import Task
from etendue.scene import SceneSource


def picture_command(task: Task, settings: Mapping[str, Any], samples: int, size: tuple[int, int]) -> str:
    """A command that renders the picture of ``task`` again, with as many passes: of ``samples`` per pixel by the
    ``settings`` that it had in the end. Empty if the scene is in memory, or its camera has no options."""
    known = task.source
    assert isinstance(known, SceneSource)
    place = known.place()
    source = place.get("source") or place.get("bundled")
    if source is None or known.camera is not None:
        return ""
    words = ["etendue", "render", source, "-m", task.method.name, "--spp", str(samples), "--seed", str(task.seed)]
    words += ["--size", f"{size[0]}x{size[1]}"]
    if known.sensor:
        words += ["--sensor", str(known.sensor)]
    if known.memory is not None:
        words += ["--memory", str(known.memory)]
    for name, value in (known.parameters or {}).items():
        words += ["-P", f"{name}={value}"]
    defaults = defaults_of(task.method)
    for name, value in settings.items():
        if defaults.get(name) != value:
            words += ["-D", f"{name}={str(value).lower() if isinstance(value, bool) else value}"]
    return shlex.join([*words, "-o", f"{task.method.name}.exr"])


def defaults_of(method: Any) -> dict[str, Any]:
    """The default settings of the class of a method."""
    defaults: dict[str, Any] = method.Settings().to_dict()
    return defaults
