"""étendue: global illumination for Mitsuba 3 scenes."""

from . import core as core  # first: it finds Dr.Jit an LLVM before anything imports Dr.Jit
from . import plugins as plugins

plugins.register()  # 'vcm', 'bpt', 'bpm' and 'light' in every Mitsuba variant that is set, now or later
