"""Emission that a method learns pass by pass: generations of training, and their state.

Training has generations of 1, 2, 4, ... passes. A pass emits by what earlier generations have learned, so that each is
unbiased given those before it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, CheckpointError
from etendue.scene import LightTable

from .emission import BLOCK, EmissionGuide, EmissionSums, EmissionTraining

#: Lights of a scene from which on ``auto`` learns their selection.
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


class LearnedEmission:
    """A guide, its training, and the brightness of the picture so far.

    Parameters
    ----------
    lights: the scene's lights.
    size: width and height of the picture, in pixels.
    directions: whether directions are learned, too.
    """

    def __init__(self, lights: LightTable, size: tuple[int, int], directions: bool) -> None:
        self._directions = directions
        self.guide = EmissionGuide(lights)
        #: Mean contribution to a pixel; 0 if it is unknown, and nothing is learned.
        self.unit = 0.0
        self._generation = self._passes = 0
        self._width, height = size
        self._blocks = np.zeros((-(-height // BLOCK), -(-self._width // BLOCK)))  # sums of luminance of all passes
        self._seen = 0.0  # samples in them
        self._levels = np.ones(self._blocks.size)
        self._sums = EmissionSums.zero(self.guide.count, self.guide.places)
        self.drop()

    def measure(self, brightness: float) -> None:
        """Set the mean contribution to a pixel, if it is unknown; in steps, so that the order of additions does not
        matter."""
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

    def fields(self, recording: bool, first: int) -> dict[str, Any]:
        """The fields of the walkers of a group of light paths, from number ``first`` on. What is not used is left out,
        because it takes time."""
        if first == 0:
            self.drop()  # what a pass has added that is repeated
        training = None
        if recording and self.trains and self.unit > 0.0:
            training = EmissionTraining(self.guide, self.unit, self._levels, self._width, self._directions)
        departures = self.guide.departures if self.guide.departs else None
        return {"lights": self.guide.lights, "departures": departures, "training": training}

    def drop(self) -> None:
        """Forget what the current pass has added."""
        self._own = EmissionSums.zero(self.guide.count, self.guide.places)

    def add(self, training: EmissionTraining | None) -> None:
        """Add the contributions of a group of light paths."""
        if training is not None:
            self._own = self._own + training.sums()

    def end_pass(self, image: NDArray[np.float32], samples: int) -> None:
        """Learn at the end of a generation. ``image``: sums of the pass."""
        if not self.trains:
            return
        if self.unit <= 0.0:
            self.measure(float(image.mean(dtype=np.float64)) / samples)
            self.drop()
            return
        self._sums = self._sums + self._own
        self._blocks = self._blocks + _block_means(image)
        self._seen += samples
        self._passes += 1
        if self._passes >= 1 << self._generation:
            self.guide.learn(self._sums)
            self._generation, self._passes = self._generation + 1, 0
            if self._generation >= _UNTIL and self.guide.count == 1 and not self.guide.departs:
                self._generation = GENERATIONS  # one light, whose directions are as good as any: training takes time
            self._sums = EmissionSums.zero(self.guide.count, self.guide.places)
            self._set_levels()
        self.drop()

    def _set_levels(self) -> None:
        levels = self._blocks.ravel() / max(self._seen, 1.0)
        if self.unit > 0.0 and levels.sum() > 0.0:
            # In steps, so that the order in which splats were added does not matter.
            relative = np.maximum(levels / self.unit, 2.0**-8)
            self._levels = 2.0 ** (np.round(4.0 * np.log2(relative)) / 4.0)

    def state(self) -> dict[str, Any]:
        """Guide and sums, as arrays that are not modified later."""
        return {
            "unit": self.unit,
            "generation": self._generation,
            "passes": self._passes,
            "guide": self.guide.state(),
            "sums": asdict(self._sums),
            "blocks": self._blocks,
            "seen": self._seen,
            "levels": self._levels,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Inverse of :meth:`state`. Raises :class:`CheckpointError` for a state that does not fit."""
        self.guide.restore(state["guide"])
        self.unit = float(state["unit"])
        self._generation, self._passes, self._seen = (
            int(state["generation"]),
            int(state["passes"]),
            float(state["seen"]),
        )
        sums = EmissionSums(**{name: np.asarray(array, np.float64) for name, array in state["sums"].items()})
        blocks = np.asarray(state["blocks"], np.float64)
        if sums.credit.size != self.guide.places or blocks.shape != self._blocks.shape:
            raise CheckpointError("the guide of emission in the checkpoint is damaged; start a new run")
        self._sums, self._blocks, self._levels = sums, blocks, np.asarray(state["levels"], np.float64)
        self.drop()


def _block_means(image: NDArray[np.float32]) -> Array:
    """Mean luminance of blocks of pixels."""
    luminance = image.astype(np.float64) @ np.array([0.2126, 0.7152, 0.0722])
    height, width = luminance.shape
    rows, columns = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    sums = np.add.reduceat(np.add.reduceat(luminance, rows, axis=0), columns, axis=1)
    sizes = np.outer(np.diff(np.append(rows, height)), np.diff(np.append(columns, width)))
    means: Array = sums / sizes
    return means


def learned_emission(setting: str, lights: LightTable, size: tuple[int, int]) -> LearnedEmission | None:
    """That of a method with a value of the setting ``guide_emission``; None if nothing is learned."""
    if setting == "off" or (setting == "auto" and lights.count < MANY):
        return None
    return LearnedEmission(lights, size, setting == "on")
