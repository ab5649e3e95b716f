"""étendue: global illumination for Mitsuba 3 scenes."""

from . import core as core  # first: it finds Dr.Jit an LLVM before anything imports Dr.Jit
