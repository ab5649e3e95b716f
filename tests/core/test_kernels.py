"""Kernels have gather instructions on AMD processors before Zen 4, are optimised unless a run is brief, and are
launched in small blocks."""

from __future__ import annotations

import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import etendue
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


@pytest.fixture
def chosen(core, monkeypatch):
    """Whether kernels are optimised, as étendue chooses; not those of the other tests."""
    monkeypatch.delenv(kernels.OPTIMISE, raising=False)
    kernels.optimise_kernels()
    yield lambda: "optnone" not in core.processor().decode()
    monkeypatch.undo()
    kernels.optimise_kernels()


def test_kernels_that_are_not_optimised_are_others_with_the_same_numbers(chosen):
    x, known, pictures = dr.opaque(mi.Float, 2.0) * dr.arange(mi.Float, 1000), [], []
    dr.eval(x)
    for wanted in (True, False, True, False):
        kernels.optimise_kernels(wanted)
        assert chosen() is wanted
        dr.kernel_history_clear()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            pictures.append(np.array(dr.sin(x) * dr.exp(-x) + dr.fma(x, x, 1.0)))
            made = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
        known.append([kernel["hash"] for kernel in made])
        for kernel in made:  # an attribute for LLVM, and no longer part of a name
            attributes = [line for line in kernel["ir"].getvalue().splitlines() if line.startswith("attributes")]
            assert attributes and any(re.search(r'" optnone ', line) for line in attributes) is not wanted
    assert known[0] == known[2] != known[1] == known[3]
    for picture in pictures[1:]:
        np.testing.assert_allclose(picture, pictures[0], rtol=1e-6)


def test_gathers_and_optimisation_are_chosen_apart(chosen, core):
    kernels.optimise_kernels(False)
    without = core.features()
    kernels.use_gathers(False)
    assert not chosen()
    kernels.use_gathers()
    assert (chosen(), core.features()) == (False, without)
    assert kernels.kernel_target() == f"{core.processor().decode().split(chr(34))[0]}, {core.width()} lanes"
    with kernels.own_kernels(optimise=False):
        assert not chosen()
    assert not chosen()


def test_the_environment_decides(chosen, monkeypatch):
    monkeypatch.setenv(kernels.OPTIMISE, "never")
    kernels.optimise_kernels()
    assert not chosen()
    monkeypatch.setenv(kernels.OPTIMISE, "always")
    with kernels.own_kernels(optimise=False):
        assert chosen()


@pytest.mark.parametrize(
    ("limits", "optimises"),
    [({"seconds": 10}, False), ({"seconds": 11}, True), ({"spp": 1000}, False), ({"spp": 1_000_000_000}, True)],
)
def test_kernels_of_brief_runs_are_not_optimised(chosen, limits, optimises):
    seen = []

    def watch(_):
        seen.append(chosen())
        return False

    etendue.render("cornell-box", "path", size=(16, 12), callback=watch, samples_per_pass=1, **limits)
    assert seen == [optimises]
    assert chosen()


def test_a_resumed_run_chooses_anew(chosen, tmp_path):
    """By what is still to be made: the checkpoint's budget is of no matter."""
    etendue.render("cornell-box", "path", size=(16, 12), spp=1, checkpoint=tmp_path / "a.etd")
    seen = []
    etendue.resume(tmp_path / "a.etd", seconds=60, callback=lambda _: [seen.append(chosen()), False][1])
    assert seen == [True]


def test_passes_of_auto_that_learn_are_not_optimised(chosen, monkeypatch):
    from etendue.methods.auto.method import Auto

    seen = []
    monkeypatch.setattr(Auto, "_decide", lambda self: seen.append(chosen()))  # the end of such a pass
    etendue.render(
        "cornell-box", "auto", size=(16, 12), seconds=60, callback=lambda u: [seen.append(chosen()), False][1]
    )
    assert seen == [False, True]
