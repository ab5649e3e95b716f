r"""Re-weighting of fireflies: pixels whose mean over the passes is determined by few rare bright paths.

As in [Zirr 2018], light is trusted by how often light of its brightness is found, in the pixel and around it. There,
samples are sorted into images by brightness. Here, the samples are passes, and their first two moments, which every
measurement has, are enough: if one of N passes finds F more light in a pixel than the others, which agree, then the
standard error of the pixel's mean is exactly F / N, and the mean minus the standard error is the mean of the others.

Let m and s be a pixel's mean and standard error, root mean squares over the channels, and T the :data:`_RANK`-th
largest standard error in a frame of pixels around it, beyond the reach of the film's filter. The share

.. math:: g = \mathrm{ramp}(s / m) \, \max(0, 1 - 2 T / s)

of the standard error of each channel is removed, but no more than what the pixel has above the mean of the frame. The
ramp rises from 0 at s / m = 1/4 (16 equally bright finds) to 1 at 1/2 (4 finds). Removed from the mean, it is removed
from the standard error, too; :data:`_ROUNDS` rounds find the fireflies that brighter ones have hidden.

At most the standard error is removed, so the estimate is consistent. It is biased: light that has been found rarely is
too dark. Where the noise is as large as around it, nothing changes.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]

#: Relative standard errors at which the ramp begins and ends.
_TRUSTED, _DOUBTED = 0.25, 0.5
#: A pixel is trusted if so many pixels of the frame have at least its standard error divided by the factor.
_RANK, _FACTOR = 4, 2.0
#: Width of the frame in pixels.
_FRAME = 2
_ROUNDS = 3
#: Pixels of the frame that are compared before trusted pixels are dropped, and most pixels whose frames are in memory.
_FIRST, _AT_ONCE = 8, 1 << 16


def without_fireflies(parts: Mapping[str, Picture], variance: NDArray[np.float64], reach: int) -> dict[str, Picture]:
    """Layers without the fireflies of their sum.

    parts: layers (height, width, 3) whose sum is the picture. What is removed from a pixel is divided among them in
    proportion to what each has above its surroundings. variance: of the picture's pixels, (height, width, 3). reach:
    distance in pixels, along an axis, to which the film's filter spreads a sample. ``parts`` are not changed.
    """
    changed = {name: np.array(part, np.float32) for name, part in parts.items()}
    error = np.sqrt(variance).astype(np.float32)
    frame = _frame(reach)
    for _ in range(_ROUNDS):
        standard, whole = _norm(error), _norm(_sum(changed.values()))
        row, column, trusted = _doubtful(standard, whole, frame)
        if not len(row):
            break
        own = standard[row, column]
        relative = own / np.maximum(own, whole[row, column])
        share = np.clip((relative - _TRUSTED) / (_DOUBTED - _TRUSTED), 0.0, 1.0) * (1.0 - _FACTOR * trusted / own)
        _remove(changed, error, (row, column), share[:, None], frame)
    return changed


def _frame(reach: int) -> NDArray[np.int64]:
    """(row, column) of the pixels of the frame, relative to its middle. The first :data:`_FIRST`, of which their number
    is a multiple, are spread over the frame."""
    steps = np.arange(-reach - _FRAME, reach + _FRAME + 1)
    every = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    every = every[np.abs(every).max(axis=1) > reach]
    return every.reshape(_FIRST, -1, 2).swapaxes(0, 1).reshape(-1, 2)


def _doubtful(
    standard: Picture, whole: Picture, frame: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Picture]:
    """(rows and columns of the pixels that are not trusted, T of each)."""
    pad = int(frame.max())
    padded = np.pad(standard, pad)  # no noise beyond the border
    flat, width = padded.ravel(), padded.shape[1]
    steps = frame @ np.array([width, 1])
    row, column = np.nonzero(standard > _TRUSTED * whole)
    place = (row + pad) * width + column + pad
    for compared in (steps[:_FIRST], steps):
        some = np.array_split(place, 1 + len(place) // _AT_ONCE)
        rank = np.concatenate([np.partition(flat[p[:, None] + compared], -_RANK, axis=1)[:, -_RANK] for p in some])
        doubted = flat[place] > _FACTOR * rank
        place, rank = place[doubted], rank[doubted]
    row, column = np.divmod(place, width)
    return row - pad, column - pad, rank


def _remove(
    parts: dict[str, Picture],
    error: Picture,
    pixels: tuple[NDArray[np.int64], NDArray[np.int64]],
    share: Picture,
    frame: NDArray[np.int64],
) -> None:
    """Take ``share`` of ``error`` at ``pixels`` from ``parts`` and from ``error``."""
    sign = np.where(_sum(part[pixels] for part in parts.values()) < 0.0, -1.0, 1.0)  # below 0 by lobes of the filter
    excess = {name: np.maximum(sign * (part[pixels] - _mean(part, pixels, frame)), 0.0) for name, part in parts.items()}
    total = _sum(excess.values())
    removed = share * np.minimum(total, error[pixels])
    factor = sign * np.divide(removed, total, out=np.zeros_like(total), where=total > 0.0)
    for name, part in parts.items():
        part[pixels] -= factor * excess[name]
    error[pixels] -= removed


def _mean(part: Picture, pixels: tuple[NDArray[np.int64], NDArray[np.int64]], frame: NDArray[np.int64]) -> Picture:
    """Mean of a layer over the frames around ``pixels``, as far as they are in the picture; 0 where they are not."""
    pad, (row, column) = int(frame.max()), pixels
    ones = np.ones((*part.shape[:2], 1), np.float32)
    padded = np.pad(np.concatenate([part, ones], axis=2), ((pad, pad), (pad, pad), (0, 0)))
    total = np.zeros((len(row), padded.shape[2]), np.float32)
    for y, x in frame:
        total += padded[row + (pad + y), column + (pad + x)]
    return np.asarray(total[:, :-1] / np.maximum(total[:, -1:], 1.0), np.float32)


def _sum(pictures: Iterable[Picture]) -> Picture:
    return functools.reduce(np.add, pictures)


def _norm(colours: Picture) -> Picture:
    """Root mean square over the channels."""
    return np.asarray(np.sqrt(np.square(colours, dtype=np.float64).mean(axis=2)), np.float32)
