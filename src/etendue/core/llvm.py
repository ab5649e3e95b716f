"""Finds the LLVM library with which Dr.Jit compiles CPU kernels. Uses the standard library only.

Dr.Jit 1.5 loads LLVM while ``drjit`` is being imported: the library in ``DRJIT_LIBLLVM_PATH``, else ``libLLVM.so``,
else the newest in a few directories. A version below 17 aborts the process in the first kernel. This module therefore
searches before Dr.Jit does, and in more directories; ``tools/setup_native.py`` runs the same search before the
installation.
"""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

#: Oldest major version whose kernels work.
OLDEST = 17
#: The version with which étendue is tested; preferred if several are installed.
PREFERRED = 19
#: Environment variable with the path of the library for Dr.Jit.
VARIABLE = "DRJIT_LIBLLVM_PATH"

# libLLVM.so.19.1, libLLVM-17.so.1, libLLVM-14.0.6.so.1; not libLLVMCore.so.19 and not libLLVMSPIRVLib.so.15.
_NUMBERED = re.compile(r"^libLLVM(?:-(?P<a>\d+)(?:\.\d+)*)?\.(?:so|dylib)(?:\.(?P<b>\d+)(?:\.\d+)*)?$")
# Directories whose name carries a version: llvm-19, llvm19, llvm@19, Cellar/llvm/19.1.7.
_DIRECTORY = re.compile(r"llvm[-@/]?(\d+)")


@dataclass(frozen=True)
class Library:
    """An LLVM shared library: its path and major version (0 if unknown)."""

    path: Path
    major: int

    @property
    def usable(self) -> bool:
        """Whether Dr.Jit's kernels work with this version."""
        return self.major >= OLDEST


def private_directory(prefix: str = sys.prefix) -> Path:
    """Directory of the libraries that ``tools/setup_native.py`` could not install system-wide."""
    return Path(prefix) / "native" / "lib"


def find() -> list[Library]:
    """All LLVM libraries found: those in :func:`private_directory`, version 19, then the newest; unusable last."""
    own = private_directory().resolve()  # as the paths of the libraries
    seen: dict[Path, Library] = {}
    for path in _candidates():
        real = path.resolve()
        if real not in seen and real.is_file():
            seen[real] = Library(real, version_of(path))
    return sorted(
        seen.values(),
        key=lambda lib: (not lib.usable, own not in lib.path.parents, lib.major != PREFERRED, -lib.major),
    )


def load_usable() -> Library | None:
    """Load the best usable library that the dynamic linker accepts, and return it; ``None`` if there is none."""
    load_private()
    for library in find():
        if not library.usable:
            return None
        try:
            ctypes.CDLL(str(library.path))
        except OSError:
            continue  # for another processor, or a dependency is missing
        return library
    return None


def version_of(path: Path) -> int:
    """Major version of the library at ``path``: from its name, else by calling it in a separate process; 0 if
    unknown."""
    for name in (path.name, path.resolve().name):
        match = _NUMBERED.match(name)
        # "libLLVM-17.so.1": the number after the dash counts; "libLLVM.so.19.1": the one after "so".
        if match and (match["a"] or int(match["b"] or 0) > 1):
            return int(match["a"] or match["b"])
    match = _DIRECTORY.search(path.resolve().as_posix())
    return int(match[1]) if match else _reported_version(path)


def _reported_version(path: Path) -> int:
    # In a separate process: two LLVMs in one process may conflict, and a broken one must not crash this process.
    code = (
        "import ctypes,sys;l=ctypes.CDLL(sys.argv[1]);v=[ctypes.c_uint() for _ in range(3)];"
        "l.LLVMGetVersion(*map(ctypes.byref,v));print(v[0].value)"
    )
    try:
        run = subprocess.run([sys.executable, "-I", "-c", code, str(path)], capture_output=True, timeout=20, check=True)
        return int(run.stdout)
    except (OSError, subprocess.SubprocessError, ValueError):
        return 0  # LLVMGetVersion exists since LLVM 16: a library without it is too old


def load_private() -> None:
    """Load the libraries in :func:`private_directory` other than LLVM, on which LLVM and Dr.Jit depend.

    The linker finds a loaded library by its name and does not search the system for it.
    """
    directory = private_directory()
    if not directory.is_dir():
        return
    pending = [path for path in sorted(directory.iterdir()) if not path.name.startswith("libLLVM")]
    while pending:
        refused = []
        for path in pending:
            try:
                ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            except OSError:
                refused.append(path)  # it may depend on a later one
        if len(refused) == len(pending):
            return
        pending = refused


def _candidates() -> Iterator[Path]:
    if sys.platform == "win32":
        yield from _windows()
        return
    for directory in _directories():
        if directory.is_dir():
            yield from sorted(p for p in directory.glob("libLLVM*") if _NUMBERED.match(p.name))
    if sys.platform == "linux":
        yield from _linker_cache()


def _directories() -> Iterator[Path]:
    yield private_directory()
    yield Path(sys.prefix) / "lib"  # a conda environment's own
    if sys.platform == "darwin":
        for root in ("/opt/homebrew", "/usr/local"):
            yield from sorted(Path(root).glob("opt/llvm*/lib"))
            yield from sorted(Path(root).glob("Cellar/llvm*/*/lib"))
        yield Path("/opt/local/lib")
        yield from sorted(Path("/opt/local/libexec").glob("llvm-*/lib"))
        return
    triplet = sysconfig.get_config_var("MULTIARCH") or f"{os.uname().machine}-linux-gnu"
    for root in ("/usr/lib", "/usr/local/lib"):
        yield Path(root, triplet)
    for root in ("/usr/lib64", "/usr/lib", "/usr/local/lib64", "/usr/local/lib"):
        yield Path(root)
        yield from sorted(Path(root).glob("llvm*/lib"))
        yield from sorted(Path(root).glob("llvm*/lib64"))
    yield from sorted(Path("/usr/lib/llvm").glob("*/lib64"))
    yield Path("/usr/lib/wsl/lib")


def _linker_cache() -> Iterator[Path]:
    """The libraries that ``ldconfig -p`` lists, also those in directories known only to the linker's configuration."""
    for program in ("/sbin/ldconfig", "/usr/sbin/ldconfig"):
        if not os.path.exists(program):
            continue
        try:
            listing = subprocess.run([program, "-p"], capture_output=True, text=True, timeout=20, check=True).stdout
        except (OSError, subprocess.SubprocessError):
            return
        for line in listing.splitlines():
            path = Path(line.rpartition(" => ")[2].strip())
            if _NUMBERED.match(path.name):
                yield path
        return


def _windows() -> Iterator[Path]:
    roots = [os.environ.get("PROGRAMFILES", r"C:\Program Files") + r"\LLVM\bin"]
    roots += [sys.prefix + r"\Library\bin", *os.environ.get("PATH", "").split(os.pathsep)]
    for root in roots:
        if root and (path := Path(root, "LLVM-C.dll")).is_file():
            yield path
