"""Progress of a run, as the engine reports it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """State of a run after its latest pass. Unknown quantities are ``None``."""

    #: Passes in the picture, including those of an earlier run that was resumed.
    passes: int = 0
    #: Camera paths per pixel in the picture; for other work the number of bundles, lines or light paths, see ``made``.
    samples: int = 0
    #: Seconds of this run since the scene was loaded.
    elapsed: float = 0.0
    #: Predicted seconds until the budget is spent.
    eta: float | None = None
    #: Rays traced for the picture; for radiosity, segments of lines.
    rays: float = 0.0
    #: Rays traced per second in the latest passes.
    rays_per_second: float | None = None
    #: Estimated relative standard error, the root of :meth:`Method.noise`; needs two passes.
    error: float | None = None
    #: Share of the budget that is spent, 0 to 1.
    fraction: float | None = None
    #: Passes of each worker of a cluster in this run, by name.
    shares: dict[str, int] = field(default_factory=dict)
    #: For work that makes no picture, the amount done in words, such as ``24 bundles``; otherwise empty.
    made: str = ""
    #: Unit of ``rays``: ``rays`` or ``segments``.
    traced: str = "rays"

    def __str__(self) -> str:
        return ", ".join([self.made or f"pass {self.passes}, {self.samples} spp", *self.pace])

    @property
    def pace(self) -> list[str]:
        """Time, speed and error as texts, as far as they are known."""
        parts = [format_seconds(self.elapsed)]
        if self.eta is not None:
            parts.append(f"ETA {format_seconds(self.eta)}")
        if self.rays_per_second:
            parts.append(format_rate(self.rays_per_second, self.traced))
        if self.error is not None:
            parts.append(f"error {format_number(self.error)}")
        if self.shares:
            parts.append(format_shares(self.shares))
        return parts


def format_seconds(seconds: float) -> str:
    """``7.3s``, ``2:05``, ``1:02:05``."""
    if seconds < 59.95:
        return f"{seconds:.1f}s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def format_number(value: float, digits: int = 3) -> str:
    """At least ``digits`` significant digits, in exponent form only below 1e-5 and from 1e7 on: 0.00123, 45.6, 1234."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    if abs(value) < 1e-5 or abs(value) >= 1e7:
        return f"{value:.{digits - 1}e}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{round(value, decimals):.{decimals}f}"


def format_rate(rays_per_second: float, traced: str = "rays") -> str:
    """``12.3 Mrays/s``; ``traced``: the unit that is counted."""
    for scale, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rays_per_second >= scale:
            return f"{rays_per_second / scale:.3g} {prefix}{traced}/s"
    return f"{rays_per_second:.3g} {traced}/s"


def format_count(count: int, one: str) -> str:
    """``1 bundle``, ``24 bundles``, ``2 passes``."""
    return f"{count} {one}{'' if count == 1 else 'es' if one.endswith('s') else 's'}"


def format_shares(passes: Mapping[str, int]) -> str:
    """``2 workers (51, 49 %)``; of many workers the least and the largest share."""
    total = max(sum(passes.values()), 1)
    shares = sorted((100 * count / total for count in passes.values()), reverse=True)
    texts = [f"{share:.0f}" for share in shares]
    listed = ", ".join(texts) if len(texts) <= 4 else f"{texts[-1]} to {texts[0]}"
    return f"{len(texts)} worker{'' if len(texts) == 1 else 's'} ({listed} %)"
