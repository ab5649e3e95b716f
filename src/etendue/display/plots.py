"""Convergence plots as inline SVG: log-log, legible on light and dark pages, without colour, and by screen readers.

A pointer on a data point shows its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from .scales import logarithmic_ticks, tick_text

#: Distinct for most kinds of colour blindness (Okabe and Ito); a page may redefine them as ``--series-1`` and so on.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#7a6a00", "#56b4e9")
_DASHES = ("", "7 3", "2 3", "9 3 2 3", "4 2", "1 2")


@dataclass(frozen=True)
class Series:
    """A named curve; points are (x, y), both positive, or (x, y, standard error of y), which gets a bar. Other
    points are left out of the plot."""

    name: str
    points: Sequence[tuple[float, ...]]

    def drawable(self) -> list[tuple[float, float, float]]:
        """The points that a logarithmic plot can show, with 0 for an error that is not known."""
        rows = [(*point, 0.0)[:3] for point in self.points]
        return [
            (x, y, error if math.isfinite(error) else 0.0)
            for x, y, error in rows
            if x > 0.0 and y > 0.0 and math.isfinite(x) and math.isfinite(y)
        ]


@dataclass(frozen=True)
class _LogAxis:
    low: float
    high: float
    start: float  # pixel of low
    end: float  # pixel of high

    def __call__(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.start + share * (self.end - self.start)


def convergence_plot(
    series: Sequence[Series],
    *,
    width: int = 720,
    height: int = 400,
    x_label: str = "seconds",
    y_label: str = "relMSE",
    title: str = "Error over time",
    rate: float = 1.0,
) -> str:
    """Error over time, both logarithmic, as one ``<svg>`` element; an empty string if no series has a point.

    Text takes the colour of its surroundings (``currentColor``), so the plot fits a light and a dark page. A thin line
    shows how the error of an unbiased estimator falls, as 1/t^``rate``: 1 for squared errors, 0.5 for their root; 0 for
    no line.
    """
    curves = [(index, s.name, points) for index, s in enumerate(series) if (points := s.drawable())]
    if not curves:
        return ""
    left, right, bottom = 68.0, 14.0, 44.0
    unit = "s" if x_label == "seconds" else x_label
    legend, top = _legend([(index, name) for index, name, _ in curves], left, width - right)
    x_axis = _axis([x for _, _, points in curves for x, _, _ in points], left, width - right)
    y_axis = _axis([end for _, _, points in curves for _, y, e in points for end in _bar(y, e)], height - bottom, top)
    parts = _frame(x_axis, y_axis, x_label, y_label)
    parts += _slope_guide(x_axis, y_axis, curves[0][2], rate)
    for index, name, points in curves:
        parts.append(_curve(index, name, points, x_axis, y_axis, (x_label, y_label)))
    parts += legend
    ends = "; ".join(f"{name}: {points[-1][1]:.3g} after {points[-1][0]:.3g} {unit}" for _, name, points in curves)
    return (
        f'<svg class="plot" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(f"{title}. {ends}.")}" '
        f'font-family="inherit" font-size="13" fill="currentColor">{"".join(parts)}</svg>'
    )


def _axis(values: list[float], start: float, end: float) -> _LogAxis:
    low, high = min(values), max(values)
    margin = max((high / low) ** 0.06, 1.25)
    return _LogAxis(low / margin, high * margin, start, end)


def _frame(x_axis: _LogAxis, y_axis: _LogAxis, x_label: str, y_label: str) -> list[str]:
    x0, x1, y0, y1 = x_axis.start, x_axis.end, y_axis.start, y_axis.end
    parts = []
    for value, labelled in logarithmic_ticks(x_axis.low, x_axis.high):
        x = x_axis(value)
        parts.append(_line(x, y0, x, y1, 0.14 if labelled else 0.06))
        if labelled:
            parts.append(_text(x, y0 + 18, _number(value), "middle"))
    for value, labelled in logarithmic_ticks(y_axis.low, y_axis.high):
        y = y_axis(value)
        parts.append(_line(x0, y, x1, y, 0.14 if labelled else 0.06))
        if labelled:
            parts.append(_text(x0 - 8, y + 4, _number(value), "end"))
    parts.append(_line(x0, y0, x1, y0, 0.6) + _line(x0, y0, x0, y1, 0.6))
    parts.append(_text((x0 + x1) / 2, y0 + 37, x_label, "middle"))
    middle = (y0 + y1) / 2
    parts.append(f'<g transform="rotate(-90 14 {middle:.1f})">{_text(14, middle + 4, y_label, "middle")}</g>')
    return parts


def _slope_guide(x_axis: _LogAxis, y_axis: _LogAxis, points: Sequence[tuple[float, ...]], rate: float) -> list[str]:
    """A line of slope -``rate`` through the lower left of the frame, clipped to it."""
    if len(points) < 2 or not rate:
        return []
    product = y_axis.low * x_axis.low**rate * (y_axis.high / y_axis.low) ** 0.42
    x_low = max(x_axis.low, (product / y_axis.high) ** (1.0 / rate))
    x_high = min(x_axis.high, (product / y_axis.low) ** (1.0 / rate))
    if not x_low < x_high:
        return []
    x0, y0, x1, y1 = x_axis(x_low), y_axis(product / x_low**rate), x_axis(x_high), y_axis(product / x_high**rate)
    name = {1.0: "1/t", 0.5: "1/√t"}.get(rate, f"t^-{rate:g}")
    return [
        f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="currentColor" stroke-opacity=".45" '
        'stroke-dasharray="1 4" stroke-linecap="round" fill="none"/>',
        f'<g fill-opacity=".65" font-size="12">{_text(x0 + 7, y0 + 16, f"slope of {name}", "start")}</g>',
    ]


def _curve(
    index: int,
    name: str,
    points: Sequence[tuple[float, float, float]],
    x_axis: _LogAxis,
    y_axis: _LogAxis,
    labels: tuple[str, str],
) -> str:
    """The line, the bars of the errors, and a dot for each point with its numbers as a tip."""
    places = [(x_axis(x), y_axis(y)) for x, y, _ in points]
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
    bars = "".join(
        f"M{px:.1f} {y_axis(high):.1f}V{y_axis(low):.1f}"
        for (px, _), (_, y, e) in zip(places, points, strict=True)
        if e > 0.0
        for low, high in (_bar(y, e),)
    )
    dots = "".join(
        f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3.2"><title>{escape(_tip(name, point, labels))}</title></circle>'
        for (px, py), point in zip(places, points, strict=True)
    )
    return (
        f'<g style="stroke:{_colour(index)};fill:{_colour(index)}"><title>{escape(name)}</title>'
        f'<path d="{path}" fill="none" stroke-width="2"{_dash(index)}/>'
        f'{f"""<path d="{bars}" stroke-width="1.5" stroke-opacity=".7"/>""" if bars else ""}'
        f'<g stroke="none">{dots}</g></g>'
    )


def _bar(y: float, error: float) -> tuple[float, float]:
    """Ends of the bar of a standard error; at most down to a tenth of the value, for the logarithmic axis."""
    return max(y - error, 0.1 * y), y + error


def _tip(name: str, point: tuple[float, float, float], labels: tuple[str, str]) -> str:
    x, y, error = point
    spread = f" ± {error:.2g}" if error > 0.0 else ""
    return f"{name}: {labels[1]} {y:.3g}{spread} at {x:.3g} {labels[0]}"


def _legend(entries: list[tuple[int, str]], left: float, right: float) -> tuple[list[str], float]:
    """Samples of the lines with their names, in rows above the frame, and the y coordinate where the frame begins."""
    parts = []
    x, y = left, 14.0
    for index, name in entries:
        extent = 38.0 + 7.5 * len(name)  # text is not measured, only estimated
        if x > left and x + extent > right:
            x, y = left, y + 20.0
        sample = f"M{x:.0f} {y:.0f}h28"
        parts.append(f'<path d="{sample}" style="stroke:{_colour(index)}" stroke-width="2.5"{_dash(index)}/>')
        parts.append(_text(x + 34.0, y + 4.0, name, "start"))
        x += extent + 22.0
    return parts, y + 18.0


def _colour(index: int) -> str:
    slot = index % len(_COLOURS)
    return f"var(--series-{slot + 1}, {_COLOURS[slot]})"


def _dash(index: int) -> str:
    dash = _DASHES[index % len(_DASHES)]
    return f' stroke-dasharray="{dash}"' if dash else ""


def _line(x0: float, y0: float, x1: float, y1: float, opacity: float) -> str:
    d = f"M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"
    return f'<path d="{d}" stroke="currentColor" stroke-opacity="{opacity}"/>'


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _number(value: float) -> str:
    """As :func:`tick_text`, with superscript digits."""
    lead, power, exponent = tick_text(value).partition("^")
    return lead + exponent.translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")) if power else lead
