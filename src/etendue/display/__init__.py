"""Display: tone mapping, PNG, convergence plots, the comparison page."""

from .plots import Series, convergence_plot
from .png import encode_png, write_png
from .tonemap import auto_exposure, tonemap

__all__ = ["Series", "auto_exposure", "convergence_plot", "encode_png", "tonemap", "write_png"]
