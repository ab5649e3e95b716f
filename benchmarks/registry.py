"""All benchmarks: what each measures, about how many minutes it takes on two cores, and the function that makes its
tables, whose annotated parameters are the options of its command.

A program is a package that ``python -m`` runs; what it measures is recorded in its ``RESULTS.md``.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_origin

import typer
from rich.table import Table

from etendue.core import EtendueError, use_variant

from .measuring import ROOT, Record, console, machine, software


@dataclass(frozen=True)
class Benchmark:
    """A command of a program."""

    name: str
    function: str  #: module.name inside the program's package; returns a table or several
    minutes: int
    measures: str
    in_all: bool = True  #: whether it runs when no command is given
    recorded: bool = True


@dataclass(frozen=True)
class Program:
    """A package of benchmarks."""

    package: str
    about: str
    benchmarks: tuple[Benchmark, ...]

    @property
    def results(self) -> Path:
        """Where tables are recorded."""
        return ROOT.joinpath(*self.package.split("."), "RESULTS.md")

    @property
    def minutes(self) -> int:
        """Of all that run when no command is given."""
        return sum(benchmark.minutes for benchmark in self.benchmarks if benchmark.in_all)


PROGRAMS = {
    program.package: program
    for program in (
        Program(
            "benchmarks",
            "Speed, memory and quality of the methods.",
            (
                Benchmark("theses", "theses.measure", 60, "Every experiment of the theses, small.", in_all=False),
                Benchmark("cost", "cost.measure", 2, "Seconds of a pass, and of settings, relative to Mitsuba's path."),
                Benchmark("renders", "renders.measure", 1, "Pictures of one sample by mi.render, prepared and anew."),
                Benchmark("first-pass", "fresh.first_pass", 1, "The first pass, with and without compiled kernels."),
                Benchmark("start", "fresh.start", 6, "From the command to the picture, beside Mitsuba's path."),
                Benchmark("gathers", "compiling.gathers", 3, "Gather instructions, on AMD processors before Zen 4."),
                Benchmark("optimised", "compiling.optimised", 3, "Kernels that LLVM does or does not optimise."),
                Benchmark("memory", "fresh.memory", 1, "Peak memory of a fresh process."),
                Benchmark("scale", "scale.measure", 6, "A thousand lamps or textures, ten million triangles."),
                Benchmark("media", "media.measure", 25, "Error in fog and water beside Mitsuba's volpath."),
                Benchmark("prism", "spectral.prism", 15, "Error in the spectrum of a prism after a given time."),
                Benchmark("cost-spectral", "spectral.cost", 3, "Seconds of a pass with wavelengths, beside RGB."),
                Benchmark("daylight", "daylight.measure", 3, "Daylight coefficients beside rfluxmtx.", in_all=False),
                Benchmark("lux-grid", "daylight.grid", 4, "10,000 points in a room under an overcast sky."),
                Benchmark("rays", "rays.measure", 1, "Share of ray casting in a pass."),
                Benchmark("quality", "quality.measure", 30, "Error after a given time, for every method."),
                Benchmark("choice", "choice.measure", 60, "Error of auto beside its candidates."),
                Benchmark("brief", "brief.measure", 20, "Error of auto in a few seconds, cold, beside other methods."),
                Benchmark("smallvcm", "smallvcm.measure", 30, "auto beside SmallVCM, on its scenes.", in_all=False),
                Benchmark("tuning", "tuning.measure", 300, "Error of auto beside other methods.", in_all=False),
                Benchmark("tuning-choice", "tuning.choices", 10, "What auto chooses, beside others.", in_all=False),
                Benchmark("auto-costs", "auto_costs.measure", 8, "The cost model of auto, fitted.", in_all=False),
                Benchmark("mitsuba-path", "mitsuba_path.measure", 90, "path beside Mitsuba's path.", in_all=False),
                Benchmark("filters", "filters.measure", 3, "Cost of a pass by filter, and edges after few samples."),
                Benchmark("layers", "layers.measure", 3, "Cost of layers of first hits and of components."),
                Benchmark("mipmaps", "mipmaps.measure", 2, "Textures averaged over the footprint of a pixel."),
                Benchmark("filters-display", "denoising.filters", 1, "Time of the filters of pictures."),
                Benchmark(
                    "denoise", "denoised.measure", 38, "Denoised after 5 s against raw after 40 s.", in_all=False
                ),
                Benchmark(
                    "few-samples", "denoised.few_samples", 15, "relMSE after few samples, denoised.", in_all=False
                ),
                Benchmark("learned-light", "learned_light.measure", 75, "Learned light: on beside off.", in_all=False),
                Benchmark("viewer", "viewing.measure", 2, "Pictures a second of the viewer while its camera moves."),
                Benchmark("cie171", "cie171.suite.measure", 15, "The analytic test cases of CIE 171:2006: meters."),
                Benchmark("windows", "windows.measure", 25, "Sun and sky through windows, beside Mitsuba's path."),
                Benchmark("guided", "guided.measure", 13, "Error times time of guided, beside path."),
                Benchmark("ground-lamps", "grounds.lamps", 3, "A lamp beside a sky, on walls of several sizes."),
                Benchmark("ground-merging", "grounds.merging", 6, "Bias of merging, on grounds of several sizes."),
                Benchmark("fireflies", "fireflies.measure", 12, "Error with and without re-weighting.", in_all=False),
                Benchmark("ambient", "ambient.measure", 12, "Paths that end in an ambient term, beside whole paths."),
                Benchmark("irradiance", "irradiance.measure", 3, "Irradiance caching beside path: error and CPU time."),
                Benchmark("workers", "workers.measure", 7, "Worker processes beside unconnected ones.", in_all=False),
                Benchmark("knn", "neighbours.measure", 1, "A kd-tree and nearest neighbours, beside scipy's cKDTree."),
                Benchmark("samplers", "samplers.measure", 3, "path by each sampler: error at equal samples, patterns."),
                Benchmark("points", "sequences.measure", 1, "Points of sequences a second, beside scipy's qmc."),
                Benchmark("integration", "integrals.measure", 1, "Vegas beside the vegas package: errors and speed."),
                Benchmark("divisions", "divisions.measure", 3, "The dimension that recursive stratification divides."),
                Benchmark("density", "densities.measure", 1, "Density estimates in the plane, beside gaussian_kde."),
                Benchmark("radiosity", "exchanges.measure", 2, "Segments of global lines: cast, replayed and solved."),
                Benchmark("view-factors", "view_factors.measure", 5, "View factors, beside pyViewFactor and View3D."),
                Benchmark("exact-factors", "exact_factors.measure", 1, "Exact form factors of meshes, beside View3D."),
                Benchmark("cities", "cities.measure", 5, "Form factors of cities of 24 to 100,000 facets."),
            ),
        ),
        Program(
            "benchmarks.vcm_thesis",
            "The experiments of the thesis on vertex connection and merging.",
            (
                Benchmark("reference", "references.remake", 4, "Render the references anew.", recorded=False),
                Benchmark("correctness", "correctness.measure", 10, "vcm and bpt minus path: noise, or structure?"),
                Benchmark("convergence", "convergence.measure", 25, "Error of vcm, bpt, bpm and path over time."),
                Benchmark("profile", "profile.measure", 2, "What a pass of vcm is made of."),
                Benchmark(
                    "radius", "sweeps.radius", 7, "5, 12 and 25 mm, with and without merging at the first vertex."
                ),
                Benchmark("photons", "sweeps.photons", 6, "Four times the light paths against twice the radius."),
                Benchmark("radii", "sweeps.radii", 2, "What further radii in the same run cost."),
                Benchmark("parts", "parts.measure", 6, "What merging and connecting find, early and late."),
                Benchmark("combined", "parts.combined", 8, "Pictures of several radii together, beside the best."),
            ),
        ),
        Program(
            "benchmarks.adaptive",
            "The experiments of the thesis on adaptive path tracing.",
            (
                Benchmark("reference", "entrants.remake", 4, "Render the references anew.", recorded=False),
                Benchmark("sine", "sine.measure", 1, "VEGAS on the sine: what smoothing and damping do."),
                Benchmark("convergence", "convergence.over_samples", 9, "Errors over samples and time, and pictures."),
                Benchmark("equal-time", "convergence.equal_time", 7, "Errors and pictures after the same time."),
                Benchmark("warm-up", "convergence.warm_up", 2, "From how many samples on VEGAS beats random paths."),
                Benchmark("single", "single.measure", 1, "One path an evaluation against one of each length."),
                Benchmark("plans", "plans.measure", 5, "Plans of stratified: reuse, and shares by cost."),
            ),
        ),
        Program(
            "benchmarks.light_chains",
            "Metropolis particles beside independent light paths, and ways to sample emission.",
            (
                Benchmark("against", "against.measure", 10, "Standard and Metropolis particles: who wins where."),
                Benchmark("steps", "steps.measure", 4, "The size of steps of Metropolis particles."),
                Benchmark("emission", "emission.measure", 3, "Variance of flux by the way lights are sampled."),
                Benchmark("distributions", "distributions.measure", 1, "Where particles lie, and how often repeated."),
            ),
        ),
        Program(
            "benchmarks.cluster",
            "How far clusters scale, and the experiments of a thesis on parallel tracing.",
            (
                Benchmark("simulate", "scaling.measure", 4, "1 to 10,000 workers under a simulated clock."),
                Benchmark("schedules", "scaling.schedules", 1, "Static, on demand, stealing: 1 to 16 processors."),
                Benchmark("processes", "processes.measure", 3, "E3 on processes of this machine, beside simulation."),
                Benchmark("coherence", "boxes.coherence", 1, "Boxes that paths visit, random and in strata."),
                Benchmark("voxels", "voxels.measure", 2, "Directions by occupied voxels, beside strata."),
                Benchmark("divided", "boxes.divided", 3, "A scene in boxes: what is sent, and whether it is the same."),
            ),
        ),
        Program(
            "benchmarks.maps",
            "Maps of irradiance from particles.",
            (
                Benchmark("errors", "errors.measure", 12, "Error of each kind of map, in the dark and in caustics."),
                Benchmark("cost", "errors.cost", 3, "CPU time to build maps and to ask them."),
            ),
        ),
        Program(
            "benchmarks.particles",
            "Files of particles, and the experiments of a thesis on their compression.",
            (
                Benchmark("codecs", "codecs.measure", 3, "Bytes and speed of every codec of particles."),
                Benchmark("maps", "maps.measure", 3, "What bounded loss adds to maps, beside their noise."),
                Benchmark("thesis", "thesis.measure", 2, "Rows and strips by zlib, bzip2 and runs; saving, loading."),
                Benchmark("chains", "chains.measure", 3, "The same of real chains, by the size of their steps."),
            ),
        ),
        Program(
            "benchmarks.metropolis",
            "Pictures by Metropolis sampling beside independent paths.",
            (
                Benchmark("pictures", "pictures.measure", 200, "Error after equal time of chains, path and bpt."),
                Benchmark("cures", "cures.measure", 5, "Cures of chains that are drawn to lights which are seen."),
                Benchmark("mixtures", "mixtures.measure", 5, "Small steps of several sizes in one run, beside one."),
                Benchmark("steps", "steps.measure", 4, "The size of steps of film Metropolis."),
                Benchmark("strategies", "steps.strategies", 3, "Light paths, camera paths, pairs of both on the film."),
            ),
        ),
        Program(
            "benchmarks.radiosity",
            "The experiments of the thesis on global lines.",
            (
                Benchmark("sequences", "sequences.measure", 7, "Error of multipath over lines, by point sequence."),
                Benchmark("generators", "generators.measure", 2, "The four generators of global lines."),
                Benchmark("direct", "sequences.direct", 1, "What sequences gain for direct light and for all light."),
                Benchmark("estimators", "estimators.measure", 1, "The estimators F1 to F4 on the same lines."),
                Benchmark("hemicube", "hemicube.measure", 1, "Hemicubes beside local lines and global lines."),
                Benchmark("ambient", "ambient.measure", 2, "Ambient terms: their errors, their time, pictures."),
                Benchmark("finishing", "ambient.finishing", 1, "Solvers that stop early, with and without the terms."),
                Benchmark("hierarchy", "hierarchy.measure", 8, "Form factors by lines in a hierarchy of spheres."),
                Benchmark("box-tests", "boxes.tests", 1, "Ray-polygon tests of multipath with and without boxes."),
                Benchmark("box-memory", "boxes.memory", 1, "Bytes of the lists of lines around boxes and in them."),
                Benchmark("box-errors", "boxes.errors", 10, "Error of multipath with boxes, by point sequence."),
                Benchmark("box-bias", "boxes.bias", 3, "The bias of boxes, by distance and resolution."),
                Benchmark("box-shares", "shares.measure", 4, "Lines of boxes by fixed shares, area and information."),
                Benchmark("box-regions", "resolutions.measure", 6, "Regions of boxes: what they tell, and errors."),
                Benchmark("hall", "halls.against_flat", 2, "Copies of a desk against a flat solution."),
                Benchmark("hall-inside", "halls.inside", 3, "Desks inside a large hall against flat blocks."),
                Benchmark("hall-1000", "halls.thousand", 3, "A thousand desks of 10,000 patches: time and memory."),
                Benchmark("box-choice", "choice.measure", 20, "A-buffer, rays, hierarchy and boxes to one error."),
            ),
        ),
    )
}


def main(package: str) -> None:
    """Run a program. An error on purpose is a line on stderr."""
    # Processes that are timed find Python's modules compiled, as those of users do after the first one.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    try:
        command_line(PROGRAMS[package])()
    except EtendueError as error:
        raise SystemExit(str(error)) from None


def command_line(program: Program) -> typer.Typer:
    """The commands of a program. Without a command it runs them in turn, with their default options."""
    app = typer.Typer(
        help=f"{program.about} Run on an idle machine; without a command all are run, {program.minutes} minutes.",
        add_completion=False,
        pretty_exceptions_enable=False,
    )
    taken: dict[str, dict[str, inspect.Parameter]] = {}
    for benchmark in program.benchmarks:
        command = _command(program, benchmark)
        taken[benchmark.name] = dict(inspect.signature(command).parameters)
        app.command(benchmark.name, help=f"{benchmark.measures} About {benchmark.minutes} min.")(command)
    app.command("list")(_list)
    shared = {name: p for own in taken.values() for name, p in own.items() if name in ("variant", "record", "out")}

    def everything(context: typer.Context, **given: Any) -> None:
        sources = [context.get_parameter_source(name) for name in given]
        if context.invoked_subcommand is not None and any(s is not None and s.name == "COMMANDLINE" for s in sources):
            raise typer.BadParameter(f"options of one benchmark stand after its name, '{context.invoked_subcommand}'")
        for benchmark in program.benchmarks:
            if benchmark.in_all and context.invoked_subcommand is None:
                words = [benchmark.name]
                for name, value in given.items():
                    if name in taken[benchmark.name] and value:
                        words += [f"--{name}"] if value is True else [f"--{name}", str(value)]
                typer.main.get_command(app).main(words, standalone_mode=False)

    first = _option("context", typer.Context, inspect.Parameter.empty)
    app.callback(invoke_without_command=True)(_taking(everything, [first, *shared.values()]))
    return app


def _command(program: Program, benchmark: Benchmark) -> Callable[..., None]:
    """The function of a benchmark as a command: it sets the variant, and prints and records what is measured."""
    module, _, name = benchmark.function.rpartition(".")
    function: Callable[..., Record | Iterable[Record]] = getattr(import_module(f"{program.package}.{module}"), name)
    found = inspect.signature(function, eval_str=True).parameters.values()
    own = [parameter for parameter in found if get_origin(parameter.annotation) is Annotated]
    where = program.results.relative_to(ROOT)
    variant = typer.Option(help="Mitsuba variant; by default CUDA where usable, else LLVM.")
    record = typer.Option("--record", help=f"Append the tables to {where}.")
    common = [
        _option("variant", Annotated[str | None, variant], None),
        _option("record", Annotated[bool, record], False),
    ]

    def run(variant: str | None, record: bool = False, **options: Any) -> None:
        chosen = use_variant(variant)
        console.print(f"{machine()}; {software(chosen)}\n", style="dim")
        made = function(**options)
        for table in [made] if isinstance(made, Record) else made:
            table.publish(chosen, program.results if record else None)

    return _taking(run, [*own, *common[: 2 if benchmark.recorded else 1]])


def _option(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)


def _taking(function: Callable[..., None], parameters: Sequence[inspect.Parameter]) -> Callable[..., None]:
    """The function, said to take these, which typer makes options of."""
    parameters = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return function


def _list() -> None:
    """Show every benchmark of every program: what it measures, its minutes, and where it is recorded."""
    for program in PROGRAMS.values():
        title = f"python -m {program.package}: {program.minutes} minutes in all; {program.results.relative_to(ROOT)}"
        table = Table("", "minutes", "measures", title=title, title_justify="left", box=None, pad_edge=False)
        for benchmark in program.benchmarks:
            note = "" if benchmark.in_all else " Only by name."
            table.add_row(benchmark.name, str(benchmark.minutes), benchmark.measures + note)
        console.print(table, "")
