"""The denoisers by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from etendue.core import OptionError, suggest

from .filters import bilateral, gaussian, guided
from .means import non_local_means
from .oidn import open_image_denoise, prefiltered
from .pictures import Features, Picture

#: How to make a layer that a denoiser needs.
_REMEDY: Final = {"variance": "render with --aovs in several passes, or use bilateral"}


@dataclass(frozen=True)
class Denoiser:
    """``function(component, features, radius, strength)`` of a component (height, width, 3).

    ``needs``: features without which it does not work; ``uses``: features that improve the result.
    """

    name: str
    about: str
    function: Callable[[Picture, Features, int, float], Picture]
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    by_component: bool = True  #: False: it denoises the sum of components, because only the sum's variance is known
    #: Applied to the features beforehand, once for all components.
    prepare: Callable[[Features], Features] | None = None
    #: Whether it smooths details and shifts means, which :func:`restored` corrects if the variance is known.
    restores: bool = False

    def check(self, features: Features) -> None:
        """Raise :class:`OptionError` if a feature is missing that it needs."""
        for name in self.needs:
            if name not in features.names:
                raise OptionError(f"{self.name} needs the layer '{name}', which the picture lacks; {_REMEDY[name]}")


_FIRST_HIT = ("albedo", "normal")
#: All denoisers by name.
DENOISERS: Final[dict[str, Denoiser]] = {
    d.name: d
    for d in (
        Denoiser(
            "oidn",
            "Intel Open Image Denoise, a trained network",
            open_image_denoise,
            uses=(*_FIRST_HIT, "variance"),
            prepare=prefiltered,
            restores=True,
        ),
        Denoiser("bilateral", "mean of pixels that are near and alike", bilateral, uses=_FIRST_HIT),
        Denoiser("guided", "linear regression on albedo, normal and luminance in windows", guided, uses=_FIRST_HIT),
        Denoiser("gaussian", "Gaussian blur", gaussian),
        Denoiser(
            "nlm",
            "mean of pixels whose surroundings differ by no more than noise",
            non_local_means,
            ("variance",),
            by_component=False,
        ),
    )
}


def denoiser(name: str) -> Denoiser:
    """The denoiser of that name. Raises :class:`OptionError` for an unknown one."""
    if name not in DENOISERS:
        raise OptionError(f"no denoiser '{name}'; {suggest(name, DENOISERS)}")
    return DENOISERS[name]
