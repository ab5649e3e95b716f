"""Intel Open Image Denoise, by the bindings of Mitsuba's authors (extra ``denoise``)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from etendue.core import BackendError, library

from .pictures import Features, Picture


def open_image_denoise(component: Picture, features: Features, radius: int, strength: float) -> Picture:
    """The network for high dynamic range, with albedo and normal if they exist; :func:`prefiltered` has removed their
    noise [Afra 2025].

    ``strength`` mixes the picture (0) and the denoised one (1); ``radius`` has no effect. Raises :class:`BackendError`
    if the library is missing or fails.
    """
    oidn = _library()
    guides = {} if features.albedo is None else {"albedo": np.clip(features.albedo, 0.0, 1.0)}
    if guides and features.normal is not None:  # the network takes normals beside an albedo only
        guides["normal"] = np.clip(features.normal, -1.0, 1.0)
    try:
        clean = np.array(oidn.denoise(np.maximum(component, 0.0), hdr=True, clean_aux=bool(guides), **guides))
    except (RuntimeError, ValueError) as error:
        raise BackendError(f"Open Image Denoise failed: {' '.join(str(error).split())}") from error
    return component + np.float32(min(strength, 1.0)) * (clean - component)


def prefiltered(features: Features) -> Features:
    """Albedo and normal, each denoised by the network for this feature, so that the network for pictures can trust
    their edges. Errors as :func:`open_image_denoise`."""
    oidn = _library()
    if features.albedo is None:
        return features
    try:
        clean = {"albedo": _alone(oidn, "albedo", np.clip(features.albedo, 0.0, 1.0))}
        if features.normal is not None:
            clean["normal"] = _alone(oidn, "normal", np.clip(features.normal, -1.0, 1.0))
    except (RuntimeError, ValueError) as error:
        raise BackendError(f"Open Image Denoise failed: {' '.join(str(error).split())}") from error
    return replace(features, **clean)


def _alone(oidn: Any, name: str, layer: Picture) -> Picture:
    """A feature denoised by itself, on the CPU: that takes arrays of the host and is fast enough."""
    kind = oidn.Device(oidn.DeviceType.CPU).new_filter("RT")
    clean = np.empty_like(layer)
    kind.set_image(name, np.ascontiguousarray(layer))
    kind.set_image("output", clean)
    kind.execute()
    return clean


def _library() -> Any:
    return library("mitsuba_oidn", "the denoiser oidn", "denoise")
