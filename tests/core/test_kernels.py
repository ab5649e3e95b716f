"""Kernels have gather instructions on AMD processors before Zen 4, are compiled as LLVM would elsewhere, and are
launched in small blocks."""

from __future__ import annotations

import mitsuba as mi
import pytest

from etendue.core import kernels, use_variant

ZEN_3 = "+sse4.2,+avx2,-avx512f,+fma"


@pytest.mark.parametrize(
    ("processor", "features", "wanted"),
    [
        ("znver3", ZEN_3, True),
        ("znver2", ZEN_3, True),
        ("znver4", "+avx2,+avx512f", False),  # LLVM uses its gathers anyway
        ("znver1", "-avx2", False),
        ("haswell", "+avx2,-avx512f", False),
        ("", "", False),  # no LLVM
    ],
)
def test_processors_with_use_for_gathers(processor, features, wanted):
    chosen = kernels.with_gathers(processor, features)
    assert chosen == (f"{features},+fast-gather" if wanted else features)
    assert kernels.with_gathers(processor, chosen) == chosen


@pytest.fixture
def core():
    found = kernels._core()
    if found is None or not (mi.variant() or "").startswith("llvm"):
        pytest.skip("Dr.Jit's functions are not found here, or kernels are not compiled by LLVM")
    return found


def test_kernels_are_launched_in_small_blocks(core):
    core.set_block(16384)
    use_variant()
    assert core.block() == 1024


def test_kernels_are_compiled_with_them(core):
    before = core.width()
    try:
        assert kernels.use_gathers(False) is False
        plain = core.features().decode()
        assert "fast-gather" not in plain
        use_variant()
        chosen = kernels.with_gathers(core.processor().decode(), plain)
        assert core.features().decode() == chosen
        assert kernels.use_gathers() is (chosen != plain)
        assert core.width() == before
    finally:
        kernels.use_gathers()
