"""netCDF files: types, attributes, compression, sizes, the classic format, and what cannot be written or read."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from etendue.core import BackendError
from etendue.formats import FormatError, NetcdfFile, read_netcdf

h5py = pytest.importorskip("h5py")
h5netcdf = pytest.importorskip("h5netcdf")
LONG = np.arange(400_000) % 1000


def written(path, **variables):
    file = NetcdfFile("A test", {"software": "étendue 1"})
    for name, values in variables.items():
        file.add(name, " ".join(f"{name}_{k}" for k in range(np.ndim(values))), values, f"what {name} is")
    file.write(path)
    return path


@pytest.mark.parametrize(
    "values",
    [
        np.array([2**40, -(2**62)]),
        np.array([2**32 - 1], np.uint32),
        np.array([[1, 2], [3, 4]], np.int32),
        np.array([1e300, np.nan, -0.0]),
        np.array([1.5], np.float32),
        np.empty((0, 2), np.uint32),
        LONG.reshape(-1, 2),
        np.arange(3.0).astype(">f8"),
    ],
    ids=["int64", "uint32", "int32", "float64", "float32", "empty", "compressed", "big-endian"],
)
def test_values_keep_their_types(tmp_path, values):
    again = read_netcdf(written(tmp_path / "a.nc", x=values), "a test", ("x",))["x"]
    np.testing.assert_array_equal(again, values)
    assert again.dtype == values.dtype.newbyteorder("=") and again.shape == values.shape


def test_truth_values_are_numbers(tmp_path):
    assert read_netcdf(written(tmp_path / "a.nc", x=[True, False]), "a test", ())["x"].tolist() == [1, 0]


def test_attributes_dimensions_and_metadata(tmp_path):
    file = NetcdfFile("A test", {"software": "étendue 1", "long": "é" * 100_000})
    file.add("area", "patch", [1.0, 2.0], "area of the patch", "m2", sky=2, coordinates="x y")
    file.add("pair", "patch end", [[1, 2], [3, 4]], "pairs")
    file.write(tmp_path / "a.nc")
    with h5netcdf.File(tmp_path / "a.nc", "r") as read:
        assert {name: d.size for name, d in read.dimensions.items()} == {"patch": 2, "end": 2}
        assert read["pair"].dimensions == ("patch", "end") and "units" not in read["pair"].attrs
        attributes = {"long_name": "area of the patch", "units": "m2", "sky": 2, "coordinates": "x y"}
        assert dict(read["area"].attrs) == attributes
        assert read.attrs["Conventions"] == "CF-1.11" and read.attrs["source"] == "étendue 1"
        assert len(json.loads(read.attrs["metadata"])["long"]) == 100_000


def test_long_variables_are_compressed(tmp_path):
    path = written(tmp_path / "a.nc", long=LONG, short=LONG[:1000])
    assert path.stat().st_size < 0.1 * LONG.nbytes
    with h5py.File(path) as file:
        assert file["long"].compression == "gzip" and file["short"].compression is None


@pytest.mark.slow
def test_more_than_two_gigabytes(tmp_path):
    """In bytes and in elements; the last ones are not lost."""
    values = np.zeros((1 << 31) + 10, np.int8)
    values[-3:] = [1, 2, 3]
    written(tmp_path / "a.nc", x=values)
    assert (tmp_path / "a.nc").stat().st_size < 1e8
    again = read_netcdf(tmp_path / "a.nc", "a test", ("x",))["x"]
    assert np.array_equal(again, values)


@pytest.mark.parametrize("version", [1, 2])
def test_the_classic_format_is_read(tmp_path, version):
    io = pytest.importorskip("scipy.io")
    with io.netcdf_file(str(tmp_path / "a.nc"), "w", version=version) as file:
        file.createDimension("n", 3)
        file.createVariable("x", np.int32, ("n",))[:] = [1, -2, 3]
        file.createVariable("y", np.float64, ("n",))[:] = [0.5, 1e300, -1]
    read = read_netcdf(tmp_path / "a.nc", "a test", ("x", "y"))
    assert read["x"].tolist() == [1, -2, 3] and read["y"].tolist() == [0.5, 1e300, -1]
    assert read["x"].dtype == np.int32 and read["y"].dtype == np.float64


def test_what_is_no_netcdf(tmp_path):
    for content in (b"", b"something else", b"CDF\x02 and no more", b"\x89HDF\r\n\x1a\n and no more"):
        (tmp_path / "a.nc").write_bytes(content)
        with pytest.raises(FormatError, match=r"a\.nc' is no netCDF file of cats"):
            read_netcdf(tmp_path / "a.nc", "cats", ())
    with pytest.raises(FormatError, match="it has no variable 'y'"):
        read_netcdf(written(tmp_path / "b.nc", x=[1]), "cats", ("x", "y"))


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    def absent(name, *rest):
        raise ImportError(name)

    written(tmp_path / "a.nc", x=[1])
    monkeypatch.setattr("etendue.core.extras.import_module", absent)
    with pytest.raises(BackendError, match=r"pip install 'etendue\[netcdf\]'"):
        read_netcdf(tmp_path / "a.nc", "a test", ())
    with pytest.raises(BackendError, match=r"pip install 'etendue\[netcdf\]'"):
        written(tmp_path / "b.nc", x=[1])
    assert os.listdir(tmp_path) == ["a.nc"]


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
def test_a_full_disk_is_one_error(tmp_path):
    """And no fault at the end of the process, as HDF5 has where it cannot close a file."""
    code = (
        "import resource, sys, numpy as np\n"
        "from etendue.core import OutputError\n"
        "from etendue.formats import NetcdfFile\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))\n"
        "file = NetcdfFile('A test', {})\n"
        "for name in 'xyz': file.add(name, 'n', np.random.default_rng(1).random(400_000), 'noise')\n"
        "try: file.write(sys.argv[1])\n"
        "except OutputError as error: sys.stdout.write(str(error))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.nc")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0 and run.stderr == ""
    assert run.stdout == f"cannot write '{tmp_path / 'a.nc'}': File too large; is the disk full?"
    assert not os.listdir(tmp_path)
