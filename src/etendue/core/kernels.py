"""How Dr.Jit compiles and launches the kernels of this process on a CPU: three settings to which Python has no access.

Gather instructions on AMD processors before Zen 4: LLVM takes them for slower than single loads, and makes eight
branches of each masked gather. Kernels of light transport are full of gathers: with the instruction, they are compiled
in .6 to .8 of the time on Zen 3, and run in .8 to .9 of it (``python -m benchmarks gathers``). With AVX-512 LLVM uses
gathers anyway; what it knows of processors of other makers is left as it is.

Optimisation: LLVM spends more than half of its time on it, and kernels then run in .9 to 1 of the time
(``python -m benchmarks optimised``). A brief run is done sooner without. The code of both kinds of kernels differs by
rounding only, and Dr.Jit keeps them apart in its cache.

Blocks of lanes that a thread takes at a time: Dr.Jit's have 16,384 lanes, or are two for each thread if that is less.
Neighbouring pixels cost alike, so that threads then wait for the one with the dearest part of the picture.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

_FAST = "+fast-gather"
_BLOCK = 1024
#: Versions of Dr.Jit whose LLVM code is known to name the processor as a quoted attribute of every function.
_KNOWN = "1.5."
#: What the name of the processor is extended by: attributes of the functions, by which LLVM does not optimise them.
_PLAIN = '" optnone noinline "kernels"="not optimised'
#: ``always`` or ``never``: whether kernels are optimised, whatever the run.
OPTIMISE = "ETENDUE_OPTIMISE"


def tune_kernels() -> None:
    """Apply the settings; whether kernels are optimised stays as it is. To be called under an LLVM variant."""
    use_gathers()
    optimise_kernels(None)
    core = _core()
    if core is not None:
        core.set_block(_BLOCK)


def with_gathers(processor: str, features: str) -> str:
    """LLVM's list of features of a processor, with fast gathers if that processor has use for them."""
    own = features.split(",")
    wanted = processor.startswith("znver") and "+avx2" in own and "+avx512f" not in own and _FAST not in own
    return f"{features},{_FAST}" if wanted else features


def use_gathers(wanted: bool = True) -> bool:
    """Compile with gather instructions where :func:`with_gathers` wants them, or, not ``wanted``, as LLVM would by
    itself. Returns whether kernels are now compiled otherwise than that."""
    core = _core()
    if core is None:
        return False
    name, own = ((text or b"").decode() for text in (core.processor(), core.features()))  # none without an LLVM variant
    name, plain = name.removesuffix(_PLAIN), own.removesuffix(f",{_FAST}")
    chosen = with_gathers(name, plain) if wanted else plain
    if chosen != own:
        core.set_target(core.processor(), chosen.encode(), core.width())
    return chosen != plain


def optimise_kernels(wanted: bool | None = True) -> bool:
    """Whether LLVM optimises the kernels that are compiled from now on, unless ``$ETENDUE_OPTIMISE`` says ``always`` or
    ``never``; ``None``: as so far. Returns whether it did so far. Without effect where kernels are not compiled by
    LLVM."""
    import drjit as dr

    core = _core()
    own = (core.processor() or b"").decode() if core and dr.__version__.startswith(_KNOWN) else ""
    if not core or not own:
        return True
    plain = own.removesuffix(_PLAIN)
    wanted = own == plain if wanted is None else wanted
    wanted = {"always": True, "never": False}.get(os.environ.get(OPTIMISE, ""), wanted)
    chosen = plain if wanted else plain + _PLAIN
    if chosen != own:
        core.set_target(chosen.encode(), core.features(), core.width())
    return own == plain


def kernel_target() -> str:
    """The processor that LLVM compiles kernels for, and the lanes of its vectors; empty under other variants."""
    core = _core()
    name = (core.processor() or b"").decode().removesuffix(_PLAIN) if core else ""
    return f"{name}, {core.width()} lanes" if core and name else ""


@contextmanager
def own_kernels(optimise: bool = True) -> Iterator[None]:
    """What a block, or a function that this decorates, chooses by :func:`optimise_kernels` ends with it; ``optimise``
    is what it begins with."""
    before = optimise_kernels(optimise)
    try:
        yield
    finally:
        optimise_kernels(before)


class _Core:
    """Functions of Dr.Jit's core, in C++, by their names on Linux and macOS. Raises :class:`AttributeError` if one has
    another name here."""

    def __init__(self, library: ctypes.CDLL) -> None:
        text, number = ctypes.c_char_p, ctypes.c_uint

        def function(name: str, result: Any, *arguments: Any) -> Any:
            return ctypes.CFUNCTYPE(result, *arguments)((name, library))

        self.processor = function("_Z19jit_llvm_target_cpuv", text)
        self.features = function("_Z24jit_llvm_target_featuresv", text)
        self.width = function("_Z21jit_llvm_vector_widthv", number)
        self.set_target = function("_Z19jit_llvm_set_targetPKcS0_j", None, text, text, number)
        self.block = function("_Z19jit_llvm_block_sizev", number)
        self.set_block = function("_Z23jit_llvm_set_block_sizej", None, number)


@cache
def _core() -> _Core | None:
    """None where the functions are not found."""
    import drjit as dr

    try:
        return _Core(ctypes.CDLL(str(next(Path(str(dr.__file__)).parent.glob("libdrjit-core.*")))))
    except (OSError, AttributeError, StopIteration):
        return None
