"""Display: tone mapping, PNG, convergence plots, projections of points, the comparison page."""

from .colours import false_colour
from .plots import Series, convergence_plot
from .png import encode_png, write_png
from .report import Entry, render_report, write_report
from .scatter import Projection, projection_plot
from .tonemap import auto_exposure, tonemap

__all__ = [
    "Entry",
    "Projection",
    "Series",
    "auto_exposure",
    "convergence_plot",
    "encode_png",
    "false_colour",
    "projection_plot",
    "render_report",
    "tonemap",
    "write_png",
    "write_report",
]
