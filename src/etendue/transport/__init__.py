"""The shared words of every path method: emission, camera, scattering with both densities, weights, stored vertices."""

from .camera import Camera, CameraConnection
from .emission import DirectSample, EmittedRay, emission_of_hit, emit, is_emissive, sample_direct
from .mis import Mis, Techniques
from .scattering import (
    Scattered,
    evaluate_from_eye,
    evaluate_from_light,
    exchanged,
    geometric_cos,
    is_smooth,
    roulette,
    scatter_camera,
    scatter_light,
)

__all__ = [
    "Camera",
    "CameraConnection",
    "DirectSample",
    "EmittedRay",
    "Mis",
    "Scattered",
    "Techniques",
    "emission_of_hit",
    "emit",
    "evaluate_from_eye",
    "evaluate_from_light",
    "exchanged",
    "geometric_cos",
    "is_emissive",
    "is_smooth",
    "roulette",
    "sample_direct",
    "scatter_camera",
    "scatter_light",
]
