"""The error over time of a run, noted while it renders."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from etendue import film
from etendue.products import Update

Image = NDArray[np.float32]

#: Ratio of the times of consecutive points.
_RATIO = 1.25
#: Size in bytes from which on a picture is compared at once. Smaller ones are kept and compared after the run.
_LARGE = 8 << 20


class History:
    """Errors against a reference at times that grow by a ratio and at the end; without a reference the estimated ones.

    :meth:`record` is a callback of the run.
    """

    def __init__(self, reference: Image | None) -> None:
        self._reference = reference
        self._points: list[tuple[float, float | Image]] = []
        self._last: tuple[float, float | None] = (0.0, None)

    @property
    def error_name(self) -> str:
        """What the errors are, for a page."""
        return "relMSE" if self._reference is not None else "estimated error"

    def record(self, update: Update) -> None:
        """Note the error after a pass, if it is time."""
        elapsed, error = update.progress.elapsed, update.progress.error
        self._last = elapsed, error
        if self._points and elapsed < self._points[-1][0] * _RATIO:
            return
        if self._reference is not None:
            image = update.image
            large = image.nbytes > _LARGE
            self._points.append((elapsed, film.relative_mse(image, self._reference) if large else image))
        elif error is not None:
            self._points.append((elapsed, error))

    def errors(
        self, final: Image, earlier: Sequence[tuple[float, float]] = (), begun: float = 0.0
    ) -> list[tuple[float, float]]:
        """Rows (seconds, error), with that of the ``final`` picture last. ``begun``: seconds of the run before it was
        resumed, ``earlier``: rows from then."""
        rows = [*earlier]
        for elapsed, point in self._points:
            if isinstance(point, np.ndarray):
                assert self._reference is not None
                point = film.relative_mse(point, self._reference)
            rows.append((begun + elapsed, point))
        elapsed, error = self._last
        last = error if self._reference is None else film.relative_mse(final, self._reference)
        if last is not None and elapsed > 0.0:
            rows = [row for row in rows if row[0] < begun + elapsed]
            rows.append((begun + elapsed, last))
        return rows
