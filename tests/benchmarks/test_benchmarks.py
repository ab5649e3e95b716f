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
from typer.testing import CliRunner

from etendue import methods, scene
from etendue.core import OptionError, Replica

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _benchmarks_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


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


def test_tasks_take_turns():
    calls = []
    tasks = {name: lambda number, name=name: calls.append((number, name)) for name in "ab"}
    times = module("measuring").interleaved(tasks, rounds=2, warm_up=1)
    assert calls == [(0, "a"), (0, "b"), (1, "a"), (1, "b"), (2, "a"), (2, "b")]
    assert [len(clocks) for clocks in times.values()] == [2, 2]
    assert all(clock.wall >= 0 and clock.cpu >= 0 for clocks in times.values() for clock in clocks)


def test_settings_of_the_cost_benchmark_exist():
    assert module("measuring").COST_SETTINGS.keys() == methods.table().keys()
    for name, settings in module("measuring").COST_SETTINGS.items():
        methods.get(name).Settings(**settings)


def test_variants_of_settings_take_turns_with_their_method():
    cost = module("cost")
    variants = [cost.Variant.parse(text) for text in ("bpt", "bpt:split_layers=true:rr_depth=3", "path:mode=mis")]
    record = cost.measure(variants, (16, 16), rounds=2, warm_up=1)
    rows = {row[0]: row for row in record.rows}
    assert list(rows) == [
        "Mitsuba path",
        "bpt",
        "bpt, roulette as Mitsuba",
        "bpt split_layers=true rr_depth=3",
        "path mode=mis",
    ]
    assert record.columns[-1] == "to the method without"
    assert [name for name, row in rows.items() if row[-1]] == ["bpt split_layers=true rr_depth=3"]
    ratio = float(rows["bpt split_layers=true rr_depth=3"][-1].split()[0])
    assert ratio > 0.0
    assert "to the method without" not in cost.measure(variants[:1], (8, 8), rounds=1, warm_up=1).columns


def test_filters_take_turns():
    record = module("filters").cost(["path"], 8, rounds=2)
    (row,) = record.rows
    assert row[0] == "path" and all(0.1 < float(cell.split()[0]) < 10.0 for cell in row[3:6])


def test_short_renders_take_turns():
    record = module("renders").measure(["light"], (8, 8), rounds=2, warm_up=1)
    assert [row[0] for row in record.rows] == ["Mitsuba path", "light", "light, prepared anew"]
    assert all(float(row[1]) > 0.0 for row in record.rows)


@pytest.mark.slow
def test_guiding_is_compared_seed_by_seed():
    (record,) = module("guided").measure(["ajar"], (12, 12), 0.3, 2, ["cell_samples=200"])
    assert [row[0] for row in record.rows] == ["Mitsuba path", "path", "guided"]
    assert float(record.rows[0][6]) == 1.0
    assert "0.333" in record.rows[2][7]
    assert all(float(row[1]) > 0.0 and float(row[5]) >= 1.0 for row in record.rows)
    assert "cell_samples=200" in record.notes[-1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vmc", "did you mean 'vcm'"),
        ("vcm:split_layer=1", "method 'vcm' has no option 'split_layer'; did you mean 'split_layers'"),
        ("vcm:split_layers", "vcm needs name=value"),
        ("vcm:split_layers=maybe", "'split_layers' must be true or false"),
    ],
)
def test_a_variant_that_does_not_exist(text, message):
    with pytest.raises(OptionError, match=message):
        module("cost").Variant.parse(text)


@pytest.mark.parametrize("name", ["path", "bpt", "vcm"])
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


def test_a_record_is_appended(tmp_path, monkeypatch):
    measuring = module("measuring")
    monkeypatch.setattr(
        sys,
        "argv",
        [str(measuring.ROOT / "benchmarks" / "__main__.py"), "cost", "--out", "a/b", "--size", "8x8", "--out=c"],
    )
    for number in (0, 1, 0):
        record = measuring.Record(f"Table {number}", ("", "a|b"))
        record.add("vcm", "1.0")
        record.notes.append("a note")
        record.publish("llvm_ad_rgb", tmp_path / "RESULTS.md")
    text = (tmp_path / "RESULTS.md").read_text("utf-8")
    assert text.count("## Table 0") == 1 and text.index("## Table 1") < text.index("## Table 0")
    assert "| vcm | 1.0 |" in text and "a\\|b" in text and "- a note" in text
    assert "`python -m benchmarks cost --size 8x8`" in text and "mitsuba" in text


@pytest.mark.parametrize(("value", "words"), [(2.8, "reached"), (2.81, "missed")])
def test_bars(value, words):
    assert module("measuring").verdict(value, 2.8).endswith(words)


def test_settings_of_quality_are_those_of_the_command_line(monkeypatch):
    """``METHOD.NAME`` is for one method, and a name that no method has is an error, not left out."""
    quality = module("quality")
    given = []
    picture = np.ones((4, 4, 3), np.float32)

    def render(source, name, **options):
        given.append((name, {k: v for k, v in options.items() if k not in ("seconds", "size", "seed")}))
        facts = {"seconds": 1.0, "samples": 1, "passes": 1, "rays": 1.0}
        return types.SimpleNamespace(image=picture, metadata=facts)

    monkeypatch.setattr(quality, "render", render)
    monkeypatch.setattr(quality, "find", lambda name, size: quality.Case(name, name, picture, "a note"))
    define = ["vcm.radius=1", "radius=3", "max_dept=2"]
    assert len(list(quality.measure(["x"], ["path", "vcm"], (4, 4), 1.0, 1, define))) == 1
    assert given == [("path", {"max_dept": "2"}), ("vcm", {"radius": "1"})]


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


def test_choice_holds_auto_against_its_best_candidate(monkeypatch):
    """The error of the reference is taken off, the median over seeds counts, the ratio is to the best candidate."""
    choice = module("choice")
    offsets = {"path": 0.3, "bpt": 0.1, "bpt with 6 connections": 0.2, "vcm": 0.4, "learn": 0.11}
    assert offsets.keys() == {*choice.FIXED, "learn"}

    def render(source, method, *, seconds, size, seed, radius):
        """Halves of the reference, 1 on average."""
        assert method == "vcm"
        image = np.full((8, 8, 3), {1000: 1.02, 1001: 0.98}[seed], np.float32)
        return types.SimpleNamespace(image=image)

    filled = set()

    def in_a_process(command, options, environment):
        folder, choice = Path(options["out"]).parent, options.get("choice")
        assert environment["DRJIT_CACHE_DIR"] == str(folder)
        if options["seconds"] < 1.0:
            filled.add((folder, choice))
        elif choice in offsets:
            assert {(folder, name) for name in offsets if name != "learn"} <= filled, "kernels were to be there"
        extreme = 50.0 if choice and options["seed"] == 2 else 1.0  # one seed of three
        offset = offsets[choice] if choice else {"path": 0.2, "auto": 0.1}[options["method"]]
        np.save(options["out"], np.full((8, 8, 3), 1.0 + extreme * offset, np.float32))
        samples = {"learn": 6, "bpt": 8}.get(choice, 10)
        return {"samples": samples, "chosen": "bpt" if choice else options["method"]}

    monkeypatch.setattr(choice, "render", render)
    monkeypatch.setattr(choice, "child", in_a_process)
    warm, cold = choice.measure(["cornell-box"], pixels=64, seconds=1.0, seeds=3, cold=5.0)
    row = warm.rows[0]
    own = 0.02**2 / 1.01
    expected = [offset**2 / 1.01 - own for offset in offsets.values()]
    assert [float(cell) for cell in row[1:6]] == pytest.approx(expected, rel=0.01)
    ratio = expected[-1] / expected[1]
    assert row[6:] == ("bpt", f"{ratio:.2f}", choice.verdict(ratio, 1.2), "0.75", "≥ 0.7: reached")
    assert cold.rows[0][3:] == ("auto", "0.24", "≤ 1.3: reached")  # (0.1² - own) / (0.2² - own)
    with pytest.raises(SystemExit, match="no test scene 'nowhere'"):
        choice.measure(["nowhere"], pixels=64, seconds=1.0, seeds=1)


@pytest.mark.slow
def test_the_radiosity_benchmark_counts_and_solves():
    record = module("exchanges").measure([3], 64, 500.0, ["compiled", "drjit"])
    columns, other = (dict(zip(record.columns, row, strict=True)) for row in record.rows)
    assert (columns["backend"], other["backend"]) == ("compiled", "drjit")
    assert columns["segments"] == other["segments"]
    assert columns["patches"] == "86" and 0 < float(columns["error"]) < 0.1


@pytest.mark.slow
def test_the_view_factor_benchmark_measures_lines_and_says_how_to_get_the_others(monkeypatch):
    view_factors = module("view_factors")
    monkeypatch.setattr(view_factors, "_RUNS", 2)
    monkeypatch.setattr(view_factors, "_BUNDLES", 256)
    record = view_factors.measure([4], 256, 4000, None, None)
    assert [row[0] for row in record.rows] == ["lines", "lines, cold"]
    for row in record.rows:
        columns = dict(zip(record.columns, row, strict=True))
        assert 0 < float(columns["F J error"]) < 0.1 and 0 < float(columns["error"]) < 0.1
    assert any("how to install it" in note for note in record.notes)


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
