"""Plots of experiments, as SVG files that stand by themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from etendue.display import Series, convergence_plot

from .measuring import console
from .racing import Point


def save(
    path: Path,
    curves: Mapping[str, Sequence[tuple[float, float]]],
    title: str,
    x_label: str = "seconds",
    y_label: str = "RMS of luminance",
    rate: float = 0.5,
) -> None:
    """Errors over seconds or whatever else they fall with, both logarithmic, to ``path``; a thin line falls as that to
    the power of ``-rate``."""
    series = [Series(name, points) for name, points in curves.items()]
    svg = convergence_plot(series, x_label=x_label, y_label=y_label, title=title, rate=rate)
    if not svg:
        return
    alone = '<svg xmlns="http://www.w3.org/2000/svg" style="background:#fff;color:#222;font-family:sans-serif" '
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(svg.replace("<svg ", alone, 1), encoding="utf-8")
    console.print(f"plot: {path}", style="dim")


def over_time(points: Sequence[Point]) -> list[tuple[float, float]]:
    """The points of an entrant as (seconds, RMS), one for each pass."""
    return list(dict.fromkeys((p.seconds, p.rms) for p in points))


def over_samples(points: Sequence[Point]) -> list[tuple[float, float]]:
    """The same as (samples a pixel, RMS)."""
    return list(dict.fromkeys((p.samples, p.rms) for p in points))
