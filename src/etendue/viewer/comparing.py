"""A second picture beside the first, by a second method or a reference, and the error between both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue import film, methods
from etendue.core import Array, EtendueError, describe

from .refining import Refinement
from .shown import Show, error_map

if TYPE_CHECKING:
    from .states import Asked

Picture = NDArray[np.float32]

#: Settings that a second method takes from the first unless it has its own: settings that every method has.
_SHARED = {field.name for field in fields(methods.ImageSettings)} - {"samples_per_pass"}


@dataclass(eq=False)
class Comparison:
    """Either a ``method`` with settings, which takes turns with the main one so that both have the same time, or a
    ``reference`` picture."""

    method: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""  #: file of the reference
    reference: Picture | None = None
    map: bool = False  #: show the error instead of the picture
    refinement: Refinement | None = None
    _told: str = ""  # the latest line that ``tell`` got

    def state(self) -> dict[str, Any]:
        """Plain values for the page."""
        return {"method": self.method, "settings": dict(self.settings), "reference": self.name, "map": self.map}

    def restart(self) -> None:
        """Drop the second refinement, because the scene or the view has changed."""
        self.refinement = None

    def turn(self, main: Refinement, asked: Asked) -> Refinement | None:
        """The second refinement, if the next pass is its own. Raises its errors of settings and preparation."""
        if self.reference is not None:
            return None
        if self.refinement is None:
            if not main.passes:
                return None
            # Another seed: two methods that share paths would agree more than they should.
            settings = {k: v for k, v in asked.settings.items() if k in _SHARED} | dict(self.settings)
            self.refinement = Refinement(main.problem, self.method, settings, asked.budget, asked.seed + 1)
        if self.refinement.is_done or (self.refinement.seconds > main.seconds and not main.is_done):
            return None
        return self.refinement

    def layers(self) -> Mapping[str, Picture] | None:
        """Layers of the second picture, ``None`` before the first pass."""
        if self.reference is not None:
            return {"image": self.reference}
        result = self.refinement.result() if self.refinement is not None else None
        return None if result is None else result.layers

    def shown(
        self, show: Show, stops: float, image: Picture, tell: Callable[[str], object]
    ) -> tuple[NDArray[np.uint8], dict[str, Any]] | None:
        """(the second picture as shown, its progress), ``None`` before the first pass. ``image``: the first picture.
        If the second lacks a layer that a denoiser needs, ``tell`` gets a line, and it is shown without denoising."""
        layers = self.layers()
        if layers is None:
            return None
        squared = film.relative_squared_error(image, layers["image"])
        if self.map:
            return error_map(squared), self._progress(squared)
        try:
            return show.colours(layers, stops), self._progress(squared)
        except EtendueError as error:
            line = f"the second picture is not denoised: {describe(error)}"
            # Before the second pass there is no variance.
            if line != self._told and (self.refinement is None or self.refinement.passes > 1):
                self._told = line
                tell(line)
            return replace(show, denoise="").colours(layers, stops), self._progress(squared)

    def _progress(self, squared: Array) -> dict[str, Any]:
        """For the page: ``relmse``, the mean of the relative squared errors, and the progress of the second method."""
        finite = squared[np.isfinite(squared)]
        relmse = float(finite.mean()) if finite.size else None
        other = self.refinement.progress() if self.refinement is not None else None
        return {"relmse": relmse, "other": other}
