"""Benchmarks of multipath in boxes: mutual information, shares of lines, and which method pays."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from support.experiments import is_number, tables_of

from etendue.radiosity import Part, Patches, box, joined


def information(part, is_root=True, count=1 << 10):
    shares = importlib.import_module("benchmarks.radiosity.shares")
    return [shares.Information(part, is_root, seed, count) for seed in range(4)]


def sphere(cells):
    """A sphere seen from inside."""
    vertices, faces = box((-1, -1, -1), (1, 1, 1), cells, inward=True)
    return Patches(vertices / np.linalg.norm(vertices, axis=1)[:, None], faces)


def test_mutual_information_of_what_is_known():
    """Inside a sphere all points see each other alike, F = 1 / A: 0 bits. A cube has the sum of the exact form factors
    of small patches in the limit, 1.609. As many lines as a pilot has are not too few for an unbiased mean."""
    bits = np.array([one.bits for one in information(Part(sphere(8)), count=1 << 8)])
    assert abs(bits.mean()) < 0.03
    for count in (1 << 6, 1 << 11):
        found = information(Part(Patches(*box((0, 0, 0), (1, 1, 1), 3, inward=True))), count=count)
        bits = np.array([one.bits for one in found])
        error = np.sqrt(np.mean([one.error**2 for one in found]) / len(found))
        assert abs(bits.mean() - 1.609) < 3.5 * error, count
        assert found[0].area == pytest.approx(6)


def test_mutual_information_of_parts():
    """Outside a box is as good as solid; inside, with thin plates at two sides, there is an empty cube."""
    shelf = Patches(*joined(box((0, 0, 0), (1, 1, 0.001)), box((0, 0, 0.999), (1, 1, 1))))
    room = Patches(*box((-1, -1, -1), (2, 2, 2), inward=True))
    inner = Part(shelf)
    around = information(Part(room, [(inner, np.eye(4))]))
    solid = information(Part(Patches(*joined(box((-1, -1, -1), (2, 2, 2), inward=True), box((0, 0, 0), (1, 1, 1))))))
    assert np.mean([one.bits for one in around]) == pytest.approx(np.mean([one.bits for one in solid]), rel=1e-3)
    assert around[0].area == pytest.approx(54 + 6, rel=0.03)
    plain = np.mean([one.bits for one in information(Part(Patches(*box((0, 0, 0), (1, 1, 1), inward=True))))])
    assert np.mean([one.bits for one in information(inner, False)]) == pytest.approx(plain, abs=0.05)


@pytest.mark.slow
def test_the_command_of_shares(tmp_path, monkeypatch):
    known, errors = tables_of(
        "radiosity", ["box-shares", "--scene", "office", "--lines", "4096", "--seeds", "2"], tmp_path, monkeypatch
    )
    assert len(known.rows) == 6 and all(is_number(row[2]) for row in known.rows)
    assert len(errors.rows) == 8 and all(is_number(row[2]) for row in errors.rows)


def test_what_regions_tell():
    """All of it if a region lets all or no lines pass, nothing if all let as many pass."""
    kept = importlib.import_module("benchmarks.radiosity.resolutions").kept_information
    through = np.array([1000, 3000, 0, 4000])
    sharp = kept(SimpleNamespace(through=through, hitting=np.array([1000, 0, 0, 4000])))
    share = 3 / 8
    assert sharp[1] == pytest.approx(-share * np.log2(share) - (1 - share) * np.log2(1 - share))
    assert sharp[0] == pytest.approx(sharp[1], rel=1e-3)
    rng = np.random.default_rng(1)
    even = [kept(SimpleNamespace(through=through, hitting=rng.binomial(through, 0.3)))[0] for _ in range(400)]
    assert abs(np.mean(even)) < 4 * np.std(even) / 20


@pytest.mark.slow
def test_the_command_of_regions(tmp_path, monkeypatch):
    (table,) = tables_of(
        "radiosity", ["box-regions", "--scene", "office", "--lines", "4096", "--seeds", "2"], tmp_path, monkeypatch
    )
    assert len(table.rows) == 10 and all(is_number(row[3]) and is_number(row[4]) for row in table.rows)


@pytest.mark.slow
def test_the_command_of_choice(tmp_path, monkeypatch):
    """All methods come to the error; none within a limit that allows a single run."""
    asked = ["box-choice", "--scene", "office", "--patches", "500", "--times", "4", "--out", str(tmp_path)]
    (table,) = tables_of("radiosity", [*asked, "--error", "0.05"], tmp_path, monkeypatch)
    assert len(table.rows) == 4 and all(is_number(row[1]) and "more" not in row[1] for row in table.rows)
    (table,) = tables_of("radiosity", [*asked, "--error", "0.001", "--seconds", "1"], tmp_path, monkeypatch)
    assert any("not by" in row[-1] for row in table.rows)
