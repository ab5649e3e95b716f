"""Settings of ``bpt``, ``bpm`` and ``vcm``."""

from __future__ import annotations

from dataclasses import dataclass

from etendue.core import OptionError, setting
from etendue.transport import GUIDE, GUIDE_CHOICES, MANY, PYRAMID_MAX, dimensions

from .. import radius as radii
from ..base import CameraSettings
from ..openings import OpeningSettings

_CONNECTING = "connect vertices: hits on lights, next event, connections of light and camera vertices, camera splats"
_MERGING = "merge camera vertices with the light vertices within the merge radius (photon density estimation)"
_CONNECTIONS = "light vertices to which each camera vertex is connected, with light_source=cache"
_GUIDE_CONNECTIONS = (
    "learn from the picture which light vertices camera vertices are connected to, with light_source=cache; passes "
    "then depend on those before"
)
_LIGHT_PATHS = "light paths per camera path; more: less noise in caustics, more time per pass"


@dataclass(frozen=True)
class BidirectionalSettings(OpeningSettings, CameraSettings):
    """Settings of ``bpt``, ``bpm`` and ``vcm``."""

    rr_depth: int = setting(2, "path length, in edges, from which on Russian roulette may end a path", minimum=1)
    roulette: str = setting(
        "throughput",
        "Russian roulette by the light that a path still carries (throughput), or by the reflectance of the surface "
        "(albedo): paths as long as light's own",
        choices=("throughput", "albedo"),
    )
    connecting: bool = setting(True, _CONNECTING)
    merging: bool = setting(True, _MERGING)
    connections: int = setting(1, _CONNECTIONS, minimum=0, maximum=dimensions.CONNECT_MAX)
    next_events: int = setting(
        1,
        "light points sampled at each camera vertex (next event estimation)",
        minimum=0,
        maximum=dimensions.NEXT_EVENT_MAX,
    )
    light_source: str = setting(
        "cache",
        "light vertices for connections: sampled at random from all light paths of the pass (cache), or all vertices "
        "of the light path with the same number as the camera path (path)",
        choices=("cache", "path"),
    )
    heuristic: str = setting(
        "balance", "heuristic of the MIS weights: balance, or power with exponent 2", choices=("balance", "power")
    )
    merge_first: bool = setting(True, "merge at the first camera vertex, too; false: only at later ones")
    direct_light: str = setting(
        "auto",
        "techniques for direct light: all, also splats and merges of light vertices (all), or next event and hits on "
        f"lights (next_event); auto: all in scenes with {MANY} lights or more",
        choices=("auto", "all", "next_event"),
    )
    light_paths: float = setting(0.5, _LIGHT_PATHS, above=0.0, maximum=64.0)
    radius: float = setting(
        0.0, f"merge radius of the first pass, in the unit of radius_unit; {radii.RADIUS_DOC}", minimum=0.0
    )
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    volume_radius: float = setting(
        0.0, f"merge radius of the first pass in media, as radius; {radii.BALL_DOC}", minimum=0.0
    )
    radii: str = setting(
        "",
        "additional merge radii in the same run, as factors on radius such as 0.5,2; each gives a picture as a layer "
        "named like radius_0.5",
    )
    alpha: float = setting(
        0.75,
        "reduction of the merge radius: after m camera paths per pixel it is radius * (m + 1)^((alpha - 1) / 2); "
        "1: constant",
        above=0.0,
        maximum=1.0,
    )
    eta_discount: float = setting(
        0.25,
        "factor on the sample count of merging in the MIS weights; below 1, merging, whose samples are correlated, has "
        "less weight",
        above=0.0,
        maximum=1.0,
    )
    diffuse_photons: float = setting(
        0.1,
        "share that is merged of the photons sent by a wide scattering, as of a diffuse surface, whose light "
        "connections find, too; 1: all, as without connections",
        above=0.0,
        maximum=1.0,
    )
    shadow_roulette: float = setting(
        0.1,
        "share of the picture's mean radiance below which Russian roulette decides whether the shadow ray of a "
        "contribution is cast; 0: all shadow rays are cast",
        minimum=0.0,
    )
    guide_emission: str = setting("auto", GUIDE, choices=GUIDE_CHOICES)
    guide_connections: bool = setting(False, _GUIDE_CONNECTIONS)
    split_layers: bool = setting(
        False, "add a layer for each family of techniques; their sum is the image; takes 5 to 10 % more time"
    )
    pyramid: bool = setting(False, "add two layers for each technique (s, t): with MIS weight and without")
    pyramid_depth: int = setting(
        5, "longest paths, in edges, that have layers of their own in the pyramid", minimum=1, maximum=PYRAMID_MAX
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.split_layers and self.components:
            raise OptionError("split_layers and components divide the picture in two ways; leave out one of them")
        if self.reweight and (self.pyramid or radii.factors(self.radii)):
            name = "pyramid" if self.pyramid else "radii"
            raise OptionError(f"reweight changes the picture, but not the layers of {name}; leave out one of them")
        if radii.factors(self.radii) and not self.merging:
            raise OptionError(f"option 'radii={self.radii}' needs merging, which is off; leave it out")

    @property
    def samples_sky(self) -> bool:
        """See :class:`OpeningSettings`."""
        return self.connecting and self.next_events > 0

    def all_direct(self, lights: int) -> bool:
        """Whether all techniques find direct light in a scene with this number of lights."""
        return self.direct_light == "all" or (self.direct_light == "auto" and lights >= MANY)


@dataclass(frozen=True)
class BptSettings(BidirectionalSettings):
    """Settings of ``bpt``."""

    merging: bool = setting(False, _MERGING)
    connections: int = setting(2, _CONNECTIONS, minimum=0, maximum=dimensions.CONNECT_MAX)


@dataclass(frozen=True)
class BpmSettings(BidirectionalSettings):
    """Settings of ``bpm``."""

    connecting: bool = setting(False, _CONNECTING)
    light_paths: float = setting(1.0, _LIGHT_PATHS, above=0.0, maximum=64.0)
