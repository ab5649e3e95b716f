"""Maps from files of particles: in passes or at once, every kind and file, and bad input."""

from __future__ import annotations

import numpy as np
import pytest

from etendue import trace_particles
from etendue.core import OptionError
from etendue.film import read_exr
from etendue.products.particles import FileSource, MapOptions, make_map, maps, repack, write_map
from etendue.scene import load
from etendue.surfaces import MapSurfaces, SurfaceError, face_sides, irradiance_at, read_map, vertex_radiosity

PATHS = 20_000


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """A file of particles, and the loaded scene."""
    path = tmp_path_factory.mktemp("maps") / "box.particles"
    trace_particles("cornell-box", paths=PATHS, save=path, samples_per_pass=5000)
    return path, FileSource(path).scene()


@pytest.mark.parametrize("kind", ["histogram", "kernel", "variable", "knn"])
def test_every_kind_has_the_flux_of_the_particles(traced, kind):
    path, problem = traced
    source = FileSource(path)
    made = make_map(problem, source, MapOptions(kind, cells=2000))
    assert made.particles == len(source.file)
    patches = made.surfaces.patches
    value, error = irradiance_at(made.map, patches.centres, patches.normals)
    flux = (np.nan_to_num(value) * patches.areas[:, None]).sum(axis=0)
    np.testing.assert_allclose(flux, source.file.power, rtol=0.02)
    assert np.isfinite(error[value > 0]).all()
    assert 0.0 < np.median(error[value > 0] / value[value > 0]) < 0.5


def test_passes_are_one_map(traced, monkeypatch):
    """A file in batches of a few thousand, and its particles at once."""
    path, problem = traced
    monkeypatch.setattr("etendue.products.particles.sources._BATCH", 3000)
    options, told = MapOptions("kernel", cells=1000, bandwidth=0.2), []
    by_parts = make_map(problem, FileSource(path), options, told.append)
    at_once = make_map(problem, FileSource(path).file.read(), options)
    np.testing.assert_allclose(by_parts.map.values, at_once.map.values, rtol=1e-4)
    np.testing.assert_allclose(by_parts.map.errors, at_once.map.errors, rtol=1e-2, atol=1e-5)
    assert len(told) > 2
    within = [text for text in told if "the surface within each kernel" in text]
    assert len(within) > 3 and within[-1].endswith(", 100 %")


def test_bandwidths_are_of_all_particles(traced, monkeypatch):
    """Files are sorted by surface: a rule must not see the first batch alone. A part of all is nearly as good."""
    path, problem = traced
    surfaces = MapSurfaces(problem, 100)
    whole = maps._widths(surfaces, FileSource(path).file.read(), MapOptions("kernel"))
    monkeypatch.setattr("etendue.products.particles.sources._BATCH", 3000)
    np.testing.assert_allclose(maps._widths(surfaces, FileSource(path), MapOptions("kernel")), whole)
    monkeypatch.setattr(maps, "_SAMPLE", 20_000)
    np.testing.assert_allclose(maps._widths(surfaces, FileSource(path), MapOptions("kernel")), whole, rtol=0.05)


def test_the_rule_of_bandwidths_reads_few_passes(traced, monkeypatch):
    path, problem = traced
    surfaces = MapSurfaces(problem, 100)
    whole = maps._widths(surfaces, FileSource(path).file.read(), MapOptions("kernel"))
    monkeypatch.setattr(maps, "_SAMPLE", 10_000)
    source, read = FileSource(path), []
    unpacked = source.file._unpacked
    monkeypatch.setattr(source.file, "_unpacked", lambda chosen, then: unpacked(read.append(chosen) or chosen, then))
    np.testing.assert_allclose(maps._widths(surfaces, source, MapOptions("kernel")), whole, rtol=0.1)
    (chunks,) = read
    assert len({block.head["pass"] for block in chunks}) == 1 and len(source.file.passes) == 4


def test_errors_of_a_file_without_numbers_of_paths(traced, tmp_path, caplog):
    """Those of independent particles: not much smaller here, and not as large as the values."""
    path, problem = traced
    packed = tmp_path / "packed.particles"
    repack(path, packed, "packed-no-paths")
    repack(packed, tmp_path / "raw.particles", "raw")
    known = make_map(problem, FileSource(path), MapOptions(cells=200)).map
    assert not caplog.text
    for name in ("packed", "raw"):
        caplog.clear()
        made = make_map(problem, FileSource(tmp_path / f"{name}.particles"), MapOptions(cells=200)).map
        assert "has no numbers of paths" in caplog.text
        lit = known.values.min(axis=1) > 0.1
        assert 0.5 < np.median(made.errors[lit] / known.errors[lit]) < 1.2


def test_files(traced, tmp_path):
    meshio = pytest.importorskip("meshio")
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("xatlas")
    path, problem = traced
    made = make_map(problem, FileSource(path), MapOptions("histogram", cells=1000))
    values, areas = made.map.values, made.surfaces.patches.areas
    for suffix in ("npz", "vtu", "glb", "exr", "png"):
        written = write_map(tmp_path / f"map.{suffix}", made.map, made.surfaces, size=256)
        assert all(file.stat().st_size > 100 for file in written)
        assert len(written) == (2 if suffix in ("exr", "png") else 1)
    again = read_map(tmp_path / "map.npz", problem)
    np.testing.assert_array_equal(again.values, values)
    # In the file, triangles come before quadrilaterals.
    corners, patch = face_sides(made.surfaces.patches)
    is_quad = corners[:, 2] != corners[:, 3]
    order = np.concatenate([patch[~is_quad], patch[is_quad]])
    data = meshio.read(tmp_path / "map.vtu").cell_data
    for name, known in (
        ("irradiance", values),
        ("irradiance_error", made.map.errors),
        ("shape", made.surfaces.shapes),
    ):
        np.testing.assert_allclose(np.concatenate(data[name]), known[order])
    write_map(tmp_path / "only.glb", made.map, made.surfaces)
    (mesh,) = trimesh.load(tmp_path / "only.glb", process=False).geometry.values()
    smooth = vertex_radiosity(made.surfaces.patches, values).values
    np.testing.assert_allclose(mesh.vertex_attributes["_IRRADIANCE"], smooth, rtol=1e-5, atol=1e-6)
    texture = read_exr(tmp_path / "map.exr").layers["image"]
    assert abs(texture[texture.sum(axis=2) > 0].mean() / (values.mean(axis=1) @ areas / areas.sum()) - 1) < 0.5
    with pytest.raises(OptionError, match="a map is written as"):
        write_map(tmp_path / "map.stl", made.map, made.surfaces)


def test_bad_input(traced, tmp_path, caplog):
    path, _ = traced
    with pytest.raises(OptionError, match="a map is one of"):
        MapOptions("mean")
    with pytest.raises(OptionError, match="boundaries renormalise and none"):
        MapOptions("knn", boundary="linear")
    with pytest.raises(SurfaceError, match="of another one"):
        make_map(FileSource(path).scene("caustics"), FileSource(path), MapOptions("histogram"))
    assert "or is another one" in caplog.text
    small = load("cornell-box", memory=1 << 20)
    with pytest.raises(OptionError, match="holds all particles in memory"):
        make_map(small, FileSource(path), MapOptions("knn"))
    part = tmp_path / "first.particles"
    trace_particles("cornell-box", paths=500, save=part, keep="first")
    FileSource(part)
    assert "has a part of the light (keep=first)" in caplog.text
