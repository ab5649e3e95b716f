"""What pages are told of a session: ``about`` and ``state``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from etendue.scene import Problem

from .camera import Pose, projection
from .commands import scene_name
from .controls import method_list
from .refining import Refinement, Still
from .shown import choices, layer_names

if TYPE_CHECKING:
    from .session import Session


def about(session: Session) -> dict[str, Any]:
    """What there is to choose from, and the panels' modules; does not change."""
    scripts = {name: {"title": panel.title, "script": panel.script} for name, panel in session.panels.items()}
    return {"methods": method_list(), "folder": str(session.asked.folder), "scripts": scripts, **choices()}


def state(session: Session) -> dict[str, Any]:
    """All that the controls of a page show."""
    problem, pose, asked = session.problem, session.pose, session.asked
    still = session.main if isinstance(session.main, Still) else None
    return {
        "scene": scene_name(asked.scene),
        "loaded": problem is not None or still is not None,
        "still": still is not None,
        "trouble": session.trouble,
        "size": problem.size if problem is not None else still.size if still is not None else None,
        "camera": camera(problem, pose) if problem is not None and pose is not None else None,
        "views": len(session.views),
        "method": asked.method if still is None else still.method,
        "settings": dict(asked.settings),
        "scene_settings": session.main.settings.to_dict() if isinstance(session.main, Refinement) else {},
        "budget": asked.budget.to_dict(),
        "paused": session.paused,
        "preparing": problem is not None and not (isinstance(session.main, Refinement) and session.main.passes),
        "show": vars(session.show),
        "layers": layer_names(session.layers) or ["image"],
        "compared": session.compared.state() if session.compared is not None else None,
        "panels": {name: panel.state() for name, panel in session.panels.items()},
    }


def camera(problem: Problem, pose: Pose) -> dict[str, Any]:
    """The pose in the scene's own coordinates, and the matrix from render space to pixels."""
    return pose.plain(problem) | {"matrix": projection(problem, pose), "distance": pose.distance}
