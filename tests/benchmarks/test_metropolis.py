"""Pictures by chains: cures of light attraction, and steps of several sizes, tiny."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from support.experiments import call, tables_of

from etendue import render
from etendue.core import OptionError, Replica
from etendue.scene import bundled_scene, load


@pytest.mark.slow
def test_a_table_of_cures(tmp_path, monkeypatch):
    """Every cure has its errors; chains that nothing is done about have more samples at lights than any other, and
    leave larger errors elsewhere than those that paint the lights later."""
    cures = importlib.import_module("benchmarks.metropolis.cures")
    # A reference that does not depend on the clock.
    halves = [render(cures.boxed("cornell-box"), "bpt", seed=s, size=(16, 16), spp=512).image for s in (7, 8)]
    np.save(tmp_path / "cures-cornell-box-16x16.npy", np.stack(halves))
    words = ["cures", "--scenes", "cornell-box", "--size", "16x16", "--steps", "128", "--seeds", "2"]
    words += ["--out", str(tmp_path), "--record"]
    (table,) = tables_of("metropolis", words, tmp_path, monkeypatch)
    rows = {row[0]: dict(zip(table.columns[1:], row[1:], strict=True)) for row in table.rows}
    assert list(rows) == [*cures.CURES, "path"]
    there = {name: float(rows[name]["samples at lights"].rstrip("%")) for name in cures.CURES}
    assert all(there["none"] > share for name, share in there.items() if name != "none")
    assert there["none"] > 2.0 * max(there["split"], there["later"])
    dim = {name: float(row["relMSE without lights"].split(" ")[0]) for name, row in rows.items()}
    assert dim["later"] < dim["none"]
    assert (tmp_path / "RESULTS.md").exists()


def test_lights_are_where_the_lamp_is():
    found = importlib.import_module("benchmarks.metropolis.cures")._lights("cornell-box", (32, 32))
    rows, columns = np.nonzero(found)
    assert 0.01 < found.mean() < 0.1 and rows.max() < 10 and abs(columns.mean() - 15.5) < 2.0


def test_a_scene_without_lights_in_view(tmp_path):
    words = ["cures", "--scenes", "ajar", "--size", "16x12", "--reference-time", "0.2", "--out", str(tmp_path)]
    error = call("metropolis", words).exception
    assert isinstance(error, OptionError) and "'ajar'" in str(error)


@pytest.mark.slow
def test_one_size_is_the_method_itself():
    """Steps of several sizes are moved by a walk of their own; with one it is that of the library."""
    mixtures = importlib.import_module("benchmarks.metropolis.mixtures")
    problem = load(bundled_scene("cornell-box"), size=(8, 8))
    kind, _ = mixtures.METHODS["mmlt"]
    made = kind(kind.Settings(max_depth=problem.max_depth, samples_per_pass=64))
    made.prepare(problem, 3)
    replica = Replica(made, 3)
    plain = (replica.step(0) + replica.step(1)).mean("image").reshape(-1, 3)
    one, facts = mixtures._run(problem, "mmlt", (1.0,), 3, 2)
    np.testing.assert_allclose(one, plain, rtol=1e-5)  # sums of splats are in no fixed order
    several, others = mixtures._run(problem, "mmlt", (0.25, 4.0), 3, 2)
    assert np.abs(several / one - 1.0).max() > 0.01 and np.isfinite(several).all()
    assert others[2] == pytest.approx(facts[2], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("command", "rows"), [("steps", 4), ("strategies", 3)])
def test_tables_of_steps_and_paths(command, rows, tmp_path, monkeypatch):
    steps = importlib.import_module("benchmarks.metropolis.steps")
    monkeypatch.setattr(steps, "SIZES", (0.05,))
    words = [command, "--scenes", "cornell-box", "--size", "8x8", "--steps", "32", "--seeds", "2"]
    words += ["--reference-time", "0.5", "--out", str(tmp_path)]
    (table,) = tables_of("metropolis", words, tmp_path, monkeypatch)
    assert len(table.rows) == rows
    first = 2 if command == "steps" else 1
    errors = [[float(cell.split(" ±")[0]) for cell in row[first : first + 2]] for row in table.rows]
    assert (np.array(errors) > 0.0).all() and np.isfinite(errors).all()
