"""The benchmark of maps measures what it says."""

from __future__ import annotations

import importlib

import pytest


@pytest.fixture
def errors():
    return importlib.import_module("benchmarks.maps.errors")


def number(cell):
    """The median in a cell."""
    return float(cell.split()[0])


@pytest.mark.slow
def test_errors_fall_with_particles_and_smoothing(errors, monkeypatch):
    """Cells of eight times the area have less noise, kernels still less; four times the particles half of it."""
    monkeypatch.setattr(errors, "_PASSES", 1)
    kinds = errors.kinds(400)
    few = {name: kinds[name] for name in list(kinds)[:3]}
    monkeypatch.setattr(errors, "kinds", lambda cells: few)
    found = []
    for particles in (2000, 8000):
        (record,) = errors.measure(["cornell-box"], particles=particles, cells=400, seeds=1)
        found.append([number(row[1]) for row in record.rows])
    fine, coarse, kernels = zip(*found, strict=True)
    assert fine[0] > coarse[0] > kernels[0]
    assert 0.4 < fine[1] / fine[0] < 0.6


def test_cost_is_measured_in_turn(errors):
    (record,) = errors.cost(["cornell-box"], particles=2000, cells=300, queries=300, rounds=1)
    assert [row[0] for row in record.rows] == ["histogram", "kernel", "variable", "knn, k = 50"]
    assert all(number(row[1]) > 0 and number(row[2]) > 0 for row in record.rows)
