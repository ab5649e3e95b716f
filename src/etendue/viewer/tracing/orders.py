"""What the process of a session gets: the scene as the session shows it, its view, and the message of a page."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from etendue.core import Array, SceneError, State, on_host
from etendue.scene import LightEdits, PortableScene, Problem, corners_of, locate, portable, restored

from ..camera import Pose, place
from ..refining import Refinement
from ..states import Asked

if TYPE_CHECKING:
    from ..session import ViewerSession


@dataclass(frozen=True)
class SceneCopy:
    """A scene that another process of this machine loads as the session has."""

    asked: Asked  #: without scene and lights
    scene: PortableScene | Path
    lights: PortableScene
    removed: frozenset[int]
    changes: Mapping[str, Any]  #: of parameters
    variant: str
    corners: tuple[Array, Array]  #: of the scene's box

    @classmethod
    def of(cls, session: ViewerSession) -> SceneCopy:
        """Raises :class:`SceneError` for a scene in memory that cannot be described."""
        assert session.problem is not None
        asked, scene = session.asked, session.asked.scene
        found = locate(scene, lambda _: None) if isinstance(scene, (str, os.PathLike)) else scene
        return cls(
            asked=_without_scene(asked),
            scene=found.absolute() if isinstance(found, Path) else _in_place(portable(found)),
            lights=_in_place(portable({"added": list(asked.lights.added)})),
            removed=asked.lights.removed,
            changes=session.panels["parameters"].state()["changes"],
            variant=mi.variant(),
            corners=corners_of(session.problem.scene),
        )

    def load(self, load: Callable[[Asked, Mapping[str, Any]], Problem]) -> Problem:
        """Load the scene by ``load`` of what was asked for and the changes of parameters. Raises
        :class:`SceneError` if it is another scene than in the session."""
        scene = self.scene
        if isinstance(scene, PortableScene):
            scene, _ = restored(scene, Path())
        lights, _ = restored(self.lights, Path())
        asked = replace(self.asked, scene=scene, lights=LightEdits(self.removed, tuple(lights["added"])))
        problem = load(asked, self.changes)
        if not np.allclose(corners_of(problem.scene), self.corners, rtol=1e-4):
            raise SceneError("its file has changed since it was opened")
        return problem


@dataclass(frozen=True)
class View:
    """The picture of a session: its method, its camera, and what has been learned."""

    run: int  #: number of the refinement in the session
    asked: Asked  #: without scene and lights
    pose: Pose
    state: State | None  #: on the host; None before the first pass
    passes: int

    @classmethod
    def of(cls, session: ViewerSession, run: int) -> View:
        """The picture as it is now."""
        assert session.pose is not None
        main, asked = session.main, _without_scene(session.asked)
        if not isinstance(main, Refinement):
            return cls(run, asked, session.pose, None, 0)
        return cls(run, asked, session.pose, on_host(main.state), main.passes)

    def refinement(self, problem: Problem, earlier: Refinement | None = None) -> Refinement:
        """The refinement in this state, with the prepared method of ``earlier`` if that is of the same run."""
        if earlier is None:
            place(problem.sensor, self.pose)
            asked = self.asked
            earlier = Refinement(replace(problem), asked.method, asked.settings, asked.budget, asked.seed)
        if self.state is not None:
            earlier.enter(self.state, self.passes)
        return earlier


@dataclass(frozen=True)
class Order:
    """A message of a page to the panel, with what its answer needs."""

    number: int
    verb: str
    message: Mapping[str, Any]
    scene: SceneCopy | None  #: None: the scene of the order before
    view: View | None  #: None if the answer does not depend on it


def _without_scene(asked: Asked) -> Asked:
    return replace(asked, scene=None, lights=LightEdits())


def _in_place(scene: PortableScene) -> PortableScene:
    """``scene`` with its files where they are."""
    moved = scene.description.get("moved", {})
    places = {name: str(scene.files[inside]) for name, inside in moved.items()}
    return PortableScene(scene.description | {"moved": places}, scene.arrays)
