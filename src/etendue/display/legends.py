"""False-colour pictures with a legend and lines of equal values."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from etendue.core import OptionError
from etendue.lighting import photometric

from .colours import false_colour
from .isolines import isolines
from .scales import linear_ticks, logarithmic_ticks, round_down, round_step, round_up, tick_text

Bytes = NDArray[np.uint8]
Array = NDArray[np.float64]

#: Ratio of the ends from which a scale is logarithmic, and the largest one that is chosen automatically.
_LOGARITHMIC, _WIDEST = 100.0, 1e4
#: Height and width in pixels to which small pictures are enlarged, and the least height of a legend.
_HEIGHT, _WIDTH, _LEGEND = 400, 800, 160
#: Lines are drawn larger by this factor, and averaged.
_FINE = 3
#: Luma of a colour from which it has black lines and letters, otherwise white ones.
_BRIGHT = 120.0
#: Labels of a line's level, and places along a line where a label may be.
_LABELS, _PLACES = 2, (0.5, 0.3, 0.7, 0.4, 0.6, 0.2, 0.8)
#: Exponents in texts, and their size.
_EXPONENT, _RAISED = re.compile(r"\^(-?\d+)"), 0.65


@dataclass(frozen=True)
class _Scale:
    low: float
    high: float
    logarithmic: bool

    def colours(self, values: Array) -> Bytes:
        return false_colour(values, self.low, self.high, logarithmic=self.logarithmic)

    def share(self, value: float) -> float:
        """Where a value is on the scale, from 0 to 1."""
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        if not self.logarithmic:
            return linear_ticks(self.low, self.high)
        return [value for value, labelled in logarithmic_ticks(self.low, self.high) if labelled]

    def ink(self, value: float) -> tuple[int, int, int]:
        """Black or white, which is legible on the colour of a value."""
        (colour,) = self.colours(np.array([[value]]))[0].astype(float)
        return (0, 0, 0) if colour @ (0.299, 0.587, 0.114) > _BRIGHT else (255, 255, 255)


def luminance_picture(image: ArrayLike, **options: Any) -> Bytes:
    """The luminance of a picture, (height, width, 3) linear RGB radiance, in cd/m^2 as a false-colour picture.

    ``options`` and errors are those of :func:`false_colour_picture`.
    """
    return false_colour_picture(photometric(image), "cd/m^2", **options)


def false_colour_picture(
    values: ArrayLike,
    unit: str,
    low: float | None = None,
    high: float | None = None,
    *,
    logarithmic: bool | None = None,
    lines: bool | Sequence[float] = False,
    pixel: tuple[float, float] = (1.0, 1.0),
) -> Bytes:
    """``values``, (height, width), of a quantity that is not negative, as colours with a legend on their right: sRGB
    bytes (h, w, 3), with the values in the upper left corner.

    unit: printed above the legend; ``m^2`` with a raised exponent.
    low, high: the ends of the scale, at which values outside are clipped. By default round numbers that contain the
        values, but for the brightest thousandth, and on a logarithmic scale the darkest twentieth.
    logarithmic: by default, if the ends have a ratio of 100 or more.
    lines: draw lines of equal values: at the numbers of the legend, or at these levels.
    pixel: width and height of the area of a value; only their ratio counts. Pictures below 400 pixels in height
        are enlarged, each value to a rectangle.

    NaN is turquoise. Raises :class:`OptionError` for another shape, a scale that does not rise, and a logarithmic one
    that does not begin above 0.
    """
    v = np.asarray(values, dtype=np.float64)
    if v.ndim != 2 or not v.size:
        raise OptionError(f"false colours show values (height, width), not an array of shape {v.shape}")
    scale = _scale(v, low, high, logarithmic)
    across, down = _cell(v.shape, pixel)
    shown = Image.fromarray(scale.colours(v).repeat(down, axis=0).repeat(across, axis=1))
    size = int(np.clip(shown.height / 40, 12, 32))
    levels = [] if lines is False else scale.ticks() if lines is True else sorted(map(float, lines))
    levels = [level for level in levels if scale.low < level < scale.high]
    drawn = {level: [(line + 0.5) * (across, down) for line in _lines(v, level)] for level in levels}
    for level, found in drawn.items():
        _draw_lines(shown, found, scale.ink(level), max(1.5, size / 10))
    _draw_labels(shown, drawn, scale, size)
    return _with_legend(shown, scale, unit, size, [level for level, found in drawn.items() if found])


def check_range(low: float | None = None, high: float | None = None, logarithmic: bool | None = None) -> None:
    """Raise :class:`OptionError` for ends of a scale that :func:`false_colour_picture` does not take."""
    for end in (low, high):
        if end is not None and not math.isfinite(end):
            raise OptionError(f"the ends of a scale are numbers, not {end}")
    if low is not None and high is not None and not low < high:
        raise OptionError(f"a scale rises from its low to its high end, not from {low:g} to {high:g}")
    if logarithmic and low is not None and not low > 0.0:
        raise OptionError(f"a logarithmic scale begins above 0, not at {low:g}")
    if high is not None and not high > 0.0:
        raise OptionError(f"a scale ends above 0, not at {high:g}")


def _scale(v: Array, low: float | None, high: float | None, logarithmic: bool | None) -> _Scale:
    """The scale of values, where ``None`` is chosen."""
    check_range(low, high, logarithmic)
    known = v[np.isfinite(v)]
    positive = known[known > 0.0]
    top = float(np.percentile(known, 99.9, method="higher")) if positive.size else 1.0
    top = high if high is not None else top if top > 0.0 else float(positive.max(initial=0.0)) or 1.0
    dark = float(np.percentile(positive, 5.0, method="lower")) if positive.size else top
    if low is not None and low >= top:
        top = 2.0 * low  # nothing is as bright as the given low end
    if logarithmic is None:
        first = low if low is not None else dark
        logarithmic = first > 0.0 and top >= _LOGARITHMIC * first
    if logarithmic:
        last = high if high is not None else round_up(top)
        first = low if low is not None else round_down(float(np.clip(dark, last / _WIDEST, last / 2.0)))
        return _Scale(first, last, True)
    # From 0, unless that would take away more than half of the scale.
    least = float(known.min(initial=top))
    first = low if low is not None else 0.0 if least < 0.5 * top else least
    if low is None and first >= top:
        first = 0.0  # all are the same
    step = round_step(first, top)
    first = low if low is not None else max(0.0, math.floor(first / step + 1e-9) * step)
    last = high if high is not None else math.ceil(top / step - 1e-9) * step
    return _Scale(first, last, False)


def _cell(shape: tuple[int, ...], pixel: tuple[float, float]) -> tuple[int, int]:
    """Pixels across and down of a value."""
    (height, width), (x, y) = shape, (side / min(pixel) for side in pixel)
    factor = min(_HEIGHT / (height * y), _WIDTH / (width * x))
    return max(1, round(factor * x)), max(1, round(factor * y))


def _lines(v: Array, level: float) -> list[Array]:
    """Lines in units of columns and rows, as far as the border: there the values go on unchanged."""
    return [line - 1.0 for line in isolines(np.pad(np.clip(v, -1e30, 1e30), 1, mode="edge"), level)]


def _draw_lines(shown: Image.Image, lines: Sequence[Array], ink: tuple[int, int, int], width: float) -> None:
    mask = Image.new("L", (_FINE * shown.width, _FINE * shown.height))
    draw = ImageDraw.Draw(mask)
    for line in lines:
        draw.line([tuple(point) for point in (_FINE * line).tolist()], 255, round(_FINE * width), joint="curve")
    shown.paste(ink, mask=mask.reduce(_FINE))


def _draw_labels(shown: Image.Image, drawn: dict[float, list[Array]], scale: _Scale, size: int) -> None:
    """The values of lines, where there is room for them."""
    draw = ImageDraw.Draw(shown)
    taken: list[tuple[float, ...]] = []
    for level, lines in drawn.items():
        text, count = tick_text(level), 0
        width, height = _width(text, size) + 6, size + 4
        lengths = [_length(line) for line in lines]
        for k in np.argsort(lengths)[::-1]:
            if count == _LABELS or lengths[k] < 6 * width:
                break
            for x, y in (_along(lines[k], share) for share in _PLACES):
                box = x - width / 2, y - height / 2, x + width / 2, y + height / 2
                inside = box[0] >= 0 and box[1] >= 0 and box[2] <= shown.width and box[3] <= shown.height
                if inside and not any(_overlap(box, other) for other in taken):
                    taken.append(box)
                    draw.rectangle(box, tuple(scale.colours(np.array([[level]]))[0, 0].tolist()))
                    _write(draw, (box[0] + 3, y), text, size, scale.ink(level))
                    count += 1
                    break


def _length(line: Array) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _along(line: Array, share: float) -> Array:
    """The point at a share of the length of a line."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.array([np.interp(share * way[-1], way, line[:, k]) for k in (0, 1)])


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _with_legend(shown: Image.Image, scale: _Scale, unit: str, size: int, levels: Sequence[float]) -> Bytes:
    """The picture with a bar of the colours on its right, the numbers of its ticks, and marks at lines."""
    gap, bar, tick = size, round(1.5 * size), size // 3
    ticks = scale.ticks()
    text = max([*(tick + 4 + _width(tick_text(value), size) for value in ticks)] or [0])
    left = shown.width + gap
    height = max(shown.height, _LEGEND)
    whole = Image.new("RGB", (left + max(bar + text, _width(unit, size)) + gap, height), "white")
    whole.paste(shown)
    draw = ImageDraw.Draw(whole)
    _write(draw, (left, size), unit, size, (0, 0, 0))
    top, bottom = 2 * size + size // 2, height - size
    colours = false_colour(np.linspace(1.0, 0.0, bottom - top)[:, None], 0.0, 1.0, logarithmic=False)
    whole.paste(Image.fromarray(colours.repeat(bar, axis=1)), (left, top))

    def at(value: float) -> int:
        return round(bottom - 1 - scale.share(value) * (bottom - top - 1))

    for value in ticks:
        draw.line([(left + bar, at(value)), (left + bar + tick, at(value))], (0, 0, 0), max(1, size // 12))
        _write(draw, (left + bar + tick + 4, at(value)), tick_text(value), size, (0, 0, 0))
    for value in levels:
        draw.line([(left, at(value)), (left + bar - 1, at(value))], scale.ink(value), max(1, size // 12))
    return np.asarray(whole)


def _write(draw: ImageDraw.ImageDraw, place: tuple[float, float], text: str, size: int, ink: Any) -> None:
    """Write a text beginning at ``place``, its left middle; ``^2`` raised, since the font has no such digits."""
    x, y = place
    for part, is_raised in _parts(text):
        font = ImageFont.load_default(_RAISED * size if is_raised else size)
        draw.text((x, y - (0.35 * size if is_raised else 0.0)), part, ink, font, anchor="lm")
        x += font.getlength(part)


def _width(text: str, size: int) -> int:
    return math.ceil(
        sum(ImageFont.load_default(_RAISED * size if up else size).getlength(part) for part, up in _parts(text))
    )


def _parts(text: str) -> list[tuple[str, bool]]:
    """Pieces of a text, and whether they are exponents."""
    return [(part, bool(k % 2)) for k, part in enumerate(_EXPONENT.split(text)) if part]
