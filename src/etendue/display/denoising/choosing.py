"""The filter of each component of a picture, as it is written: ``indirect=gaussian:radius=9,direct=none``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from etendue.core import OptionError, is_whole, suggest
from etendue.film import COMPONENTS

from .registry import DENOISERS, Denoiser

#: Radius of the windows of the filters, in pixels.
RADIUS: Final = 5
#: The name of no filter.
NONE: Final = "none"
_OPTIONS: Final[Mapping[str, type[Any]]] = {"radius": int, "strength": float}


@dataclass(frozen=True)
class Filter:
    """A denoiser by name, or "none", with its options. Raises :class:`OptionError` for an unknown name and for a value
    out of range."""

    name: str = NONE
    radius: int = RADIUS
    strength: float = 1.0

    def __post_init__(self) -> None:
        if self.name not in (NONE, *DENOISERS):
            raise OptionError(f"no denoiser '{self.name}'; {suggest(self.name, [*DENOISERS, NONE])}")
        if not is_whole(self.radius) or not 1 <= self.radius <= 64:
            raise OptionError(f"the radius of a filter is a whole number from 1 to 64 pixels, not {self.radius!r}")
        if not 0.0 < self.strength <= 100.0:
            raise OptionError(f"the strength of a denoiser is above 0 and at most 100, not {self.strength:g}")

    @property
    def kind(self) -> Denoiser | None:
        """The denoiser; ``None`` for "none"."""
        return DENOISERS.get(self.name)


def parse_filters(
    denoise: str | Mapping[str, str] | None, radius: int = RADIUS, strength: float = 1.0
) -> dict[str, Filter]:
    """Filters by component; "" stands for every other component, and is absent if those are not filtered.

    ``denoise`` is a denoiser, such as ``bilateral``, or one for each component, as
    ``indirect=gaussian:radius=9,direct=none`` or ``{"indirect": "gaussian:radius=9", "direct": "none"}``. One without a
    component, as in ``oidn,direct=none``, is that of all others. ``radius`` and ``strength`` are those of filters
    without their own.

    Raises :class:`OptionError` for anything else.
    """
    if isinstance(denoise, Mapping):
        words = [(component, str(word)) for component, word in denoise.items()]
    else:
        split = (word.partition(":") for word in denoise.split(",")) if denoise is not None else ()
        named = ((head.rpartition("="), colon + options) for head, colon, options in split)
        words = [(component.strip(), name + options) for (component, _, name), options in named]
    found: dict[str, Filter] = {}
    for component, word in words:
        if component in found:
            what = f"'{component}'" if component else "all other components"
            raise OptionError(f"'{denoise}' gives {what} two filters; give one")
        found[component] = _filter(word, radius, strength)
    if not found:
        Filter(radius=radius, strength=strength)  # checks them
    return found


def _filter(word: str, radius: int, strength: float) -> Filter:
    """From ``gaussian:radius=9:strength=2``."""
    name, *options = (part.strip() for part in word.split(":"))
    values: dict[str, Any] = {"radius": radius, "strength": strength}
    for option in options:
        key, _, value = (text.strip() for text in option.partition("="))
        if key not in _OPTIONS:
            raise OptionError(f"a filter has no option '{key}'; {suggest(key, _OPTIONS)}")
        try:
            values[key] = _OPTIONS[key](value)
        except ValueError:
            raise OptionError(f"the {key} of a filter is a number, not '{value}'") from None
    return Filter(name, **values)


def by_component(chosen: Mapping[str, Filter], components: Sequence[str]) -> dict[str, Filter]:
    """The filter of each of ``components``. Raises :class:`OptionError` for a filter of another one.

    If they are the components of light, the filter of all others leaves out those that it would spoil
    (:attr:`Denoiser.leaves`)."""
    for name in chosen:
        if name and name not in components:
            has = f"it has: {', '.join(components)}"
            raise OptionError(
                f"the picture has no component '{name}'; "
                + (has if len(components) > 1 else "it has none: render it with --for-denoising")
            )
    rest = chosen.get("", Filter())
    left = rest.kind.leaves if rest.kind is not None and set(COMPONENTS) <= set(components) else ()
    return {name: chosen.get(name, Filter() if name in left else rest) for name in components}
