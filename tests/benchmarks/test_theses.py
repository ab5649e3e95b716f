"""The table of all experiments: figures are found in tables, and every command is one."""

from __future__ import annotations

import importlib
import shlex

import pytest
import typer
from support.experiments import tables_of
from typer.main import get_command

from etendue.core import OptionError


def module(name):
    return importlib.import_module(f"benchmarks.{name}")


def test_figures_of_tables():
    record = module("measuring").Record("Errors, room, 3 seeds", ("", "kind", "RMS at 1 s", "RMS at 2 s"))
    record.add("box", "raw", "0.5 ± 0.1", "-0.25")
    record.add("box", "halton", "", "1.5e-3, worst")
    tables = module("theses").Tables([record])
    assert tables("box | raw", "RMS at 1") == 0.5
    assert tables("box", "RMS", "room") == -0.25  # the last column that begins so
    assert tables("box | halton", "RMS at 2") == 1.5e-3
    for row, column, title in (("box | halton", "RMS at 1", ""), ("box", "CPU", ""), ("box", "RMS", "office")):
        with pytest.raises(LookupError):
            tables(row, column, title)


def test_every_command_is_understood():
    registry, theses = module("registry"), module("theses")
    assert {one.thesis for one in theses.EXPERIMENTS} == set(theses.THESES)
    for one in theses.EXPERIMENTS:
        for command in one.commands:
            package, *words = shlex.split(command)
            group = get_command(registry.command_line(registry.PROGRAMS[f"benchmarks.{package}"]))
            name, found, rest = group.resolve_command(typer.Context(group), words)
            found.make_context(name, rest)  # raises for a wrong option or value


def test_nothing_left_is_an_error():
    with pytest.raises(OptionError, match="no experiment is left; the theses are"):
        next(module("theses").measure(theses="radiosity of cats"))


@pytest.mark.slow
def test_the_table(tmp_path, monkeypatch):
    *_, table = tables_of("", ["theses", "--only", "cluster voxels"], tmp_path, monkeypatch)
    assert table.title == "Experiments of the thesis on Monte Carlo framework"
    assert [row[3] for row in table.rows] == ["yes"]
