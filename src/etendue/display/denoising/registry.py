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


@dataclass(frozen=True)
class Denoiser:
    """``function(component, features, radius, strength)`` of a component (height, width, 3); the features have the
    variance of this component.

    ``needs``: features without which it does not work; ``uses``: features that improve the result.
    """

    name: str
    about: str
    function: Callable[[Picture, Features, int, float], Picture]
    needs: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    #: Components of light that it leaves as they are unless it is asked for them.
    leaves: tuple[str, ...] = ()
    #: Applied to the features beforehand, once for all components.
    prepare: Callable[[Features], Features] | None = None
    #: Whether it spreads fireflies, which are therefore removed beforehand if the variance is known.
    spreads_fireflies: bool = True
    #: Whether it smooths details and shifts means, which :func:`restored` corrects if the variance is known.
    restores: bool = False

    def check(self, features: Features, component: str) -> None:
        """Raise :class:`OptionError` if a feature is missing that it needs."""
        for name in self.needs:
            if name not in features.names:
                raise OptionError(
                    f"{self.name} needs the {name} of '{component}', which the picture lacks; render it with "
                    "--for-denoising, or use bilateral"
                )


_FEATURES = ("albedo", "normal", "variance")
#: All denoisers by name.
DENOISERS: Final[dict[str, Denoiser]] = {
    d.name: d
    for d in (
        Denoiser(
            "oidn",
            "Intel Open Image Denoise, a trained network",
            open_image_denoise,
            uses=_FEATURES,
            prepare=prefiltered,
            spreads_fireflies=False,
            restores=True,
        ),
        Denoiser("bilateral", "mean of pixels that are near and alike", bilateral, uses=_FEATURES),
        Denoiser(
            "guided",
            "linear regression on albedo, normal and luminance in windows",
            guided,
            uses=_FEATURES,
            leaves=("emission",),
        ),
        Denoiser(
            "gaussian", "Gaussian blur, of indirect light only", gaussian, leaves=("emission", "direct", "caustic")
        ),
        Denoiser(
            "nlm", "mean of pixels whose surroundings differ by no more than noise", non_local_means, ("variance",)
        ),
    )
}


def denoiser(name: str) -> Denoiser:
    """The denoiser of that name. Raises :class:`OptionError` for an unknown one."""
    if name not in DENOISERS:
        raise OptionError(f"no denoiser '{name}'; {suggest(name, DENOISERS)}")
    return DENOISERS[name]
