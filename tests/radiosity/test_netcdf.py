"""netCDF files of form factors, segments and solutions."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.patches import box, cube, joined, square

from etendue.formats import FormatError
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    form_factors,
    read_form_factors,
    read_segments,
    read_solution,
    save_form_factors,
    save_segments,
    save_solution,
    solve,
)

h5netcdf = pytest.importorskip("h5netcdf")


@pytest.fixture(scope="module")
def segments():
    light = np.outer(np.repeat([0, 1, 0, 0, 0, 0], 4), [1.0, 2.0])
    return ABuffer(cube(2, reflectance=0.5, emission=light), OwenSobol(4, seed=1)).cast(32)


def opened(path):
    return h5netcdf.File(path, "r")


def made_classic(path, without=""):
    """As étendue wrote files before it had h5netcdf: 32-bit integers and doubles."""
    io = pytest.importorskip("scipy.io")
    with opened(path) as file:
        attributes, lengths = dict(file.attrs), {name: d.size for name, d in file.dimensions.items()}
        variables = {name: (v.dimensions, v[...], dict(v.attrs)) for name, v in file.variables.items()}
        for name in ("shape", "shape_name", without):
            variables.pop(name, None)
    with io.netcdf_file(str(path), "w", version=2) as file:
        for key, value in attributes.items():
            setattr(file, key, value.encode())
        for name, length in lengths.items():
            file.createDimension(name, length)
        for name, (dimensions, values, attached) in variables.items():
            stored = values.astype(np.int32 if values.dtype.kind in "iu" else np.float64)
            variable = file.createVariable(name, stored.dtype, dimensions)
            variable[:] = stored
            for key, value in attached.items():
                setattr(variable, key, value if isinstance(value, str) else int(value))


@pytest.mark.parametrize(("estimator", "classic"), [("F1", False), ("reciprocal", False), ("F1", True)])
def test_form_factors(tmp_path, segments, estimator, classic):
    factors = form_factors(segments, estimator)
    save_form_factors(tmp_path / "f.nc", factors, emissivity=0.25, metadata={"seed": 1, "source": "Bögen.ply"})
    if classic:
        made_classic(tmp_path / "f.nc")
    again = read_form_factors(tmp_path / "f.nc")
    assert abs(again.matrix - factors.matrix).max() == 0 and abs(again.errors - factors.errors).max() == 0
    for name in ("areas", "sky", "lines"):
        np.testing.assert_array_equal(getattr(again, name), getattr(factors, name))
    assert solve(segments.patches, again).residual < 1e-6
    if classic:
        return
    with opened(tmp_path / "f.nc") as file:
        assert file.attrs["Conventions"] == "CF-1.11" and json.loads(file.attrs["metadata"])["source"] == "Bögen.ply"
        assert file["area"].attrs["units"] == "m2" and file["form_factor"].attrs["units"] == "1"
        start, column, data = (file[name][...] for name in ("row_start", "column", "form_factor"))
        row = np.zeros(24)
        row[column[start[5] : start[6]]] = data[start[5] : start[6]]
        np.testing.assert_array_equal(row, factors.matrix.toarray()[5])
        assert file["emissivity"][...].tolist() == [0.25] * 24


@pytest.mark.parametrize("classic", [False, True], ids=["hdf5", "classic"])
def test_segments(tmp_path, segments, classic):
    save_segments(tmp_path / "s.nc", segments, metadata={"bundles": 32})
    if classic:
        made_classic(tmp_path / "s.nc")
    again = read_segments(tmp_path / "s.nc", segments.patches)
    assert len(again) == len(segments) and again.batch_count == segments.batch_count
    values = np.random.default_rng(1).random((24, 2))
    np.testing.assert_allclose(again.gather(values), segments.gather(values), rtol=1e-12)
    np.testing.assert_allclose(again.gather_error(values), segments.gather_error(values), rtol=1e-9)
    np.testing.assert_array_equal(again.expected, segments.expected)
    with pytest.raises(RadiosityError, match="of 24 patches of other areas"):
        read_segments(tmp_path / "s.nc", cube(3))


def test_a_solution(tmp_path, segments):
    solution = solve(segments.patches, segments)
    error = segments.gather_error(solution.radiosity)
    save_solution(tmp_path / "s.nc", solution, irradiance_error=error, metadata={"bundles": 32})
    with opened(tmp_path / "s.nc") as file:
        found = {name: variable[...] for name, variable in file.variables.items()}
        radiosity = file["radiosity"]
        assert radiosity.attrs["units"] == "W m-2" and radiosity.dimensions == ("patch", "channel")
        assert radiosity.attrs["coordinates"] == "centre_x centre_y centre_z"
    np.testing.assert_array_equal(found["radiosity"], solution.radiosity)
    np.testing.assert_allclose(found["radiosity_error"], 0.5 * error)
    np.testing.assert_allclose(found["net_flux"] * found["area"][:, None], solution.net_power)
    vertices = np.stack([found[f"vertex_{axis}"] for axis in "xyz"], axis=1)
    centres = np.stack([found[f"centre_{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(vertices[found["face_vertices"]].mean(axis=1), centres[found["front_patch"]])
    assert (found["back_patch"] == -1).all()


@pytest.mark.parametrize("kind", [".npz", ".nc", "classic.nc"])
def test_a_solution_is_read_again(tmp_path, kind):
    """Sheets, triangles, groups of faces, numbers of patches: all as they were."""
    vertices, faces = joined(
        box((0, 0, 0), (1, 1, 1), 2, inward=True), square((0.2, 0.2, 0.5), (0.5, 0, 0), (0, 0.5, 0))
    )
    vertices = np.concatenate([vertices, [[0.1, 0.1, 0.2], [0.4, 0.1, 0.2], [0.1, 0.4, 0.2]]])
    faces = np.concatenate([faces, len(vertices) - np.array([[3, 2, 1, 1]])])
    ids = np.array([7, 7, *range(10, 33), 40])
    sheets = np.isin(np.unique(ids), (32, 40))
    patches = Patches(
        vertices, faces, ids=ids, two_sided=sheets, reflectance=0.5, emission=[[1.0, 2.0]], sky=[0.5, 0.25]
    )
    patches.shapes, patches.shape_names = np.arange(len(patches)) % 3 - 1, ("walls", "Tür")
    segments = ABuffer(patches).cast(32)
    solution = solve(patches, segments)
    error = segments.gather_error(solution.radiosity, patches.sky)
    path = tmp_path / f"s{kind}"
    save_solution(path, solution, irradiance_error=error)
    if kind == "classic.nc":
        made_classic(path)
    again, read_error = read_solution(path)
    np.testing.assert_allclose(read_error, error)
    for name in ("radiosity", "irradiance", "sky_share", "residuals"):
        np.testing.assert_array_equal(getattr(again, name), getattr(solution, name))
    for name in ("vertices", "faces", "front", "back", "labels", "areas", "normals", "reflectance", "emission", "sky"):
        np.testing.assert_array_equal(getattr(again.patches, name), getattr(patches, name))
    if kind != "classic.nc":  # which has none
        np.testing.assert_array_equal(again.patches.shapes, patches.shapes)
        assert again.patches.shape_names == ("walls", "Tür")
    save_solution(path, solution)
    assert read_solution(path)[1] is None


@pytest.mark.parametrize(("name", "error"), [("s.npz", RadiosityError), ("s.nc", FormatError)])
def test_other_files_are_no_solutions(tmp_path, segments, name, error):
    with pytest.raises(error, match="there is no file of a solution"):
        read_solution(tmp_path / name)
    (tmp_path / name).write_bytes(b"something else")
    with pytest.raises(error, match="solution"):
        read_solution(tmp_path / name)
    save_form_factors(tmp_path / name, form_factors(segments))
    with pytest.raises(error, match="no file of a solution"):
        read_solution(tmp_path / name)


def test_refusals(tmp_path, segments):
    with pytest.raises(RadiosityError, match=r"written as \.nc"):
        save_segments(tmp_path / "s.npz", segments)
    with pytest.raises(FormatError, match="there is no file of form factors"):
        read_form_factors(tmp_path / "f.nc")
    (tmp_path / "f.nc").write_bytes(b"no netCDF at all")
    with pytest.raises(FormatError, match="no netCDF file of form factors"):
        read_form_factors(tmp_path / "f.nc")
    save_segments(tmp_path / "s.nc", segments)
    with pytest.raises(FormatError, match="it has no variable 'row_start'"):
        read_form_factors(tmp_path / "s.nc")
    for name in ("sky_share", "lines"):
        save_form_factors(tmp_path / "f.nc", form_factors(segments))
        made_classic(tmp_path / "f.nc", without=name)
        with pytest.raises(FormatError, match=f"it has no variable '{name}'"):
            read_form_factors(tmp_path / "f.nc")
