"""Commands of the packages of experiments in ``benchmarks/``, run as a user would."""

from __future__ import annotations

import importlib
import re

from typer.testing import CliRunner


def tables_of(package, words, folder, monkeypatch):
    """The tables that a command publishes; what it records goes to ``folder / "RESULTS.md"``."""
    main = importlib.import_module(f"benchmarks.{package}.__main__")
    measuring = importlib.import_module("benchmarks.measuring")
    tables, publish = [], measuring.Record.publish

    def kept(self, variant, keep, results=None):
        tables.append(self)
        publish(self, variant, keep, results)

    monkeypatch.setattr(measuring.Record, "publish", kept)
    monkeypatch.setattr(main, "RESULTS", folder / "RESULTS.md")
    result = CliRunner().invoke(main.app, words)
    assert result.exit_code == 0, result.output + repr(result.exception)
    assert tables
    for table in tables:
        assert table.rows and all(len(row) == len(table.columns) for row in table.rows)
    return tables


def is_number(cell):
    """Whether a cell of a table has a figure that means something."""
    return bool(re.search(r"\d", cell)) and not re.search(r"nan|inf", cell)
