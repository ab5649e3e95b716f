"""`etendue compare` where a method fails: the work done before is kept."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from support import passes

from etendue.cli.main import main


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_later_seed_that_fails_costs_no_finished_one(folder, capsys, monkeypatch):
    begun = []

    def before(method: Any, iteration: int) -> None:
        begun.append(iteration)
        if len(begun) == 3:
            raise RuntimeError("out of memory")

    passes.watch(monkeypatch, "path", before)
    command = "compare cornell-box -m path -m bpt --size 8x8 --spp 1 --seeds 3 -o out"
    assert main(command.split()) == 70
    assert begun == [0, 0, 0]  # a pass for each seed
    pictures = ["path.exr", "path-seed-1.exr", "bpt.exr", "bpt-seed-1.exr", "bpt-seed-2.exr", "path.png", "bpt.png"]
    assert sorted(os.listdir("out")) == sorted(["index.html", *pictures])
    page = Path("out/index.html").read_text("utf-8")
    assert "<strong>path</strong> failed: " in page and "out of memory" in page
    assert "etendue render cornell-box -m path" in page and "etendue render cornell-box -m bpt" in page
