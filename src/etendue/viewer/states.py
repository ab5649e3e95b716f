"""The scene and options that a session shows, and the messages that describe them: ``about`` and ``state``."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import EtendueError
from etendue.display import part_names
from etendue.engine import Budget
from etendue.products import limits_of
from etendue.scene import Change, LightEdits, Problem, is_described, load, resized

from .camera import Pose, projection
from .commands import scene_name
from .controls import method_list
from .refining import Refinement, Still, checked
from .shown import choices, layer_names

if TYPE_CHECKING:
    from .session import ViewerSession

#: Pixels of the picture if no size is asked for.
_PIXELS = 262_144


@dataclass(frozen=True)
class Asked:
    """The scene, the method and the options that a session shows."""

    scene: Any = None  #: as for :func:`etendue.scene.load`, or the file of a picture
    method: str = "path"
    settings: Mapping[str, Any] = field(default_factory=dict)
    budget: Budget = field(default_factory=Budget)
    size: tuple[int, int] | None = None  #: of the film, (width, height)
    sensor: int = 0
    parameters: Mapping[str, Any] | None = None
    memory: int | None = None
    seed: int = 0
    lights: LightEdits = field(default_factory=LightEdits)
    folder: Path = field(default_factory=Path.cwd)  #: for files that are saved
    solution: Path | None = None  #: of radiosity, to be shown in the 3-D view

    def load(self, change: Change) -> Problem:
        """The scene after ``change``, with a sensor of the session's own, at the requested size or, without one, at a
        moderate size."""
        options: dict[str, Any] = {"sensor": self.sensor, "parameters": self.parameters, "memory": self.memory}
        if is_described(self.scene) or self.lights:  # a scene in memory refuses a change
            options["change"] = change
        problem = load(self.scene, size=self.size, **options)
        width, height = problem.size
        factor = 1.0 if self.size is not None else min(1.0, (_PIXELS / (width * height)) ** 0.5)
        return resized(problem, (max(1, round(width * factor)), max(1, round(height * factor))))


def about(session: ViewerSession) -> dict[str, Any]:
    """The available choices, and the panels' modules; constant."""
    scripts = {name: {"title": panel.title, "script": panel.script} for name, panel in session.panels.items()}
    return {"methods": method_list(), "folder": str(session.asked.folder), "scripts": scripts, **choices()}


def state(session: ViewerSession) -> dict[str, Any]:
    """Everything that the controls of a page show."""
    problem, pose, asked = session.problem, session.pose, session.asked
    still = session.main if isinstance(session.main, Still) else None
    return {
        "scene": scene_name(asked.scene),
        "loaded": problem is not None or still is not None,
        "still": still is not None,
        "trouble": session.trouble,
        "size": problem.size if problem is not None else still.size if still is not None else None,
        "film": [int(v) for v in problem.sensor.film().size()] if problem is not None else None,
        "camera": camera(problem, pose) if problem is not None and pose is not None else None,
        "views": len(session.views),
        "method": asked.method if still is None else still.method,
        "settings": dict(asked.settings),
        "scene_settings": _settings(session),
        "budget": limits_of(asked.budget),
        "paused": session.paused,
        "preparing": problem is not None and not (isinstance(session.main, Refinement) and session.main.passes),
        "show": vars(session.show),
        "filters": {name: vars(one) for name, one in session.show.filters().items()},
        "layers": layer_names(session.layers),
        "components": part_names(session.layers),
        "compared": session.compared.state() if session.compared is not None else None,
        "panels": {name: panel.state() for name, panel in session.panels.items()},
    }


def _settings(session: ViewerSession) -> dict[str, Any]:
    """All settings of the method on the scene, also before it is prepared; empty without a scene or on an error."""
    asked, problem = session.asked, session.problem
    if isinstance(session.main, Refinement):
        settings: dict[str, Any] = session.main.settings.to_dict()
        return settings
    with suppress(EtendueError):
        return {} if problem is None else checked(problem, asked.method, asked.settings).to_dict()
    return {}


def camera(problem: Problem, pose: Pose) -> dict[str, Any]:
    """The pose in the scene's own coordinates, and the matrix from render space to pixels."""
    return pose.plain(problem) | {"matrix": projection(problem, pose), "distance": pose.distance}
