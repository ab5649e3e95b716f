"""How far a run has come: what the engine reports and the command line, a notebook or a viewer shows."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """State of a run after its latest pass. A quantity that is not known (yet) is ``None``."""

    #: Passes in the picture, those of an earlier run that was resumed included.
    passes: int = 0
    #: Camera paths per pixel in the picture.
    samples: int = 0
    #: Seconds of this run, from when the scene was loaded.
    elapsed: float = 0.0
    #: Predicted seconds until the budget is used up.
    eta: float | None = None
    #: Rays traced for the picture; of radiosity, segments of lines.
    rays: float = 0.0
    #: Rays traced per second in the latest passes.
    rays_per_second: float | None = None
    #: Estimated noise, see :meth:`Measurement.relative_error`; needs two passes.
    relative_error: float | None = None
    #: Share of the budget that is used, 0 to 1.
    fraction: float | None = None

    def __str__(self) -> str:
        return ", ".join([f"pass {self.passes}", f"{self.samples} spp", *self.pace])

    @property
    def pace(self) -> list[str]:
        """What is known of time, speed and noise, in words."""
        parts = [format_seconds(self.elapsed)]
        if self.eta is not None:
            parts.append(f"ETA {format_seconds(self.eta)}")
        if self.rays_per_second:
            parts.append(format_rate(self.rays_per_second))
        if self.relative_error is not None:
            parts.append(f"noise {self.relative_error:.2g}")
        return parts


def format_seconds(seconds: float) -> str:
    """``7.3s``, ``2:05``, ``1:02:05``."""
    if seconds < 59.95:
        return f"{seconds:.1f}s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def format_rate(rays_per_second: float) -> str:
    """``12.3 Mrays/s``."""
    for scale, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rays_per_second >= scale:
            return f"{rays_per_second / scale:.3g} {prefix}rays/s"
    return f"{rays_per_second:.3g} rays/s"
