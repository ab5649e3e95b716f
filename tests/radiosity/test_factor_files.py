"""Formats of form factors by the names of files, and files of uDALES beside those that it publishes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.patches import box, cube, joined, square

from etendue.formats import FormatError
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    corrected,
    exact_form_factors,
    factor_format,
    form_factors,
    read_form_factors,
    read_patches,
    save_form_factors,
)

sparse = pytest.importorskip("scipy.sparse")
MESHES = Path(__file__).parents[2].parent / "shared" / "meshes"


@pytest.fixture(scope="module")
def zone():
    patches = cube(1)
    patches.shapes, patches.shape_names = np.arange(6), ("west", "east", "south", "north", "floor", "roof")
    return exact_form_factors(patches)


@pytest.mark.parametrize(
    ("name", "about"),
    [
        *(("f.npz", "NumPy"), ("f.VF", "View3D"), ("f.nc", "netCDF"), ("f.csv", "table"), ("a b.IDF", "EnergyPlus")),
        *(("f.epJSON", "EnergyPlus"), ("f.i", "MOOSE"), ("vfsparse.inp.064", "uDALES"), ("svf.inp.1", "sky view")),
        *(("vf.nc.inp.201", "transpose"), ("ViewFactors.dat", "Elmer"), ("ViewFactors.dat2", "Elmer")),
        *(("constant/F", "OpenFOAM"), ("constant/globalFaceFaces", "OpenFOAM")),
    ],
)
def test_the_name_decides_the_format(name, about):
    assert about in factor_format(name).about


@pytest.mark.parametrize("name", ["f.txt", "f", "f.F", "vfsparse.inp", "f.064"])
def test_other_names(name):
    with pytest.raises(RadiosityError, match=r"take \.npz.*vfsparse\.inp\.NNN.*globalFaceFaces"):
        factor_format(name)


def test_every_format_is_written(tmp_path, zone, caplog):
    """With the same numbers: a corner of the first row is found in each text."""
    for name in ("f.vf", "f.csv", "Z1.idf", "Z1.epJSON", "f.i", "vfsparse.inp.064", "ViewFactors.dat", "F"):
        save_form_factors(tmp_path / name, zone)
        assert f"{zone.matrix[0, 1]:.10f}"[:7] in (tmp_path / name).read_text(), name
    for name in ("svf.inp.064", "globalFaceFaces", "vf.nc.inp.064"):
        save_form_factors(tmp_path / name, zone)
        assert (tmp_path / name).stat().st_size > 80
    assert not caplog.text
    assert (tmp_path / "Z1.idf").read_text().splitlines()[1:3] == ["  Z1,", "  west, west, 0.00000000,"]
    head, first = (tmp_path / "f.csv").read_text().splitlines()[:2]
    assert head == "name,west,east,south,north,floor,roof,sky,area"
    assert first.startswith("west,0,") and first.endswith(",0,1")


def test_programs_that_know_surfaces_by_names(tmp_path, zone):
    for factors in (exact_form_factors(cube(1)), exact_form_factors(cube(2))):
        for name in ("z.idf", "z.epjson", "z.i"):
            with pytest.raises(RadiosityError, match="knows surfaces by names: give each a name of its own"):
                save_form_factors(tmp_path / name, factors)
    bad = cube(1)
    bad.shapes, bad.shape_names = np.arange(6), ("a,b", "b c", "c", "d", "e", "f")
    for name in ("z.idf", "z.i"):
        with pytest.raises(FormatError, match="has no names with"):
            save_form_factors(tmp_path / name, exact_form_factors(bad))
    assert not list(tmp_path.iterdir())


def test_programs_that_need_closed_rows_are_told_of_others(tmp_path, caplog):
    patches = Patches(*joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))))
    patches.shapes, patches.shape_names = np.arange(2), ("floor", "roof")
    save_form_factors(tmp_path / "z.i", exact_form_factors(patches))
    assert (
        "MOOSE takes rows that sum to 1 without the sky" in caplog.text
        and "off by at most 0.8, as of 'floor'" in caplog.text
    )


def test_backs_have_a_column(tmp_path):
    walls, plate = box((-1, -1, -1), (1, 1, 1), 1, inward=True), square((-0.6, -0.6, 0.2), (1.2, 0, 0), (0, 1.2, 0))
    factors = form_factors(ABuffer(Patches(*joined(walls, plate)), lines=2000).cast(64))
    save_form_factors(tmp_path / "f.csv", factors)
    head, *rows = ((line.split(",")) for line in (tmp_path / "f.csv").read_text().splitlines())
    assert head[-3:] == ["sky", "backs", "area"]
    numbers = np.array([row[1:] for row in rows], float)
    np.testing.assert_allclose(numbers[:, :-1].sum(axis=1), 1, atol=1e-7)
    np.testing.assert_allclose(numbers[:, -2], factors.dark, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("is_open", [False, True])
def test_view3d_comes_back(tmp_path, is_open):
    vertices, faces = box((0, 0, 0), (1, 2, 3), 2, inward=True)
    factors = form_factors(ABuffer(Patches(vertices, faces[: 20 if is_open else 24])).cast(64), "reciprocal")
    save_form_factors(tmp_path / "f.vf", corrected(factors, row_sums=True, reciprocal=True).factors)
    read = read_form_factors(tmp_path / "f.vf")
    np.testing.assert_allclose(read.matrix.toarray(), factors.repaired().matrix.toarray(), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(read.sky, factors.repaired().sky, atol=1e-6)
    np.testing.assert_allclose(read.areas, factors.areas)
    assert read.reciprocity_error() < 1e-6 and read.reciprocal().exchange_weights is read.areas


# -- uDALES ----------------------------------------------------------------------------------------------------------


def case(number, mesh):
    folder = MESHES / f"udales-{number}"
    if not folder.is_dir():
        pytest.skip("the meshes of other programs are not beside this checkout (../shared/meshes)")
    return folder, read_patches(folder / mesh)


def sparse_of(path, n):
    i, j, factor = np.loadtxt(path).T
    return sparse.csr_array((factor, (i.astype(int) - 1, j.astype(int) - 1)), shape=(n, n))


def test_files_of_udales_beside_published_ones(tmp_path):
    """The same layout, rows, columns and numbers. With 1024 bundles, the rms of the sky is 6e-4 and that of entries
    3e-4; the matrix and its transpose differ by 0.1 at the most."""
    folder, patches = case("064", "geom.064.stl")
    found = corrected(form_factors(ABuffer(patches).cast(1024), "pooled"), row_sums=True, reciprocal=True).factors
    for name in ("vfsparse.inp.064", "svf.inp.064"):
        save_form_factors(tmp_path / name, found)
    made, published = (sparse_of(where / "vfsparse.inp.064", len(patches)) for where in (tmp_path, folder))
    assert abs(made - published).max() < 6e-3 < 0.1 < abs(made - published.T).max()
    text = (tmp_path / "vfsparse.inp.064").read_text().splitlines()
    order = [tuple(map(int, line.split()[:2])) for line in text]
    assert order == sorted(order) and text[0].startswith("1 133 0.0") and len(text[0].split()[2]) == 10
    sky, expected = (np.loadtxt(where / "svf.inp.064", skiprows=1) for where in (tmp_path, folder))
    assert len(sky) == len(expected) and np.sqrt(np.mean((sky - expected) ** 2)) < 1e-3
    np.testing.assert_allclose(made.sum(axis=1) + sky, 1, atol=1e-6)


def test_the_netcdf_of_udales_is_the_transpose(tmp_path):
    from scipy.io import netcdf_file

    folder, patches = case("201", "geom.201.STL")
    save_form_factors(tmp_path / "vf.nc.inp.201", form_factors(ABuffer(patches).cast(256), "pooled"))
    read = []
    for where in (tmp_path, folder):
        with netcdf_file(where / "vf.nc.inp.201", mmap=False) as file:
            variable = file.variables["view factor"]
            assert variable.dimensions == ("columns", "rows") and variable.data.dtype == np.dtype(">f4")
            read.append(variable.data.astype(float))
    rms, turned = (np.sqrt(np.mean((x - read[1]) ** 2)) for x in (read[0], read[0].T))
    assert rms < 5e-4 and turned > 2e-3


@pytest.mark.slow
def test_sky_view_factors_of_udales():
    folder, patches = case("064", "geom.064.stl")
    found = corrected(form_factors(ABuffer(patches).cast(16384), "pooled"), row_sums=True, reciprocal=True)
    expected = np.loadtxt(folder / "svf.inp.064", skiprows=1)
    assert found.is_sound and np.sqrt(np.mean((found.factors.sky - expected) ** 2)) <= 1.5e-4
