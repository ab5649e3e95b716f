"""Display: denoising, tone curves, PNG, tev, convergence plots, projections of points, the comparison page."""

from .colours import false_colour
from .curves import CURVES, ToneCurve
from .denoising import DENOISERS, Denoiser, denoiser
from .develop import develop
from .plots import Series, convergence_plot
from .png import encode_png, write_png
from .pyramid import in_pyramid, pyramids
from .report import Entry, render_report, write_report
from .scatter import Projection, projection_plot
from .tev import TevDisplay
from .tonemap import auto_exposure, check_tone, tonemap

__all__ = [
    "CURVES",
    "DENOISERS",
    "Denoiser",
    "Entry",
    "Projection",
    "Series",
    "TevDisplay",
    "ToneCurve",
    "auto_exposure",
    "check_tone",
    "convergence_plot",
    "denoiser",
    "develop",
    "encode_png",
    "false_colour",
    "in_pyramid",
    "projection_plot",
    "pyramids",
    "render_report",
    "tonemap",
    "write_png",
    "write_report",
]
