"""The benchmarks' own bookkeeping: who takes turns with whom, which rays are recorded, what is written down."""

from __future__ import annotations

import importlib
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from support.experiments import call
from support.tables import thinned
from typer.testing import CliRunner

from etendue import methods, scene
from etendue.core import Replica

ROOT = Path(__file__).resolve().parents[2]


def module(name):
    return importlib.import_module(f"benchmarks.{name}")


@pytest.mark.parametrize(
    "package", ["", "vcm_thesis", "adaptive", "light_chains", "cluster", "maps", "particles", "metropolis", "radiosity"]
)
def test_every_benchmark_is_a_command(package):
    """Its options have the defaults that its function has; ``--help`` says what it measures and for how long."""
    program = module("registry").PROGRAMS[f"benchmarks.{package}".rstrip(".")]
    for benchmark in program.benchmarks:
        shown = re.sub(r"[│\s]+", " ", call(package, [benchmark.name, "--help"]).output)
        assert f"{benchmark.measures} About {benchmark.minutes} min." in shown
        assert "--variant" in shown and ("--record" in shown) == benchmark.recorded
    assert program.results.is_file()
    assert f"all are run, {program.minutes} minutes" in re.sub(r"[│\s]+", " ", call(package, ["--help"]).output)


def test_the_list_has_every_benchmark():
    registry = module("registry")
    shown = call("", ["list"]).output
    for program in registry.PROGRAMS.values():
        assert f"python -m {program.package}: {program.minutes} minutes" in shown
        for benchmark in program.benchmarks:
            row = rf"^{benchmark.name} +{benchmark.minutes} +{re.escape(benchmark.measures[:30])}"
            assert re.search(row, shown, re.MULTILINE), row


def test_the_readme_has_a_row_for_every_benchmark():
    readme = (ROOT / "benchmarks" / "README.md").read_text("utf-8")
    for program in module("registry").PROGRAMS.values():
        assert f"python -m {program.package}" in readme or program.package == "benchmarks"
        for benchmark in program.benchmarks:
            assert f"| `{benchmark.name}`" in readme or f", `{benchmark.name}`" in readme, benchmark.name


def test_without_a_command_all_are_run(monkeypatch, tmp_path):
    """With their defaults, and the options that all share; those that take too long are run by name only."""
    registry, options, measuring = (module(name) for name in ("registry", "options", "measuring"))
    calls, recorded = [], []

    def table(size: options.Size = "6x4", out: options.Out = Path("here"), hidden: int = 3):
        calls.append((size, out, hidden))
        return measuring.Record("One", ("",), rows=[("1",)])

    def tables(names: options.Names = "a,b"):
        calls.append(names)
        for name in names:
            yield measuring.Record(name, ("",), rows=[("1",)])

    made = types.ModuleType("benchmarks.made")
    for function in (table, tables):
        function.__annotations__ = {k: eval(v, {"options": options}) for k, v in function.__annotations__.items()}
        setattr(made, function.__name__, function)
    monkeypatch.setitem(sys.modules, "benchmarks.made", made)
    monkeypatch.setattr(registry.Program, "results", measuring.ROOT / "benchmarks" / "made")
    monkeypatch.setattr(measuring.Record, "publish", lambda self, variant, to=None: recorded.append((self.title, to)))
    names = (("one", "table", True, False), ("many", "tables", True, True), ("long", "tables", False, True))
    program = registry.Program(
        "benchmarks",
        "About.",
        tuple(registry.Benchmark(n, f"made.{f}", 1, "", in_all=all_, recorded=kept) for n, f, all_, kept in names),
    )
    app = registry.command_line(program)
    assert CliRunner().invoke(app, ["--record", "--out", str(tmp_path)]).exception is None
    assert calls == [((6, 4), tmp_path, 3), ["a", "b"]]
    assert recorded == [("One", None), *[(name, measuring.ROOT / "benchmarks" / "made") for name in "ab"]]
    calls.clear()
    assert CliRunner().invoke(app, ["long"]).exit_code == 0 and calls == [["a", "b"]]


def test_settings_of_the_cost_benchmark_exist():
    assert module("measuring").COST_SETTINGS.keys() == methods.table().keys()
    for name, settings in module("measuring").COST_SETTINGS.items():
        methods.get(name).Settings(**settings)


@pytest.mark.parametrize("name", thinned(["path", "bpt", "vcm"], ["path"]))
def test_every_ray_is_recorded(name):
    """As many as the method counts; and a recorded ray starts in the scene and has a direction."""
    import mitsuba as mi

    problem = scene.load("cornell-glass", size=(24, 24))
    method = methods.get(name)
    estimator = method(method.Settings(**module("measuring").COST_SETTINGS[name]))
    estimator.prepare(problem, 0)
    before = mi.Scene.ray_intersect, mi.Scene.ray_test
    closest, shadow = module("rays")._record(estimator)
    assert (mi.Scene.ray_intersect, mi.Scene.ray_test) == before
    counted = Replica(estimator, 0).step(0).counters["rays"]
    assert closest.o.x.shape[0] + shadow.o.x.shape[0] == pytest.approx(counted, rel=1e-3)
    for rays in (closest, shadow):
        assert np.isfinite(np.asarray(rays.o)).all()
        assert np.linalg.norm(np.asarray(rays.d), axis=0) == pytest.approx(1.0, abs=1e-4)


def test_neighbours_are_compared_on_surfaces():
    """The k-th distances of both trees agree, or this raises; and both clocks are in the table."""
    neighbours = module("neighbours")
    for points in (neighbours.photons(500), neighbours.seen(20, 20)):
        wall = np.isclose(np.abs(points).max(axis=1), 1.0, atol=1e-5)
        sphere = np.isclose(np.linalg.norm(points - [0.3, -0.65, 0.2], axis=1), 0.35, atol=1e-5)
        assert (wall | sphere).all() and wall.any() and sphere.any()
    record = neighbours.measure(2000, 20, (16, 16), rounds=2, warm_up=1)
    assert [row[0] for row in record.rows] == ["build", "k-th distance and visit", "all"]
    assert all(float(row[1]) > 0 for row in record.rows)


def test_points_are_compared():
    """Their means are right, or this raises; and every sequence has a rate."""
    record = module("sequences").measure(1 << 14, 4, rounds=2, warm_up=1, scipy_count=1 << 8)
    assert [row[0] for row in record.rows][:3] == ["halton", "sobol", "owen-sobol"]
    assert all(len(row) == len(record.columns) for row in record.rows)
    assert all(float(row[1].split()[0]) >= 0 and ("reached" in row[2] or "missed" in row[2]) for row in record.rows[:3])


def test_the_benchmark_of_integrals_compares_and_knows_the_integral():
    pytest.importorskip("vegas")
    integrals = module("integrals")
    errors = integrals.errors([2000], seeds=3)
    assert [row[1] for row in errors.rows] == ["vegas beta=0", "vegas beta=0.75", "étendue"]
    assert all(0 < float(row[2]) < 0.05 and 0 < float(row[3]) < 0.05 for row in errors.rows)
    speed = integrals.speed(1000, rounds=1, warm_up=1)
    assert [row[0] for row in speed.rows][2:] == ["étendue, device", "étendue, host"]
    assert "4:" in speed.rows[2][3]


def test_densities_are_compared_with_scipy():
    """Both agree, or this raises."""
    pytest.importorskip("scipy")
    record = module("densities").measure(30_000, 20, rounds=1, warm_up=1)
    assert [row[0].split(",")[0] for row in record.rows] == [
        *("FixedKernel", "BinnedKernel", "NearestNeighbours", "VariableKernel", "scipy gaussian_kde")
    ]
    assert all(row[3].endswith("times slower") for row in record.rows[:-1])


@pytest.mark.slow
def test_the_radiosity_benchmark_counts_and_solves():
    record = module("exchanges").measure([3], 64, 500.0, ["compiled", "drjit"])
    columns, other = (dict(zip(record.columns, row, strict=True)) for row in record.rows)
    assert (columns["backend"], other["backend"]) == ("compiled", "drjit")
    assert columns["segments"] == other["segments"]
    assert columns["patches"] == "86" and 0 < float(columns["error"]) < 0.1


def test_the_benchmark_of_cities_compares_lines_and_integrals():
    record = module("cities").measure([1], 256, 1e-3)
    lines, integrals = (dict(zip(record.columns, row, strict=True)) for row in record.rows)
    assert (lines["facets"], lines[""], integrals[""]) == ("24", "256 bundles of 4", "integrals")
    assert 0 < float(lines["sky error"]) < 0.1 and 0 < float(integrals["sky error"]) < 0.01


def test_the_benchmark_of_exact_factors_measures_the_l_shaped_room_and_says_how_to_get_view3d():
    record = module("exact_factors").measure([], 1, None)
    (row,) = record.rows
    columns = dict(zip(record.columns, row, strict=True))
    assert (columns[""], columns["patches"], columns["program"]) == ("l-room", "8", "integrals to 3e-06")
    assert float(columns["row error"]) < 1e-6 and float(columns["F J error"]) < 1e-6
    assert any("how to build it" in note for note in record.notes)


@pytest.mark.slow
def test_the_view_factor_benchmark_measures_lines_and_says_how_to_get_the_others(monkeypatch):
    view_factors = module("view_factors")
    monkeypatch.setattr(view_factors, "_RUNS", 2)
    monkeypatch.setattr(view_factors, "_BUNDLES", 256)
    record = view_factors.measure([4], 256, 4000, 1e-3, None, None)
    assert [row[0] for row in record.rows] == ["lines", "lines, cold", "integrals"]
    for row in record.rows:
        columns = dict(zip(record.columns, row, strict=True))
        assert 0 < float(columns["F J error"]) < 0.1 and 0 < float(columns["error"]) < 0.1
    assert sum("how to" in note for note in record.notes) == 2


@pytest.mark.slow
def test_the_benchmark_of_irradiance_caching():
    record = module("irradiance").measure("cornell-box", (32, 32), [1, 4], 2, 64)
    rows = {(row[0], row[1]): row for row in record.rows}
    assert len(rows) == 6 and rows["path", "4"][-1] == "1.00"
    assert float(rows["irradiance_cache", "4"][2].split()[0]) < float(rows["path", "4"][2].split()[0])


@pytest.mark.slow
def test_the_benchmark_of_denoisers_goes_on_where_it_was_stopped(monkeypatch, tmp_path):
    denoised = module("denoised")
    monkeypatch.setattr(denoised, "CASES", {"cornell-box": denoised.Case("path", (48, 36))})
    monkeypatch.setattr(denoised, "_PIECE", 0.2)
    asked = {"short": 0.2, "long": 0.4, "seeds": 1, "reference": 0.4, "method": "", "out": str(tmp_path)}
    asked |= {"scenes": ["cornell-box"], "denoisers": ["gaussian"]}
    (first,) = denoised.measure(**asked, only_reference=False)
    assert [row[0] for row in first.rows] == ["raw, 0.4 s", "gaussian, 0.2 s"] and float(first.rows[0][2]) == 1.0
    assert "of that of the raw picture" in first.notes[0]
    monkeypatch.setattr(denoised, "_rendered", None)  # nothing is rendered again
    (again,) = denoised.measure(**asked, only_reference=False)
    assert again.rows == first.rows


def test_tables_of_a_gpu_stand_beside_those_of_a_cpu(tmp_path):
    measuring, results = module("measuring"), tmp_path / "RESULTS.md"
    for variant in ("llvm_ad_rgb", "cuda_ad_rgb", "cuda_ad_rgb", "llvm_ad_rgb"):
        measuring.Record("Table", ("", "a"), [("vcm", "1.0")]).publish(variant, results)
    titles = [line for line in results.read_text("utf-8").splitlines() if line.startswith("## ")]
    assert [", on a GPU, " in title for title in titles] == [True, False]
