"""Pages of docs/howto: a reader with an empty folder saves their files, runs their commands, sees what they show."""

from __future__ import annotations

import itertools
import re
import runpy
import shlex
from pathlib import Path

import pytest

from etendue.cli.main import main

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "howto"
PAGES = sorted(FOLDER.glob("*.md"))
#: A file to be saved; what the file, or without one the last command, shows from its beginning; a command.
_STEP = re.compile(
    r"Save\sas\s`(?P<file>[\w.-]+)`[^`]*?:\n\n```\w*\n(?P<text>.*?)^```$"
    r"|(?:`(?P<made>[\w.-]+)`(?:\sbegins)?:\n\n)?^```\n(?P<shown>.*?)^```$"
    r"|^ {4}(?P<command>\S[^\n]*)$",
    re.MULTILINE | re.DOTALL,
)
_NUMBER = re.compile(r"(?<![\w.:])-?\d+\.?\d*(?![\w:])")


def steps(page: Path) -> list[dict[str, str]]:
    return [{k: v for k, v in step.groupdict().items() if v} for step in _STEP.finditer(page.read_text("utf-8"))]


def compare(shown: str, found: str) -> None:
    """Equal words, and numbers within 1 %: lines are random, and differ with the number of threads."""
    found = "".join(itertools.islice(found.splitlines(keepends=True), shown.count("\n")))
    assert _NUMBER.split(shown) == _NUMBER.split(found), found
    assert [float(x) for x in _NUMBER.findall(found)] == pytest.approx(
        [float(x) for x in _NUMBER.findall(shown)], rel=0.01, abs=1e-3
    ), found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_run_in_an_empty_folder(page, tmp_path, monkeypatch, variant, capsys):
    monkeypatch.chdir(tmp_path)
    printed, compared = "", page.stem == "city"  # which shows a picture
    found = steps(page)
    assert sum("command" in step for step in found) >= 2
    for step in found:
        if "file" in step:
            Path(step["file"]).write_text(step["text"], "utf-8")
        elif "command" in step:
            program, *words = shlex.split(step["command"])
            if program == "python":
                runpy.run_path(words[0], run_name="__main__")
            else:
                assert program == "etendue"
                assert main(words) == 0, capsys.readouterr().err
            printed = capsys.readouterr().out
        else:
            compare(step["shown"], Path(step["made"]).read_text("utf-8") if "made" in step else printed)
            compared += 1
    assert compared
