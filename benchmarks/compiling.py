"""How LLVM compiles kernels (:mod:`etendue.core.kernels`): what each setting saves or costs on this processor."""

from __future__ import annotations

import statistics
import tempfile

import mitsuba as mi

from etendue.core import OptionError
from etendue.core.kernels import use_gathers

from .fresh import file_of
from .measuring import COST_SETTINGS, Record, child, spread
from .options import Methods, Names, Rounds, Size

_METHODS = "path,bpt,vcm"
_SCENES = "cornell-glass,grey-white-room,street"


def gathers(methods: Methods = _METHODS, scenes: Names = _SCENES, size: Size = "384x384", rounds: Rounds = 7) -> Record:
    """Passes of one sample with gather instructions and as LLVM compiles by itself, in turn, of Mitsuba's ``path``,
    too.

    Raises :class:`OptionError` if this processor is compiled for as LLVM knows it.
    """
    if not use_gathers():
        raise OptionError("LLVM uses this processor's gather instructions, or étendue leaves its choice to it")
    return _compared("Gather instructions", "gathers", methods, scenes, size, rounds)


def optimised(
    methods: Methods = _METHODS, scenes: Names = _SCENES, size: Size = "384x384", rounds: Rounds = 7
) -> Record:
    """Passes of one sample without LLVM's optimisation and with it, in turn, of Mitsuba's ``path``, too."""
    return _compared("LLVM's optimisation of kernels", "optimised", methods, scenes, size, rounds)


def _compared(
    title: str, what: str, methods: tuple[str, ...], scenes: tuple[str, ...], size: tuple[int, int], rounds: int
) -> Record:
    """A table of ``what``, a function of ``child.compiled``."""
    columns = ("scene", "", "compiled s, without", "with", "", "pass CPU s, without", "with", "")
    record = Record(f"{title}, {size[0]}x{size[1]}", columns)
    differ = 0.0
    for name in scenes:
        with tempfile.TemporaryDirectory(prefix="compiling-") as folder:
            file = file_of(name, folder)
            for method in (None, *methods):
                with tempfile.TemporaryDirectory(prefix="kernels-") as cache:
                    options = {"what": what, "scene": file, "size": size, "method": method, "variant": mi.variant()}
                    if method:
                        options["settings"] = COST_SETTINGS[method]
                    outcome = child("compiled", options | {"rounds": rounds}, {"DRJIT_CACHE_DIR": cache})
                label = method or "Mitsuba's path"
                if not outcome:
                    record.add(name, label, *["failed"] * 6)
                    continue
                differ = max(differ, outcome["differ"])
                (before, after), (plain, own) = outcome["compiled"], outcome["passes"]
                record.add(
                    name,
                    label,
                    *(f"{before:.2f}", f"{after:.2f}", f"{after / before:.2f}"),
                    *(f"{statistics.median(plain):.3f}", f"{statistics.median(own):.3f}"),
                    spread([b / a for a, b in zip(plain, own, strict=True)]),
                )
    record.notes += [
        "compiled: LLVM's time for the kernels of a first pass, from an empty cache",
        f"passes: median (min … max) of {rounds} in turn, in one process",
        f"pictures of both differ by at most {differ:.1g} of the brightest value",
    ]
    return record
