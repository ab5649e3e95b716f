"""Ctrl-C and SIGTERM, in processes of their own."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import numpy as np
import pytest

import etendue
from etendue import film
from etendue.cli.interrupts import Interrupts, leaving
from etendue.cli.main import main
from etendue.engine import Checkpoint

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
COMMAND = [sys.executable, "-m", "etendue.cli.main"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_pass(process: subprocess.Popen[str]) -> None:
    """Return when the first line of progress has come."""
    assert process.stderr is not None
    for line in process.stderr:
        if "pass " in line:
            return
    pytest.fail(f"ended with status {process.wait()} before a line of progress")


def wait_for_save(process: subprocess.Popen[str]) -> None:
    """Return when the picture was saved for the first time."""
    while not Path("a.exr").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


#: More than a second of passes, so that a signal after the first save comes before the end.
RENDER = shlex.split(
    "render cornell-box -m path --size 128x128 -D samples_per_pass=1 --spp 100 --save-every 0.1 -o a.exr"
)


def test_a_signal_stops_at_the_next_pass_and_the_rest_can_follow(folder):
    process = start(*RENDER)
    wait_for_save(process)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT
    assert out == "a.exr\na.checkpoint\n"
    assert "stopping after this pass" in err
    assert "Traceback" not in err
    early = film.read_exr("a.exr").metadata
    assert early["stopped_by"] == "cancel"
    assert 0 < early["passes"] < 100
    # Without a budget of its own, a resumed run does what the interrupted one had left.
    assert main(["resume", "a.checkpoint"]) == 0
    assert main([*RENDER[:-1], "b.exr"]) == 0
    assert film.read_exr("a.exr").metadata["passes"] == 100
    assert np.array_equal(film.read_exr("a.exr").image, film.read_exr("b.exr").image)


@pytest.mark.slow
def test_a_signal_saves_now_and_the_run_goes_on(folder):
    """With low priority."""
    process = start(*RENDER, "--spp", "3000", "--save-every", "0", "--low-priority")
    wait_for_pass(process)
    assert os.getpriority(os.PRIO_PROCESS, process.pid) == min(19, os.getpriority(os.PRIO_PROCESS, 0) + 10)
    assert not Path("a.exr").exists()
    process.send_signal(signal.SIGUSR1)
    wait_for_save(process)
    early = film.read_exr("a.exr").metadata
    assert early["stopped_by"] == "running" and 0 < early["passes"] < 3000
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM and film.read_exr("a.exr").metadata["passes"] > early["passes"]


@pytest.mark.slow
def test_signals_within_a_second_are_one_request():
    """As of ``timeout``, which sends its signal to its child, then to the group of the child. The run ends later than
    the last of them: a pass takes longer."""
    process = start(*shlex.split("render cornell-box -m path --size 512x512 --time 600 --save-every 0.1 -o a.exr"))
    wait_for_save(process)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGTERM, signal.SIGINT):
        process.send_signal(number)
        time.sleep(0.03)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGINT
    assert out == "a.exr\na.checkpoint\n"
    assert "aborted" not in err and "Traceback" not in err
    assert film.read_exr("a.exr").metadata["stopped_by"] == "cancel"


#: The command of the arguments. Writing of a file of the suffix takes more than two seconds.
SLOW_FILES = """
import contextlib, pathlib, sys, time
from etendue.cli.main import main
from etendue.film import output

suffix, replacing = sys.argv[1], output.replacing

@contextlib.contextmanager
def slow(path):
    with replacing(path) as part:
        if pathlib.Path(path).suffix == suffix:
            print("writing", flush=True)
            for _ in range(25):
                time.sleep(0.1)
        yield part

output.replacing = slow
from etendue import film
from etendue.film import exr
film.replacing = exr.replacing = slow
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "compare cornell-box -m path --size 16x12 --spp 1 -o .",
        "develop a.exr -o a.png",
    ],
)
def test_a_file_is_written_to_its_end(command):
    """Whatever signals come meanwhile: two that are more than a second apart."""
    if "develop" in command:
        etendue.render("cornell-box", "path", spp=1, size=(16, 12), save="a.exr")
    code = [sys.executable, "-c", SLOW_FILES, ".png" if ".png" in command else ".exr", *shlex.split(command)]
    process = subprocess.Popen(code, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "writing\n"
    process.send_signal(signal.SIGTERM)
    time.sleep(1.2)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    # A command that is done when its file is written may end before the signal comes through.
    assert process.returncode in {128 + signal.SIGTERM} | ({0} if "develop" in command else set()), err
    assert "aborted" not in err and "Traceback" not in err
    film.read_image({"render": "a.exr", "compare": "path.exr", "develop": "a.png"}[command.split()[0]])


def test_a_signal_while_nothing_runs_ends_the_command(folder):
    process = start("render", "cornell-box", "--size", "16x12", "--time", "600", "-o", "a.exr")
    wait_for_handler(process)
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM
    assert "Traceback" not in err
    assert os.listdir(folder) == []


def test_a_signal_during_the_import_of_what_writes_files(monkeypatch):
    monkeypatch.setitem(sys.modules, "etendue.film.output", types.ModuleType("half-imported"))
    with pytest.raises(KeyboardInterrupt), leaving():
        signal.raise_signal(signal.SIGTERM)


def test_a_signal_whose_exception_was_lost_ends_the_command_before_its_run():
    """As imports and compiled code may lose it."""
    with pytest.raises(KeyboardInterrupt), leaving():
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        with Interrupts(lambda: None, lambda: None):
            pytest.fail("the run began")


def wait_for_handler(process: subprocess.Popen[str]) -> None:
    """Return when the process catches SIGTERM, as a command does."""
    while not int(re.search(r"SigCgt:\s*(\w+)", proc(process, "status"))[1], 16) >> (signal.SIGTERM - 1) & 1:
        time.sleep(0.05)


def processor_seconds_of(process: subprocess.Popen[str]) -> float:
    fields = proc(process, "stat").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def proc(process: subprocess.Popen[str], name: str) -> str:
    assert process.poll() is None, process.communicate()
    return Path(f"/proc/{process.pid}/{name}").read_text("ascii")


@pytest.mark.slow
@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="asks Linux how far a process is")
def test_a_second_signal_aborts_at_once(folder):
    process = start(
        *shlex.split("render cornell-box -m path --size 2048x2048 -D samples_per_pass=32 --spp 320 -o a.exr")
    )
    while processor_seconds_of(process) < 6.0:  # then it is inside the first pass, which takes many times that
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    time.sleep(1.2)
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, err = process.communicate(timeout=60)
    assert time.monotonic() - began < 5.0
    assert process.returncode == 130
    assert "aborted" in err
    assert os.listdir(folder) == []


def test_a_killed_render_leaves_its_last_intermediate_save(folder):
    process = start(*RENDER, "--spp", "100000")
    wait_for_save(process)
    time.sleep(0.5)
    process.kill()
    process.communicate()
    assert film.read_exr("a.exr").metadata["stopped_by"] == "running"
    done = Checkpoint.read("a.checkpoint").measurement.iterations.next_iteration()
    assert done > 0
    assert main(["resume", "a.checkpoint", "--spp", str(done + 2)]) == 0
    assert film.read_exr("a.exr").metadata["passes"] == done + 2
