"""Gather instructions on AMD processors before Zen 4.

LLVM takes the gather instruction of these processors for slower than single loads, and makes eight branches of each
masked gather. Kernels of light transport are full of gathers: with the instruction, they are compiled in .7 of the time
on Zen 3, and run in .8 to .9 of it (``python -m benchmarks gathers``). With AVX-512 LLVM uses gathers anyway; what it
knows of processors of other makers is left as it is.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path

_FAST = "+fast-gather"


def with_gathers(processor: str, features: str) -> str:
    """LLVM's list of features of a processor, with fast gathers if that processor has use for them."""
    own = features.split(",")
    wanted = processor.startswith("znver") and "+avx2" in own and "+avx512f" not in own and _FAST not in own
    return f"{features},{_FAST}" if wanted else features


def use_gathers(wanted: bool = True) -> bool:
    """Have Dr.Jit compile the kernels of this process with gather instructions where :func:`with_gathers` wants them,
    or, not ``wanted``, as LLVM would by itself. Returns whether they are now compiled otherwise than that. To be called
    under an LLVM variant."""
    functions = _functions()
    if functions is None:
        return False
    processor, features, width, set_target = functions
    name, own = (processor() or b"").decode(), (features() or b"").decode()
    plain = own.removesuffix(f",{_FAST}")
    chosen = with_gathers(name, plain) if wanted else plain
    if chosen != own:
        set_target(name.encode(), chosen.encode(), width())
    return chosen != plain


@cache
def _functions() -> tuple[Callable[[], bytes], Callable[[], bytes], Callable[[], int], Callable[..., None]] | None:
    """What gives the processor, its features and the vector width for which Dr.Jit compiles, and what sets them. Python
    has no access to them: these are C++ functions of Dr.Jit's core, by their names on Linux and macOS. None if they are
    not found there."""
    import drjit as dr

    try:
        core = ctypes.CDLL(str(next(Path(str(dr.__file__)).parent.glob("libdrjit-core.*"))))
        text, number = ctypes.c_char_p, ctypes.c_uint
        return (
            ctypes.CFUNCTYPE(text)(("_Z19jit_llvm_target_cpuv", core)),
            ctypes.CFUNCTYPE(text)(("_Z24jit_llvm_target_featuresv", core)),
            ctypes.CFUNCTYPE(number)(("_Z21jit_llvm_vector_widthv", core)),
            ctypes.CFUNCTYPE(None, text, text, number)(("_Z19jit_llvm_set_targetPKcS0_j", core)),
        )
    except (OSError, AttributeError, StopIteration):
        return None
