"""Commands of the programs in ``benchmarks/``, run as a user would."""

from __future__ import annotations

import importlib
import re

from typer.testing import CliRunner


def call(package, words):
    """Run a command of ``benchmarks``, or of a package in it; the result of typer's runner."""
    registry = importlib.import_module("benchmarks.registry")
    program = registry.PROGRAMS[f"benchmarks.{package}" if package else "benchmarks"]
    return CliRunner().invoke(registry.command_line(program), words)


def tables_of(package, words, folder, monkeypatch):
    """The tables that a command publishes; what it records goes to ``folder / "RESULTS.md"``."""
    measuring = importlib.import_module("benchmarks.measuring")
    tables, publish = [], measuring.Record.publish

    def kept(self, variant, results=None):
        tables.append(self)
        publish(self, variant, results and folder / results.name)

    monkeypatch.setattr(measuring.Record, "publish", kept)
    result = call(package, words)
    assert result.exit_code == 0, result.output + repr(result.exception)
    assert tables
    for table in tables:
        assert table.rows and all(len(row) == len(table.columns) for row in table.rows)
    return tables


def is_number(cell):
    """Whether a cell of a table has a figure that means something."""
    return bool(re.search(r"\d", cell)) and not re.search(r"nan|inf", cell)
