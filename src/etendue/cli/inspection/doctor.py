"""`etendue doctor`: checks what étendue needs on this machine, and says how to fix what is wrong.

Anything that could crash the process, such as an old LLVM in its first kernel, runs in a separate process.
"""

from __future__ import annotations

import ctypes
import importlib.metadata
import os
import platform
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from etendue.core import EtendueError, backend, llvm

from ..console import say
from ..faults import impersonal, last_fault

Status = Literal["ok", "warn", "fail"]

#: The versions that étendue is tested with; others get a warning.
TESTED = {"mitsuba": "3.9.1", "drjit": "1.5.0"}

# Renders a Cornell box of 8x8 pixels: a test of compiler, ray casting and Mitsuba's plugins.
_PROBE = """
import sys
from etendue.core import use_variant
use_variant(sys.argv[1])
import mitsuba as mi, numpy as np
box = mi.cornell_box()
box["sensor"]["film"]["width"] = box["sensor"]["film"]["height"] = 8
mean = float(np.array(mi.render(mi.load_dict(box), spp=4)).mean())
sys.exit(0 if 0.01 < mean < 10 else f"the picture is wrong: its mean is {mean}")
"""

# As in a user's script that imports Mitsuba first: Dr.Jit chooses LLVM without étendue.
_MITSUBA_FIRST = "import mitsuba, drjit; print(drjit.detail.llvm_version()[0])"


@dataclass(frozen=True)
class Check:
    """One check. ``remedy`` is empty if there is nothing to fix."""

    name: str
    status: Status
    finding: str
    remedy: str = ""


def diagnose() -> list[Check]:
    """Run all checks; takes a few seconds, since it compiles and runs a kernel for each usable variant."""
    checks = [_python(), *(_package(name) for name in ("etendue", "mitsuba", "drjit", "OpenEXR"))]
    if any(check.status == "fail" for check in checks):
        return checks
    gpu = _gpu()
    compiler = _llvm()
    checks += [gpu, compiler]
    if compiler.status == "ok":
        checks += [_mitsuba_first(), _kernel("llvm_ad_rgb")]
    if gpu.status == "ok" and backend.cuda_problem() is None:
        checks.append(_kernel("cuda_ad_rgb"))
    checks.append(_variant(checks))
    return checks


def render(checks: list[Check], console: Console) -> None:
    """Print the table of checks, then the remedies."""
    colour = {"ok": "green", "warn": "yellow", "fail": "red"}
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for check in checks:
        table.add_row(f"[{colour[check.status]}]{check.status}[/]", check.name, escape(check.finding))
    console.print(table, highlight=False)
    for check in checks:
        if check.remedy:
            line = f"\n[{colour[check.status]}]{check.name}[/]: {escape(check.remedy)}"
            console.print(line, highlight=False, soft_wrap=True)


def run_doctor(console: Console, as_report: bool = False) -> int:
    """Diagnose and print, as a table or :func:`report`. Exit status 0 if étendue can render here, 1 if not."""
    checks = diagnose()
    if as_report:
        say(report(checks))
    else:
        render(checks, console)
    return int(any(check.status == "fail" for check in checks))


def report(checks: list[Check]) -> str:
    """What a report of a fault should contain: checks, packages, the cache of kernels and the last error of a command,
    in one text without the names of the user and of their folders."""
    lines = [f"{check.name}: {check.status}, {check.finding}" for check in checks]
    lines += [f"processor: {os.cpu_count()} threads, {platform.platform()}"]
    named = sorted({re.split(r"[ <>=;\[]", need)[0] for need in importlib.metadata.requires("etendue") or ()})
    found = []
    for name in named:
        with suppress(importlib.metadata.PackageNotFoundError):
            found.append(f"{name} {importlib.metadata.version(name)}")
    kernels = list((Path.home() / ".drjit").glob("*.cache")) + list((Path.home() / ".drjit").glob("*.bin"))
    size = sum(path.stat().st_size for path in kernels)
    lines += [f"packages: {', '.join(found)}", f"kernel cache: {len(kernels)} files, {size / 1e6:.1f} MB"]
    return impersonal("\n".join([*lines, last_fault()]))


def _python() -> Check:
    finding = f"{platform.python_version()} ({platform.machine()}, {platform.system()}), {sys.prefix}"
    return Check("python", "ok", finding)


def _package(name: str) -> Check:
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        wanted = "PATH-TO-THE-CHECKOUT" if name == "etendue" else f"{name}=={TESTED.get(name, '')}".rstrip("=")
        return Check(name, "fail", "not installed", f"pip install {wanted}")
    tested = TESTED.get(name, version)
    if version != tested:
        remedy = f"étendue is tested with {tested}: pip install {name}=={tested}"
        return Check(name, "warn", version, remedy)
    return Check(name, "ok", version)


def _llvm() -> Check:
    found = llvm.find()
    others = ", ".join(f"{lib.major or 'unknown'} at {lib.path}" for lib in found)
    named = os.environ.get(llvm.VARIABLE)
    try:
        backend.check_llvm()
    except EtendueError as error:
        # A machine with a usable GPU can render without it.
        status: Status = "warn" if backend.cuda_problem() is None else "fail"
        return Check("llvm", status, f"Dr.Jit has none that works; found: {others or 'none'}", str(error))
    version = backend.llvm_version()
    return Check("llvm", "ok", f"{'.'.join(map(str, version or ()))} at {named or 'a place that Dr.Jit chose'}")


def _mitsuba_first() -> Check:
    """Whether a script may import Mitsuba before étendue."""
    environment = {k: v for k, v in os.environ.items() if k != llvm.VARIABLE or backend.NAMED_BY_USER}
    try:
        run = subprocess.run(
            [sys.executable, "-c", _MITSUBA_FIRST], env=environment, capture_output=True, text=True, timeout=120
        )
        major = int(run.stdout.split()[-1])
    except (subprocess.SubprocessError, ValueError, IndexError, OSError):
        major = -1
    name = "import order"
    if major >= llvm.OLDEST:
        return Check(name, "ok", "étendue and Mitsuba may be imported in either order")
    library = os.environ.get(llvm.VARIABLE)
    remedy = "in your scripts, import etendue before mitsuba and drjit"
    if library:
        remedy += f", or set {llvm.VARIABLE}={library} in your shell"
    what = f"takes LLVM {major}, which does not work" if major > 0 else "finds no usable LLVM"
    return Check(name, "warn", f"Mitsuba imported first {what}", remedy)


def _gpu() -> Check:
    problem = backend.cuda_problem()
    driver = _cuda_driver()
    if problem is None:
        import drjit as dr

        major, minor = (int(v) for v in tuple(dr.detail.cuda_version())[:2])
        capability = dr.detail.cuda_compute_capability()
        return Check("gpu", "ok", f"CUDA {major}.{minor}, compute capability {capability}")
    if driver is None:
        return Check("gpu", "ok", "no CUDA driver: the CPU renders")
    return Check("gpu", "warn", f"{driver}, but not usable: {problem}", "see docs/install.md, section CUDA")


def _cuda_driver() -> str | None:
    name = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
    try:
        library = ctypes.CDLL(name)
        version = ctypes.c_int()
        library.cuDriverGetVersion(ctypes.byref(version))
    except (OSError, AttributeError):
        return None
    return f"CUDA driver {version.value // 1000}.{version.value % 1000 // 10}"


def _kernel(variant: str) -> Check:
    """Render a tiny picture in a separate process."""
    name = f"kernel {variant}"
    try:
        run = subprocess.run([sys.executable, "-c", _PROBE, variant], capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        return Check(name, "fail", "no result after five minutes", "report this with the output of etendue doctor")
    if run.returncode == 0:
        return Check(name, "ok", "compiled, and rendered a test picture")
    lines = (run.stderr.strip() or "no message").splitlines()
    # After a signal the message is the first line ("LLVM ERROR: ..."), after a Python error the last.
    message = lines[0] if run.returncode < 0 else lines[-1]
    ended = f"killed by signal {-run.returncode}" if run.returncode < 0 else "failed"
    return Check(name, "fail", f"{ended}: {message}", backend.install_hint() if variant.startswith("llvm") else "")


def _variant(checks: list[Check]) -> Check:
    usable = [check.name.split()[-1] for check in checks if check.name.startswith("kernel") and check.status == "ok"]
    if not usable:
        return Check("variants", "fail", "none is usable", "fix what is wrong above")
    backend_of = usable[-1].partition("_")[0]
    others = f"{backend_of}_ad_spectral has wavelengths (dispersion, measured spectra), {backend_of}_ad_mono is grey"
    return Check("variants", "ok", f"{', '.join(usable)}; by default étendue takes {usable[-1]}; {others}")
