"""The methods of the bidirectional estimator, which differ in their default settings."""

from __future__ import annotations

from typing import ClassVar

from ..base import ImageSettings
from .method import Bidirectional
from .settings import BpmSettings, BptSettings


class Bpt(Bidirectional):
    """Bidirectional path tracing: all techniques that connect vertices, no merging."""

    name: ClassVar[str] = "bpt"
    Settings: ClassVar[type[ImageSettings]] = BptSettings
    measures: ClassVar[bool] = True
    citations: ClassVar[tuple[str, ...]] = (
        "LafortuneWillems1993",
        "VeachGuibas1995",
        "Davidovic2014",
        "Georgiev2012b",
        "Su2022",
        "Rath2023",
    )


class Bpm(Bidirectional):
    """Bidirectional photon mapping: merging at every camera vertex, no connections."""

    name: ClassVar[str] = "bpm"
    Settings: ClassVar[type[ImageSettings]] = BpmSettings
    citations: ClassVar[tuple[str, ...]] = ("Vorba2011", "Georgiev2012", "Georgiev2012b")


class Vcm(Bidirectional):
    """Vertex connection and merging: all techniques, combined by multiple importance sampling."""

    name: ClassVar[str] = "vcm"
