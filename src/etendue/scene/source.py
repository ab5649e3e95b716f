"""A scene as the source of a run, in this process and in workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from etendue.core import CheckpointError, Ingredients, OptionError, SceneError, is_whole, logger

from .builtin.table import BundledScene, bundled_scene
from .camera import Camera
from .editing import is_described
from .loading import checked_size, load, locate
from .parts import load_part, part_files, unmerged
from .portables import PortableScene, portable, restored
from .problem import Problem

if TYPE_CHECKING:
    from etendue.lighting import Meters

#: Smallest memory bound in bytes: 16 MB.
LEAST_MEMORY = 16 << 20


@dataclass(frozen=True)
class SceneSource:
    """A scene in any form that :func:`load` takes, and its other arguments. Raises :class:`OptionError` for values that
    are out of range."""

    scene: Any
    size: tuple[int, int] | None = None
    sensor: int = 0
    parameters: Mapping[str, Any] | None = None
    memory: int | None = None
    camera: Camera | None = None
    merge: bool = True  #: whether meshes may be merged; if not, shapes keep their names and order
    meters: Meters | None = None  #: in place of the sensor
    lit: bool = True  #: whether the scene needs an emitter

    def __post_init__(self) -> None:
        for name, what, least in (
            ("sensor", "a sensor is a whole number", 0),
            ("memory", "a memory bound is a whole number of bytes", LEAST_MEMORY),
        ):
            if (value := getattr(self, name)) is None:
                continue
            if not is_whole(value) or value < least:
                raise OptionError(f"{what} of at least {least}, not {value!r}")
            object.__setattr__(self, name, int(value))  # for checkpoints, as a plain number
        if self.size is not None:
            object.__setattr__(self, "size", checked_size(self.size))

    def open(self, tell: Callable[[str], object] = logger.info) -> Problem:
        """Load the scene. ``tell`` receives a remark if its name is ambiguous."""
        scene = locate(self.scene, tell) if isinstance(self.scene, (str, os.PathLike)) else self.scene
        problem = load(
            scene,
            size=self.size,
            sensor=self.sensor if self.meters is None else None,
            parameters=self.parameters,
            memory=self.memory,
            camera=self.camera,
            change=None if self.merge or not is_described(scene) else unmerged,
            lit=self.lit,
        )
        return problem if self.meters is None else _measured(problem, self.meters)

    def place(self) -> dict[str, Any]:
        """Plain values for :meth:`at`. The scene is ``source``, a file, or ``bundled``, a name; neither if it is in
        memory."""
        place: dict[str, Any] = {"sensor": self.sensor} | placed(self.scene)
        for name in ("size", "memory"):
            if (value := getattr(self, name)) is not None:
                place[name] = value
        if self.parameters:
            place["parameters"] = {k: str(v) for k, v in self.parameters.items()}
        if self.camera is not None:
            place["camera"] = self.camera.to_dict()
        if not self.merge:
            place["merge"] = False
        if self.meters is not None:
            place |= {"meters": self.meters.to_dict(), "lit": self.lit}
        return place

    @classmethod
    def at(cls, place: Mapping[str, Any], scene: Any = None) -> Self:
        """The source of a checkpoint; ``scene``: its new place. Raises :class:`CheckpointError` for one in memory, and
        :class:`SceneError` for a bundled scene that does not exist."""
        if scene is None:
            scene = found(place)
        known = {name: place[name] for name in ("sensor", "parameters", "memory", "merge", "lit") if name in place}
        if "size" in place:
            known["size"] = tuple(place["size"])
        if "camera" in place:
            known["camera"] = Camera(**{"fov_axis": "y", **place["camera"]})  # version 1 had this axis only
        if "meters" in place:
            from etendue.lighting import Meters

            known["meters"] = Meters(**place["meters"])
        return cls(scene, **known)

    def ingredients(self, problem: Problem) -> Ingredients:
        """What a worker loads the scene from. Raises :class:`SceneError` for a scene in memory."""
        scene = portable(self.scene, self.parameters)
        values = {"scene": scene.description, "sensor": self.sensor, "size": self.size, "memory": self.memory}
        if self.camera is not None:
            values["camera"] = self.camera.to_dict()
        if not self.merge:
            values["merge"] = False
        if self.meters is not None:
            values |= {"meters": self.meters.to_dict(), "lit": self.lit}
        return Ingredients(f"{__name__}:open_scene", values, scene.arrays, scene.files)

    def part_ingredients(self, shapes: Collection[str]) -> Ingredients:
        """What a worker loads a part of the scene from: the shapes with these ids, and the files that they need. Errors
        as :meth:`ingredients`."""
        scene = portable(self.scene, self.parameters)
        files = part_files(scene, self.scene, shapes, self.parameters)
        values = {"scene": scene.description, "part": sorted(shapes)}
        return Ingredients(f"{__name__}:open_scene", values, scene.arrays, files)


def placed(scene: Any) -> dict[str, str]:
    """Where a scene is found again: ``source``, a file, or ``bundled``, a name; empty for a scene in memory."""
    if isinstance(scene, (str, os.PathLike)):
        scene = locate(scene, logger.debug)
    if isinstance(scene, Path):
        return {"source": str(scene.absolute())}
    return {"bundled": scene.name} if isinstance(scene, BundledScene) else {}


def found(place: Mapping[str, Any]) -> Any:
    """The scene of :func:`placed`. Raises :class:`CheckpointError` for one in memory."""
    if "source" in place:
        return place["source"]
    if "bundled" not in place:
        raise CheckpointError("the checkpoint was made from a scene in memory; give the scene to resume it with")
    try:
        return bundled_scene(place["bundled"])
    except SceneError as error:
        raise CheckpointError(f"the scene of the checkpoint cannot be loaded: {error}") from error


def open_scene(ingredients: Ingredients, folder: Path) -> Any:
    """Load the scene of :meth:`SceneSource.ingredients` or :meth:`SceneSource.part_ingredients`."""
    values = ingredients.values
    scene, parameters = restored(PortableScene(values["scene"], ingredients.arrays), folder)
    if "part" in values:
        return load_part(scene, values["part"], parameters or None)
    size, camera = values["size"], values.get("camera")
    meters = values.get("meters")
    problem = load(
        scene,
        size=None if size is None else tuple(size),
        sensor=values["sensor"] if meters is None else None,
        parameters=parameters or None,
        memory=values["memory"],
        camera=None if camera is None else Camera(**camera),
        change=None if values.get("merge", True) else unmerged,
        lit=values.get("lit", True),
    )
    if meters is None:
        return problem
    from etendue.lighting import Meters

    return _measured(problem, Meters(**meters))


def _measured(problem: Problem, meters: Meters) -> Problem:
    from .meters import with_meters  # which needs a variant

    return with_meters(problem, meters)
