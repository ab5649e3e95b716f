"""From the layers of a picture to the picture that is shown: the sum of its components, which may be denoised."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from etendue.core import logger
from etendue.film import without_fireflies

from .denoising import RADIUS, Picture, component_names, find_features, parse_filters, restored
from .denoising.choosing import by_component
from .denoising.pictures import colours, find_variance

#: Distance in pixels to which samples are assumed to spread, for fireflies. Of those that spread further, some remain.
_REACH = 1


def develop(
    layers: Mapping[str, Picture],
    denoise: str | Mapping[str, str] | None = None,
    *,
    components: Sequence[str] = (),
    albedo: str | None = None,
    normal: str | None = None,
    radius: int = RADIUS,
    strength: float = 1.0,
    tell: Callable[[str], object] = logger.info,
) -> Picture:
    """The picture (height, width, 3), linear, of ``layers`` (height, width, channels) of a result or a file.

    It is the sum of ``components``, by default the layers whose sum is the picture, or the picture. ``denoise`` names
    their filters, see :func:`parse_filters`: one of :data:`DENOISERS` for all, or one for each. Features are the layers
    ``albedo`` and ``normal``, those of what is seen in mirrors if they exist, or the layers named. ``radius`` is the
    radius of the windows in pixels, ``strength`` (1) how much is smoothed, both for filters without their own. ``tell``
    receives a line if features are missing that would help. Nothing in ``layers`` is changed.

    If the variance is known, fireflies are removed before all filters but ``oidn``.

    Raises :class:`OptionError` for an unknown name, a layer that is missing and values out of range, and
    :class:`BackendError` if the library of a denoiser is missing.
    """
    chosen = parse_filters(denoise, radius, strength)
    if not chosen and not components:
        components = ("image",)  # the sum of the components is the same up to rounding
    wanted = by_component(chosen, component_names(layers, components))
    parts = {name: colours(layers[name]) for name in wanted}
    kinds = {kind.name: kind for one in wanted.values() if (kind := one.kind) is not None}
    if not kinds:
        return _sum(parts.values())
    features = find_features(layers, albedo, normal)
    for kind in kinds.values():
        missing = [name for name in kind.uses if name not in features.names]
        if missing:
            tell(f"no layer {', '.join(missing)}: {kind.name} works better on a picture rendered with --for-denoising")
    variances = {name: find_variance(layers, name) for name in parts}
    whole = features.variance if tuple(components) in ((), ("image",)) else None  # of the sum, if it is the picture
    total = _sum(parts.values())
    alike = len(set(wanted.values())) == 1 and whole is not None
    if alike and any(v is None and "variance" in kind.needs for v in variances.values() for kind in kinds.values()):
        parts, wanted, variances = {"image": total}, {"image": wanted.popitem()[1]}, {"image": whole}
    calm = parts if whole is None else without_fireflies(parts, whole.astype(np.float64), _REACH)
    guides = {kind.name: features if kind.prepare is None else kind.prepare(features) for kind in kinds.values()}
    clean = []
    for name, one in wanted.items():
        if one.kind is None:
            left = name not in chosen and chosen.get("", one) != one  # by the filter of all others
            clean.append(calm[name] if left else parts[name])
            continue
        known = replace(guides[one.name], variance=variances[name])
        one.kind.check(known, name)
        part = calm[name] if one.kind.spreads_fireflies else parts[name]
        if part.any():
            part = one.kind.function(part, known, one.radius, one.strength)
        if one.kind.restores and not alike and known.variance is not None:
            part = restored(part, parts[name], known.variance)
        clean.append(part)
    if alike and whole is not None and any(kind.restores for kind in kinds.values()):
        return restored(_sum(clean), total, whole)
    return _sum(clean)


def _sum(parts: Iterable[Picture]) -> Picture:
    return np.asarray(np.sum(list(parts), axis=0, dtype=np.float32))
