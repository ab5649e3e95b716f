"""Intel Open Image Denoise, by the bindings of Mitsuba's authors (extra ``denoise``)."""

from __future__ import annotations

import numpy as np

from etendue.core import BackendError, library

from .pictures import Features, Picture


def open_image_denoise(component: Picture, features: Features, radius: int, strength: float) -> Picture:
    """The network for high dynamic range, with albedo and normal where they are there [Afra 2025].

    ``strength`` mixes the picture (0) and the denoised one (1); ``radius`` has no effect. Raises :class:`BackendError`
    if the library is missing or fails.
    """
    oidn = library("mitsuba_oidn", "the denoiser oidn", "denoise")
    guides = {} if features.albedo is None else {"albedo": np.clip(features.albedo, 0.0, 1.0)}
    if guides and features.normal is not None:  # the network takes normals beside an albedo only
        guides["normal"] = np.clip(features.normal, -1.0, 1.0)
    try:
        clean = np.array(oidn.denoise(np.maximum(component, 0.0), hdr=True, **guides))
    except (RuntimeError, ValueError) as error:
        raise BackendError(f"Open Image Denoise failed: {' '.join(str(error).split())}") from error
    return component + np.float32(min(strength, 1.0)) * (clean - component)
