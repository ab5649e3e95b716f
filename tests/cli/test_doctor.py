"""`etendue doctor` says that all is well here, and finds and explains a planted fault."""

from __future__ import annotations

import importlib.metadata
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from etendue.cli.inspection.doctor import Check, _kernel, _package, diagnose, render
from etendue.cli.main import main
from etendue.core import llvm

RUN = """
import sys
from rich.console import Console
from etendue.cli.inspection.doctor import run_doctor
sys.exit(run_doctor(Console()))
"""


def test_this_machine_is_well():
    checks = {check.name: check for check in diagnose()}
    assert [check for check in checks.values() if check.status == "fail"] == []
    assert checks["mitsuba"].finding == "3.9.1"
    assert "llvm_ad_rgb" in checks["variants"].finding


def test_a_planted_fault_is_found_and_explained():
    environment = os.environ | {llvm.VARIABLE: "/nowhere/libLLVM.so"}
    run = subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, timeout=120)
    assert run.returncode == 1
    assert "Traceback" not in run.stderr
    assert "DRJIT_LIBLLVM_PATH names /nowhere/libLLVM.so; unset it" in run.stdout.replace("\n", " ")


def test_a_kernel_that_aborts_does_not_abort_the_doctor(monkeypatch):
    monkeypatch.setattr(
        "etendue.cli.inspection.doctor._PROBE",
        "import os, sys; print('LLVM ERROR: x', file=sys.stderr, flush=True); os.abort()",
    )
    check = _kernel("llvm_ad_rgb")
    assert check.status == "fail"
    assert check.finding == "killed by signal 6: LLVM ERROR: x"
    assert check.remedy


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("etendue", "PATH-TO-THE-CHECKOUT"), ("mitsuba", "mitsuba==3.9.1"), ("OpenEXR", "OpenEXR")],
)
def test_what_is_missing_is_installed_from_where_it_is(name, remedy, monkeypatch):
    def version(name):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "version", version)
    assert _package(name) == Check(name, "fail", "not installed", f"pip install {remedy}")


def test_findings_and_remedies_are_printed():
    out = io.StringIO()
    checks = [Check("python", "ok", "3.11"), Check("llvm", "fail", "none [found]", "apt-get install libllvm19")]
    render(checks, Console(file=out, width=60))
    assert "none [found]" in out.getvalue()
    assert "llvm: apt-get install libllvm19" in out.getvalue()
    assert "python:" not in out.getvalue()


def test_a_report_has_no_private_folders(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["doctor", "--report"]) == 0
    told = capsys.readouterr().out
    assert "mitsuba: ok" in told and "kernel cache: " in told and "numpy " in told
    for folder in (sys.prefix, str(Path.home()), str(tmp_path)):
        assert folder not in told or len(folder) < 2, folder
