"""Emission and connections that a method learns pass by pass: generations of training, and their state.

Training has generations of 1, 2, 4, ... passes. A pass samples by what earlier generations have learned, so that each
pass is unbiased given the passes before it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, CheckpointError
from etendue.scene import LightTable

from .connections import CLASSES, ConnectionGuide, ConnectionSums, ConnectionTraining
from .emission import EmissionGuide, EmissionSums, EmissionTraining
from .worth import BLOCK

#: Number of lights from which on ``auto`` of ``guide_emission`` learns their selection, and ``auto`` of
#: ``direct_light`` uses all techniques, because next event picks only one of the lights.
MANY = 8
#: Description and values of the setting ``guide_emission``.
GUIDE = (
    "learn from the picture which lights to emit light paths from and to sample by next event estimation (lights), and "
    f"also into which directions (on); auto: lights in scenes with {MANY} lights or more, else off"
)
GUIDE_CHOICES = ("auto", "off", "lights", "on")
#: Generations of training; the guide is fixed after the last one.
GENERATIONS = 5
#: Generations after which training ends if there is nothing to gain.
_UNTIL = 3


class Learned(ABC):
    """Generations of training, and the brightness of the picture so far. ``size``: width and height of the picture, in
    pixels."""

    def __init__(self, size: tuple[int, int]) -> None:
        #: Mean contribution to a pixel; 0 if it is unknown, and nothing is learned.
        self.unit = 0.0
        self._generation = self._passes = 0
        self._width, height = size
        self._blocks = np.zeros((-(-height // BLOCK), -(-self._width // BLOCK)))  # sums of luminance of all passes
        self._seen = 0.0  # camera paths per pixel in these sums
        self._levels = np.ones(self._blocks.size)
        self.drop()

    def measure(self, brightness: float) -> None:
        """Set the mean contribution to a pixel, if it is unknown; rounded to steps, so that rounding errors, which
        depend on the order of additions, do not matter."""
        if self.unit <= 0.0 < brightness:
            self.unit = 2.0 ** (round(4.0 * math.log2(brightness)) / 4.0)

    @property
    def generation(self) -> int:
        """Generations of training that have ended."""
        return self._generation

    @property
    def trains(self) -> bool:
        """Whether the guide learns from the next pass."""
        return self._generation < GENERATIONS

    @abstractmethod
    def drop(self) -> None:
        """Discard the sums of the current pass."""

    @abstractmethod
    def _keep(self) -> None:
        """Add the sums of the current pass to those of the generation."""

    @abstractmethod
    def _learn(self) -> None:
        """Learn at the end of a generation."""

    def end_pass(self, image: NDArray[np.float32], samples: int) -> None:
        """Keep the sums of a pass, and learn if it ends a generation. ``image``: sums of the pass."""
        if not self.trains:
            return
        if self.unit <= 0.0:
            self.measure(float(image.mean(dtype=np.float64)) / samples)
            self.drop()
            return
        self._keep()
        self._blocks = self._blocks + _block_means(image)
        self._seen += samples
        self._passes += 1
        if self._passes >= 1 << self._generation:
            self._generation, self._passes = self._generation + 1, 0
            self._learn()
            self._set_levels()
        self.drop()

    def _set_levels(self) -> None:
        levels = self._blocks.ravel() / max(self._seen, 1.0)
        if self.unit > 0.0 and levels.sum() > 0.0:
            # Rounded to steps, so that the order in which splats were added does not matter.
            relative = np.maximum(levels / self.unit, 2.0**-8)
            self._levels = 2.0 ** (np.round(4.0 * np.log2(relative)) / 4.0)

    def state(self) -> dict[str, Any]:
        """Guide and sums, as arrays that are not modified later."""
        return {
            "unit": self.unit,
            "generation": self._generation,
            "passes": self._passes,
            "blocks": self._blocks,
            "seen": self._seen,
            "levels": self._levels,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Inverse of :meth:`state`. Raises :class:`CheckpointError` for a state that does not fit."""
        self.unit, self._seen = float(state["unit"]), float(state["seen"])
        self._generation, self._passes = int(state["generation"]), int(state["passes"])
        blocks = np.asarray(state["blocks"], np.float64)
        if blocks.shape != self._blocks.shape:
            raise CheckpointError("what was learned in the checkpoint is of another picture; start a new run")
        self._blocks, self._levels = blocks, np.asarray(state["levels"], np.float64)
        self.drop()


class LearnedEmission(Learned):
    """A guide of emission and its training.

    Parameters
    ----------
    lights: the scene's lights.
    size: see :class:`Learned`.
    directions: whether directions are learned, too.
    """

    def __init__(self, lights: LightTable, size: tuple[int, int], directions: bool) -> None:
        self._directions = directions
        self.guide = EmissionGuide(lights)
        self._sums = EmissionSums.zero(self.guide.count, self.guide.places)
        super().__init__(size)

    def fields(self, recording: bool, first: int) -> dict[str, Any]:
        """The fields of the walkers of a group of light paths, from number ``first`` on. Fields that no later pass
        uses are None, since they would take time."""
        if first == 0:
            self.drop()  # what a pass has added that is repeated
        training = None
        if self.trains:
            unit = self.unit if recording else 0.0
            training = EmissionTraining(self.guide, unit, self._levels, self._width, self._directions)
        departures = self.guide.departures if self.guide.departs else None
        return {"lights": self.guide.lights, "departures": departures, "training": training}

    def drop(self) -> None:
        """See :class:`Learned`."""
        self._own = EmissionSums.zero(self.guide.count, self.guide.places)

    def add(self, training: EmissionTraining | None) -> None:
        """Add the contributions of a group of light paths."""
        if training is not None and training.learns:
            self._own = self._own + training.sums()

    def _keep(self) -> None:
        self._sums = self._sums + self._own

    def _learn(self) -> None:
        self.guide.learn(self._sums)
        if self._generation >= _UNTIL and self.guide.count == 1 and not self.guide.departs:
            self._generation = GENERATIONS  # one light, and its directions gain nothing: more training only takes time
        self._sums = EmissionSums.zero(self.guide.count, self.guide.places)

    def state(self) -> dict[str, Any]:
        """See :class:`Learned`."""
        return super().state() | {"guide": self.guide.state(), "sums": asdict(self._sums)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See :class:`Learned`."""
        self.guide.restore(state["guide"])
        sums = EmissionSums(**{name: np.asarray(array, np.float64) for name, array in state["sums"].items()})
        if sums.credit.size != self.guide.places:
            raise CheckpointError("the guide of emission in the checkpoint is damaged; start a new run")
        self._sums = sums
        super().restore(state)


class LearnedConnections(Learned):
    """A guide of connections and its training, whose sums include all generations.

    Parameters
    ----------
    lower, upper: see :class:`ConnectionGuide`.
    size: see :class:`Learned`.
    """

    def __init__(self, lower: Sequence[float] | Array, upper: Sequence[float] | Array, size: tuple[int, int]) -> None:
        self.guide = ConnectionGuide(lower, upper)
        self._sums = ConnectionSums.zero()
        super().__init__(size)

    def training(self, recording: bool, first: int) -> ConnectionTraining:
        """Training by a group of light paths, from number ``first`` on, and their camera paths. If nothing is learned,
        the same kernel adds nothing: compiling another kernel would take longer than it saves."""
        if first == 0:
            self.drop()  # what a pass has added that is repeated
        return ConnectionTraining(self.unit if recording and self.trains else 0.0, self._levels, self._width)

    def drop(self) -> None:
        """See :class:`Learned`."""
        self._own = ConnectionSums.zero()

    def add(self, training: ConnectionTraining, vertices: mi.UInt32) -> None:
        """Add the connections of a group of camera paths. ``vertices``: (classes,) light vertices of each class."""
        if training.learns:
            self._own = self._own + training.sums(vertices)

    def _keep(self) -> None:
        self._sums = self._sums + self._own

    def _learn(self) -> None:
        self.guide.learn(self._sums)

    def state(self) -> dict[str, Any]:
        """See :class:`Learned`."""
        return super().state() | {"guide": self.guide.state(), "sums": asdict(self._sums)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See :class:`Learned`."""
        self.guide.restore(state["guide"])
        sums = ConnectionSums(**{name: np.asarray(array, np.float64) for name, array in state["sums"].items()})
        if sums.vertices.size != CLASSES or sums.square.size != CLASSES**2:
            raise CheckpointError("the guide of connections in the checkpoint is damaged; start a new run")
        self._sums = sums
        super().restore(state)


def _block_means(image: NDArray[np.float32]) -> Array:
    """Mean luminance of blocks of pixels; of light at four wavelengths, their mean."""
    channels = image.shape[2]
    weights = np.array([0.2126, 0.7152, 0.0722]) if channels == 3 else np.full(channels, 1.0 / channels)
    luminance = image.astype(np.float64) @ weights
    height, width = luminance.shape
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    sums = np.add.reduceat(np.add.reduceat(luminance, rows, axis=0), columns, axis=1)
    sizes = np.outer(np.diff(np.append(rows, height)), np.diff(np.append(columns, width)))
    means: Array = sums / sizes
    return means


def learned_emission(setting: str, lights: LightTable, size: tuple[int, int]) -> LearnedEmission | None:
    """Learned emission for a value of the setting ``guide_emission``; None if nothing is learned."""
    if setting == "off" or (setting == "auto" and lights.count < MANY):
        return None
    return LearnedEmission(lights, size, setting == "on")
