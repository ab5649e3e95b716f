"""Compilers of kernels (LLVM for the CPU, CUDA and OptiX for the GPU), and the choice of the Mitsuba variant.

Dr.Jit resolves its LLVM library while it is being imported, and an LLVM below 17 aborts the whole process inside the
first kernel. Hence two steps: :func:`ensure_llvm` runs before anything here imports ``drjit`` and points it to a usable
library; :func:`check_variant` checks, before the first kernel, which library Dr.Jit has loaded, and raises
:class:`BackendError`.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial, wraps
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import llvm
from .errors import BackendError
from .kernels import tune_kernels
from .log import logger

if TYPE_CHECKING:
    import drjit as dr

#: The Mitsuba variants that étendue runs under.
VARIANTS = tuple(f"{backend}_ad_{colour}" for colour in ("rgb", "spectral", "mono") for backend in ("llvm", "cuda"))

#: Whether the user's environment, rather than :func:`ensure_llvm`, names the LLVM library.
NAMED_BY_USER = bool(os.environ.get(llvm.VARIABLE))

_INSTALL = {
    "linux": "sudo apt-get install -y libllvm19 (another system: docs/install.md)",
    "darwin": "brew install llvm@19",
    "win32": f"install LLVM 19 from releases.llvm.org and set {llvm.VARIABLE} to its bin\\LLVM-C.dll",
}


def install_hint() -> str:
    """The command that installs a usable LLVM on this system."""
    return _INSTALL.get(sys.platform, f"install LLVM {llvm.PREFERRED} and set {llvm.VARIABLE} to its shared library")


def ensure_llvm() -> None:
    """Point Dr.Jit to a usable LLVM through ``DRJIT_LIBLLVM_PATH``, unless the user has set that variable.

    Does nothing if ``drjit`` is imported already (too late) or if no usable LLVM is found: a machine with a GPU may not
    need one, and :func:`check_variant` reports that it is missing. Never raises.
    """
    if "drjit" in sys.modules:
        return
    named = os.environ.get(llvm.VARIABLE)
    if named:
        llvm.load_private()  # a child process inherits the variable, but not what its parent has loaded
    elif (library := llvm.load_usable()) is not None:
        os.environ[llvm.VARIABLE] = str(library.path)


def check_imports() -> None:
    """Import Dr.Jit and Mitsuba; raise :class:`BackendError` with the cause if a library they need is missing."""
    try:
        import drjit  # noqa: F401
        import mitsuba  # noqa: F401
    except Exception as error:
        # Dr.Jit replaces the linker's message by its own error.
        cause: BaseException = error
        while cause.__context__ is not None:
            cause = cause.__context__
        remedy = "see docs/install.md, or run 'etendue doctor'"
        if "libatomic" in str(cause):
            remedy = "sudo apt-get install -y libatomic1"
        raise BackendError(f"Dr.Jit or Mitsuba cannot be loaded ({cause}): {remedy}") from error


def llvm_version() -> tuple[int, int, int] | None:
    """Version of the LLVM that Dr.Jit has loaded, ``None`` if it has no usable one. Safe with any LLVM."""
    import drjit as dr

    version = tuple(int(v) for v in dr.detail.llvm_version())
    if version[0] < 0 or not dr.has_backend(dr.JitBackend.LLVM):
        return None
    return version[0], version[1], version[2]


def check_llvm() -> None:
    """Raise :class:`BackendError` if a kernel of an ``llvm`` variant would fail or abort the process."""
    version = llvm_version()
    if version is not None and version[0] >= llvm.OLDEST:
        return
    found = f"Dr.Jit found LLVM {'.'.join(map(str, version))}" if version else "Dr.Jit found no LLVM that it can use"
    named = os.environ.get(llvm.VARIABLE)
    usable = next((library for library in llvm.find() if library.usable), None)
    if usable is not None and named and str(usable.path) != os.path.realpath(named):
        remedy = f"{llvm.VARIABLE} names {named}; unset it to use {usable.path}"
    elif usable is not None:
        remedy = f"import etendue before drjit and mitsuba, or set {llvm.VARIABLE}={usable.path}"
    else:
        remedy = install_hint()
    raise BackendError(f"{found}, but LLVM {llvm.OLDEST} or newer is needed: {remedy}")


def cuda_problem() -> str | None:
    """Why ``cuda_ad_rgb`` cannot be used here, in a few words; ``None`` if it can."""
    import drjit as dr
    import mitsuba as mi

    if "cuda_ad_rgb" not in mi.variants():
        return "this build of Mitsuba has no CUDA variant"
    if not dr.has_backend(dr.JitBackend.CUDA):
        return "Dr.Jit found no CUDA driver and device"
    if sys.platform == "linux":
        # Containers often get the CUDA driver without its ray tracing library; Mitsuba would fail at the first scene.
        name = os.environ.get("DRJIT_LIBOPTIX_PATH") or "libnvoptix.so.1"
        try:
            ctypes.CDLL(name)
        except OSError:
            return f"the driver's OptiX library ({name}) is missing; in a container, allow the 'graphics' capability"
    return None


def uses_cuda() -> bool:
    """Whether the current variant computes on a GPU."""
    import mitsuba as mi

    return (mi.variant() or "").startswith("cuda")


def choose_variant(requested: str | None = None, colours: str = "rgb") -> str:
    """The Mitsuba variant to use: ``requested``, or by default CUDA where usable, else LLVM, with these ``colours``
    (rgb, spectral or mono).

    Raises :class:`BackendError` for a variant that étendue does not support or that this machine cannot run.
    """
    if requested is None:
        problem = cuda_problem()
        if problem is None:
            return f"cuda_ad_{colours}"
        logger.debug("cuda_ad_rgb is not usable: %s", problem)
        requested = f"llvm_ad_{colours}"
    check_variant(requested)
    return requested


def check_variant(variant: str) -> None:
    """Raise one clear error if étendue cannot run under ``variant`` on this machine; compiles nothing."""
    import mitsuba as mi

    if variant not in VARIANTS:
        raise BackendError(
            f"variant '{variant}' is not supported: étendue runs under {', '.join(VARIANTS)} "
            "(just-in-time compiled, not polarized); choose one with --variant or mi.set_variant"
        )
    if variant not in mi.variants():
        raise BackendError(f"this build of Mitsuba has no variant '{variant}'; it has: {', '.join(mi.variants())}")
    if variant.startswith("llvm"):
        check_llvm()
    elif (problem := cuda_problem()) is not None:
        raise BackendError(f"variant '{variant}' cannot be used: {problem}; use llvm_ad_rgb, or see etendue doctor")


def use_variant(requested: str | None = None, colours: str = "rgb") -> str:
    """Make a usable variant current and return its name.

    ``None`` keeps the variant that the user has set (checked), and chooses one with ``colours`` by
    :func:`choose_variant` if none is.
    Setting a variant that is current already is free. Errors as :func:`choose_variant`.
    """
    import mitsuba as mi

    current: str | None = mi.variant()
    if requested is None and current is not None:
        check_variant(current)
        chosen = current
    else:
        chosen = choose_variant(requested, colours)
    if chosen != current:
        with _transformed_when_called():
            mi.set_variant(chosen)
    if chosen.startswith("llvm"):
        tune_kernels()
    return chosen


@contextmanager
def _transformed_when_called() -> Iterator[None]:
    """Functions under ``drjit.syntax`` are transformed when they are first called: those of Mitsuba's differentiable
    integrators take half the time of setting a variant, and few programs call one."""
    import drjit as dr

    transform = dr.syntax

    def syntax(function: Any = None, **options: Any) -> Any:
        if function is None:
            return partial(syntax, **options)

        @cache
        def transformed() -> Any:
            return transform(function, **options)

        return wraps(function)(lambda *args, **more: transformed()(*args, **more))

    dr.syntax = syntax
    try:
        yield
    finally:
        dr.syntax = transform


def lower_priority() -> None:
    """Let other processes of this machine come first: a nice value higher by 10, on Windows the class "below normal".
    For this thread and those that it creates."""
    if hasattr(os, "nice"):
        os.nice(10)
    else:
        kernel: Any = ctypes.windll.kernel32  # type: ignore[attr-defined]
        kernel.SetPriorityClass(kernel.GetCurrentProcess(), 0x4000)


def on_device(array_type: type[dr.ArrayBase], values: ArrayLike) -> dr.ArrayBase:
    """Host numbers as a device array in memory of Dr.Jit, for few numbers.

    An array made from a NumPy array directly would share its memory, whose alignment varies and is compiled into all
    kernels that read the array, so that another process would not find these kernels in the cache. A single number
    becomes opaque: as a literal, each value would need kernels of its own.
    """
    import drjit as dr

    result = array_type(np.asarray(values).ravel().tolist())
    dr.make_opaque(result)
    return result


def as_array(value: Any) -> NDArray[Any]:
    """The numbers of a Dr.Jit array, or the matrix of a transform, as a NumPy array of its shape.

    The entries of a single number, vector or matrix are read one by one: NumPy would have a kernel put them together,
    and literals are compiled into it.
    """
    import drjit as dr

    if "Transform" in type(value).__name__:  # not by the attribute 'matrix', which every Dr.Jit array has
        value = value.matrix
    if not dr.is_jit_v(value) or dr.is_tensor_v(value) or dr.width(value) != 1:
        return np.ascontiguousarray(np.asarray(value))
    dr.eval(value)
    return np.array(_entries(value), dr.type_v(value).name.lower()).reshape(dr.shape(value))


def _entries(value: Any) -> list[Any]:
    import drjit as dr

    return [value[0]] if dr.depth_v(value) == 1 else [entry for part in value for entry in _entries(part)]


def copied_to_device(array_type: type[dr.ArrayBase], values: ArrayLike) -> dr.ArrayBase:
    """As :func:`on_device`, for many numbers: a kernel copies them."""
    import drjit as dr

    numbers = np.ascontiguousarray(values).ravel()
    if numbers.size == 1:
        return dr.opaque(array_type, numbers[0].item())
    borrowed = array_type(numbers)
    index = dr.uint32_array_t(array_type)
    # The opaque offset forces a copy: Dr.Jit would replace a gather of all entries in order by the array itself.
    own = dr.gather(array_type, borrowed, dr.arange(index, len(borrowed)) + dr.opaque(index, 0))
    dr.eval(own)
    return own


# Dr.Jit loads LLVM when it is imported, and this is the first module of étendue that Python executes
# (`etendue/__init__.py` imports `core` first, and `core` this module).
ensure_llvm()
check_imports()
