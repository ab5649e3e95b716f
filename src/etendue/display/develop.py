"""From the layers of a picture to the picture that is shown: the sum of its components, which may be denoised."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from etendue.core import OptionError, is_whole, logger

from .denoising import Picture, component_names, denoiser, find_features, restored
from .denoising.pictures import colours

#: Radius of the windows of the filters, in pixels.
RADIUS = 5


def check_filter(radius: int, strength: float) -> None:
    """Raise :class:`OptionError` for a radius or a strength that :func:`develop` does not take."""
    if not is_whole(radius) or not 1 <= radius <= 64:
        raise OptionError(f"the radius of a filter is a whole number from 1 to 64 pixels, not {radius!r}")
    if not 0.0 < strength <= 100.0:
        raise OptionError(f"the strength of a denoiser is above 0 and at most 100, not {strength:g}")


def develop(
    layers: Mapping[str, Picture],
    denoise: str | None = None,
    *,
    components: Sequence[str] = (),
    albedo: str | None = None,
    normal: str | None = None,
    radius: int = RADIUS,
    strength: float = 1.0,
    tell: Callable[[str], object] = logger.info,
) -> Picture:
    """The picture (height, width, 3), linear, of ``layers`` (height, width, channels) of a result or a file.

    With ``denoise``, a name of :data:`DENOISERS`, each of the ``components`` (by default the layers whose sum is the
    picture, or the picture) is denoised and their sum is returned. Features are the layers ``albedo`` and ``normal``,
    or the layers named. ``radius`` is the radius of the windows in pixels, ``strength`` (1) how much is smoothed.
    ``tell`` receives a line if features are missing that would help. Nothing in ``layers`` is changed.

    Raises :class:`OptionError` for an unknown name, a layer that is missing and values out of range, and
    :class:`BackendError` if the library of a denoiser is missing.
    """
    check_filter(radius, strength)
    kind = None if denoise is None else denoiser(denoise)
    if kind is None and not components:
        components = ("image",)  # the sum of the components is the same up to rounding
    parts = [colours(layers[name]) for name in component_names(layers, components)]
    if kind is not None:
        features = find_features(layers, albedo, normal)
        kind.check(features)
        missing = [name for name in kind.uses if name not in features.names]
        if missing:
            tell(f"no layer {', '.join(missing)}: {kind.name} works better with --aovs in several passes")
        if not kind.by_component:
            parts = [np.sum(parts, axis=0, dtype=np.float32)]
        features = features if kind.prepare is None else kind.prepare(features)
        raw = _sum(parts)
        parts = [kind.function(part, features, radius, strength) for part in parts]
        if kind.restores and features.variance is not None and tuple(components) in ((), ("image",)):
            return restored(_sum(parts), raw, features.variance)
    return _sum(parts)


def _sum(parts: Sequence[Picture]) -> Picture:
    return np.asarray(np.sum(parts, axis=0, dtype=np.float32))
