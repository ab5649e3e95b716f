"""The benchmarks of particles: every command, tiny, and what of their outcome does not depend on the machine."""

from __future__ import annotations

import pytest
from support.experiments import is_number, tables_of


@pytest.mark.slow
def test_codecs(tmp_path, monkeypatch):
    (record,) = tables_of("particles", ["codecs", "--count", "100000", "--rounds", "1"], tmp_path, monkeypatch)
    sizes = {row[0]: float(row[1]) for row in record.rows}
    assert sizes["packed-no-paths"] <= 12 and sizes["packed"] <= 16 and 60 < sizes["raw"] < 61
    assert all(is_number(row[5]) and is_number(row[6]) for row in record.rows)


@pytest.mark.slow
def test_maps(tmp_path, monkeypatch):
    """The bar: bounded loss adds less than a tenth of the noise."""
    (record,) = tables_of("particles", ["maps", "--count", "300000"], tmp_path, monkeypatch)
    assert len(record.rows) == 8
    assert all(float(row[6]) < 0.1 for row in record.rows)


@pytest.mark.slow
def test_records_of_real_chains(tmp_path, monkeypatch):
    """Check 18 of the framework's list, of real chains: strips are smaller than rows, chains than independent
    particles; neither loses anything."""
    (table,) = tables_of(
        "particles", ["chains", "--scenes", "cornell-box", "--count", "40000", "--seeds", "2"], tmp_path, monkeypatch
    )
    assert [row[0] for row in table.rows] == [
        "independent",
        *(f"chains, steps of {s}" for s in ("0.1", "0.01", "0.001")),
    ]
    independent, *chains = (list(map(float, row[2:8])) for row in table.rows)
    for zlib_row, zlib_strip, *_, rle_row, rle_strip in (independent, *chains):
        assert zlib_strip < zlib_row and rle_strip < rle_row
    assert all(cells[0] < independent[0] and cells[1] < independent[1] for cells in chains)
    assert all(int(row[1]) < 40000 for row in table.rows[1:])  # states that repeat are one particle


@pytest.mark.slow
def test_records_of_the_thesis(tmp_path, monkeypatch):
    """Check 18 of the framework's list: strips are smaller than rows, chains than independent particles, small steps
    than large ones; bzip2 mostly at most as large as zlib: so it is for rows, while strips of so few particles have
    nearly the same size by both."""
    ratios, saving = tables_of("particles", ["thesis", "--count", "20000"], tmp_path, monkeypatch)
    table = {(row[0], row[1]): list(map(float, row[3:])) for row in ratios.rows}
    for zlib_row, zlib_strip, bz2_row, bz2_strip, rle_row, rle_strip in table.values():
        assert zlib_strip < zlib_row and bz2_strip < bz2_row and rle_strip < rle_row
    for kind in ("diffuse uv", "glossy xyz"):
        by_step = [table[f"walk, step {step}", kind][1] for step in ("0.1", "0.01", "0.001")]
        assert by_step[0] > by_step[1] > by_step[2]
        assert by_step[1] < table["independent", kind][1]
    better = [bz2_row <= zlib_row for zlib_row, _, bz2_row, *_ in table.values()]
    assert sum(better) > len(better) / 2
    assert all(float(row[1]) < 40 for row in saving.rows)
