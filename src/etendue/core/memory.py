"""Free memory of the machine."""

from __future__ import annotations

import os
from pathlib import Path


def free_memory() -> int | None:
    """Bytes that this process can allocate without swapping, limited by the machine or its control group; ``None`` if
    unknown."""
    found = [size for size in (_machine(), _control_group()) if size is not None]
    return min(found) if found else None


def _machine() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None


def _control_group() -> int | None:
    """Free memory of the version 2 control group of a container with a limit."""
    try:
        limit, used = (
            int(Path("/sys/fs/cgroup", name).read_text("ascii")) for name in ("memory.max", "memory.current")
        )
        cache = Path("/sys/fs/cgroup/memory.stat").read_text("ascii").splitlines()
        used -= sum(int(line.split()[1]) for line in cache if line.startswith("inactive_file "))
        return max(0, limit - used)
    except (OSError, ValueError, IndexError):  # no such group, or no limit ("max")
        return None
