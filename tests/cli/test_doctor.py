"""`etendue doctor` says that all is well here, and finds and explains a planted fault."""

from __future__ import annotations

import importlib.metadata
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from etendue.cli import faults
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


@pytest.fixture
def at_home(tmp_path, monkeypatch):
    """A user with a home folder and a folder of work in it."""
    work = tmp_path / "home" / "jane" / "work"
    work.mkdir(parents=True)
    for name, value in (("HOME", work.parent), ("USERPROFILE", work.parent), ("LOGNAME", "doe"), ("USER", "doe")):
        monkeypatch.setenv(name, str(value))
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.chdir(work)
    return work


def test_the_last_error_is_kept_without_private_names(at_home, tmp_path, capsys):
    assert faults.last_fault() == "last error: none"
    files = [at_home / "a.xml", at_home.parent / "b.xml", tmp_path / "Big Client" / "c.xml", "doe.xml"]
    for file in files:
        assert main(["render", str(file)]) == 3
        assert str(file) in capsys.readouterr().err  # the user is told all of it
        told = faults.last_fault()
        assert "exit status 3" in told and Path(file).name.replace("doe", "USER") in told
        assert str(tmp_path) not in told and not {"jane", "doe", "Big"} & set(re.findall(r"[A-Za-z0-9]+", told))
    assert main(["render", "a.xml", "--nonsense"]) == 2
    assert (
        "  command: etendue render a.xml --nonsense\n  message: there is no option '--nonsense'" in faults.last_fault()
    )
    assert main(["doctor", "--nonsense"]) == 2
    assert "a.xml" in faults.last_fault()


def test_the_traceback_of_a_debugged_command_is_kept(at_home, capsys):
    file = at_home.parent / ".cache" / "etendue" / "last-error.traceback"
    assert main(["render", "none.xml", "--debug"]) == 3
    text = file.read_text()
    assert text.startswith("Traceback") and "ETENDUE/cli/main.py" in text and "SceneError" in text
    assert str(Path(faults.__file__).parents[1]) not in text
    assert faults.impersonal(faults.last_fault()).endswith("\n  traceback: ~/.cache/etendue/last-error.traceback")
    assert main(["render", "none.xml"]) == 3
    assert not file.exists() and "traceback" not in faults.last_fault()


def test_an_error_is_told_where_nothing_can_be_kept(at_home, monkeypatch, capsys):
    (at_home / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(at_home / "file"))
    assert main(["render", "none.xml"]) == 3
    assert "none.xml" in capsys.readouterr().err
    (at_home / "etendue").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(at_home))
    (at_home / "etendue" / "last-error.json").write_text("{")
    assert "HERE/etendue/last-error.json cannot be read" in faults.impersonal(faults.last_fault())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("no '/srv/Big Client/x.xml' here", "no '.../x.xml' here"),
        ("no file /srv/big/x.xml: 1/2/3 of it", "no file .../x.xml: 1/2/3 of it"),
        ("C:\\Users\\al\\x.xml", ".../x.xml"),
        ("LLVM 19 at /usr/lib/libLLVM.so.19", "LLVM 19 at /usr/lib/libLLVM.so.19"),
        ("see https://host.org/a/b and a/b/c.xml", "see https://host.org/a/b and a/b/c.xml"),
        ("Doe's doe_2.exr, not doer", "USER's USER_2.exr, not doer"),
    ],
)
def test_texts_without_private_names(text, shown, at_home):
    assert faults.impersonal(text) == shown
