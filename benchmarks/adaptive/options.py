"""Options that the experiments share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.cli.options import parse_size

from ..options import scene_names
from .scenes import SCENES

ALL = ",".join(SCENES)
BOXES = "cornell,cornell-specular"
OUT = Path("adaptive-output")
Scenes = scene_names(SCENES)
PictureSize = Annotated[
    Any, typer.Option("--size", parser=parse_size, help="Of the pictures; by default the thesis's.", metavar="WxH")
]
Samples = Annotated[int, typer.Option(min=16, help="Camera paths of a pixel.")]
