"""Kernels that another process, or another pass, finds in the cache."""

import re
from typing import Any

import drjit as dr
import mitsuba as mi
import pytest
from support import scenes
from support.running import go, prepared

from etendue import methods

#: With more work per pass than the defaults leave to so small a picture.
_SETTINGS: dict[str, dict[str, Any]] = {
    "guided": {"cell_samples": 500},
    "pssmlt": {"samples_per_pass": 32, "bootstrap": 1 << 13},
    "mmlt": {"samples_per_pass": 32, "bootstrap": 1 << 13},
    "film_metropolis": {"samples_per_pass": 64, "bootstrap": 1 << 13},
}


@pytest.mark.parametrize("name", sorted(methods.table()))
def test_kernels_read_aligned_memory(name: str) -> None:
    """Memory that NumPy gave is aligned by chance, and the alignment is compiled into the kernels that read it."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        go(prepared(scenes.room("rectangle", scenes.FEW), name, 1, **_SETTINGS.get(name, {})), 2, 1)
        kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
    texts = {id(one): one["ir"].getvalue() for one in kernels}
    if not mi.variant().startswith("cuda"):  # where loads are written in another form
        assert any(re.search(r"load <\d+ x [^\n]*align \d+", text) for text in texts.values())
    reading = [one for one in kernels if re.search(r"load <\d+ x [^\n]*align 1\b", texts[id(one)])]
    # Those that copy such memory are short, and the same for all scenes.
    assert kernels and not [one["size"] for one in reading if one["operation_count"] > 10]
