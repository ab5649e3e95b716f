"""Metropolis particles beside independent ones: which scenes are sampled by their materials, and a tiny table."""

from __future__ import annotations

import importlib

import pytest
from support.experiments import tables_of


@pytest.mark.parametrize(
    ("scene", "sampled"),
    [("glossy-office", False), ("glossy-office-sampled", True), ("cornell-specular", False), ("diffuse-office", True)],
)
def test_the_floor_of_the_thesis_is_not_sampled_by_its_material(scene, sampled):
    entrants = importlib.import_module("benchmarks.light_chains.against").entrants(scene, 1 << 16)
    assert {settings["bsdf_sampling"] for _, settings in entrants.values()} == {sampled}


@pytest.mark.slow
def test_a_table_of_particles(tmp_path, monkeypatch):
    words = ["against", "--scene", "cornell", "--millions", "0.1", "--reference-millions", "0.4", "--seeds", "2"]
    (table,) = tables_of("light_chains", words, tmp_path, monkeypatch)
    ratios = {row[0]: float(row[4].split(" ")[0]) for row in table.rows}
    assert ratios["standard"] == 1.0
    assert all(ratio > 1.0 for label, ratio in ratios.items() if label.startswith("Metropolis"))
