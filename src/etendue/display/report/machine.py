"""The machine that made a page."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import numpy as np


def machine() -> dict[str, str]:
    """Processor, memory, system, and the versions of Python and NumPy; unknown facts are left out."""
    facts = {
        "processor": f"{_processor()}, {os.cpu_count() or 'unknown number of'} threads",
        "memory": _memory(),
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
    }
    return {name: text for name, text in facts.items() if text}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or "unknown processor")


def _memory() -> str:
    try:
        return f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 2**30:.0f} GiB"
    except (OSError, ValueError, AttributeError):  # names that this system does not know
        return ""
