"""Gather instructions in the kernels (:mod:`etendue.core.kernels`): what they save on this processor."""

from __future__ import annotations

import statistics
import tempfile

import mitsuba as mi

from etendue.core import OptionError
from etendue.core.kernels import use_gathers

from .fresh import file_of
from .measuring import COST_SETTINGS, Record, child, spread
from .options import Methods, Names, Rounds, Size


def measure(
    methods: Methods = "path,bpt,vcm",
    scenes: Names = "cornell-glass,grey-white-room,street",
    size: Size = "384x384",
    rounds: Rounds = 7,
) -> Record:
    """Passes of one sample with the instruction and as LLVM compiles by itself, in turn, of Mitsuba's ``path``, too.

    Raises :class:`OptionError` if this processor is compiled for as LLVM knows it.
    """
    if not use_gathers():
        raise OptionError("LLVM uses this processor's gather instructions, or étendue leaves its choice to it")
    columns = ("scene", "", "compiled s, without", "with", "", "pass CPU s, without", "with", "")
    record = Record(f"Gather instructions, {size[0]}x{size[1]}", columns)
    differ = 0.0
    for name in scenes:
        with tempfile.TemporaryDirectory(prefix="gathers-") as folder:
            file = file_of(name, folder)
            for method in (None, *methods):
                with tempfile.TemporaryDirectory(prefix="kernels-") as cache:
                    options = {"scene": file, "size": size, "method": method, "variant": mi.variant()}
                    if method:
                        options["settings"] = COST_SETTINGS[method]
                    outcome = child("gathers", options | {"rounds": rounds}, {"DRJIT_CACHE_DIR": cache})
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
