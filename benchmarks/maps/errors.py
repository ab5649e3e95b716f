"""Errors and times of every kind of map of the same particles."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import typer

from etendue import trace_particles
from etendue.core import Array
from etendue.particles import Particles
from etendue.products.particles import MadeMap, MapOptions, make_map
from etendue.scene import Problem, bundled_scene, load
from etendue.surfaces import (
    HistogramBuilder,
    KernelBuilder,
    MapSurfaces,
    irradiance_at,
    rule_bandwidths,
    variable_bandwidths,
)

from ..measuring import Record, spread
from ..options import Names, Seeds

#: Particles of the reference, relative to those of a map, and the passes in which they are traced.
_MORE, _PASSES = 100, 20
#: Shares of the area that count as bright and as dark.
_BRIGHT, _DARK = 0.05, 0.5

Particle = Annotated[int, typer.Option("--particles", min=1000, help="Particles of a map.")]
Cell = Annotated[int, typer.Option("--cells", min=100, help="Cells of the reference and of kernel maps.")]


def _problem(name: str) -> Problem:
    return load(bundled_scene(name) or name, check=False)


def _traced(problem: Problem, particles: int, seed: int) -> Particles:
    found = trace_particles(problem.scene, particles=particles, seed=seed).particles
    assert found is not None
    return found


def kinds(cells: int) -> dict[str, Callable[[Problem, MapSurfaces, Particles], Any]]:
    """How each map is made: (scene, cells, particles) -> map. The kernel after the variable one has its mean width."""

    def histogram(count: int) -> Callable[..., Any]:
        return lambda p, s, hits: make_map(p, hits, MapOptions("histogram", count)).map

    def fixed(rule: Any) -> Callable[..., Any]:
        return lambda p, s, hits: _kernels(s, hits, rule_bandwidths(s, hits, rule))

    def neighbours(k: int) -> Callable[..., Any]:
        return lambda p, s, hits: make_map(p, hits, MapOptions("knn", cells, k=k)).map

    return {
        f"histogram, {cells} cells": histogram(cells),
        f"histogram, {cells // 8} cells": histogram(cells // 8),
        "kernel, silverman": fixed("silverman"),
        "kernel, cross-validation": fixed("cross-validation"),
        "variable, cross-validation": lambda p, s, hits: _kernels(s, hits, _variable(s, hits)),
        "kernel, mean width of variable": lambda p, s, hits: _kernels(s, hits, _mean_width(s, hits)),
        "knn, k = 50": neighbours(50),
        "knn, k = 200": neighbours(200),
    }


def _kernels(surfaces: MapSurfaces, hits: Particles, widths: Any) -> Any:
    builder = KernelBuilder(surfaces, widths)
    builder.add(hits)
    return builder.build()


def _variable(surfaces: MapSurfaces, hits: Particles) -> Array:
    widths = rule_bandwidths(surfaces, hits, "cross-validation")
    return variable_bandwidths(_kernels(surfaces, hits, widths), widths)


def _mean_width(surfaces: MapSurfaces, hits: Particles) -> Array:
    """For each shape the mean of the widths of the variable kernels of its particles."""
    located = surfaces.located(hits)
    cell = surfaces.cell_of(*surfaces.uploaded(located))
    cell = cell[cell >= 0]
    found = KernelBuilder(surfaces, _variable(surfaces, hits)).bandwidths
    weights = np.bincount(cell, minlength=len(found)).astype(float) + 1e-9
    total, count = (np.bincount(surfaces.shapes, x) for x in (weights * found, weights))
    return (total / np.maximum(count, 1e-30))[surfaces.shapes]


def measure(
    scenes: Names = "cornell-box,caustics",  # type: ignore[assignment]
    particles: Particle = 100_000,
    cells: Cell = 20_000,
    seeds: Seeds = 3,
    shapes: Annotated[
        str, typer.Option(help="Shapes on which errors count, separated by commas; all by default.", metavar="NAMES")
    ] = "",
) -> Iterator[Record]:
    """Root mean square errors of all maps, on all surfaces, the darker half and the brightest twentieth of the area."""
    for name in scenes:
        problem = _problem(name)
        surfaces = MapSurfaces(problem, cells)
        patches = surfaces.patches
        builder = HistogramBuilder(surfaces)
        for part in range(_PASSES):
            builder.add(_traced(problem, particles * _MORE // _PASSES, 1000 + part))
        builder.power /= _PASSES
        reference = builder.build()
        light = reference.values.mean(axis=1)
        wanted = [k for k, shape in enumerate(patches.shape_names) if not shapes or shape in shapes.split(",")]
        # Backs of walls get no light at all; they would be the dark half.
        everywhere = np.isin(surfaces.shapes, wanted) & (light > 0)
        order = np.argsort(light)
        order = order[everywhere[order]]
        below = np.cumsum(patches.areas[order]) / patches.areas[order].sum()
        dark, bright = np.zeros_like(everywhere), np.zeros_like(everywhere)
        dark[order[below < _DARK]], bright[order[below > 1 - _BRIGHT]] = True, True
        regions = {"all": everywhere, "dark": dark, "bright": bright}

        def error(values: Array, region: Any) -> float:
            weight = patches.areas[region, None]  # noqa: B023
            truth, noise = reference.values[region], reference.errors[region]  # noqa: B023
            squares = (values[region] - truth) ** 2 - noise**2
            return float(np.sqrt(max((weight * squares).sum(), 0.0) / (weight * truth**2).sum()))

        errors: dict[str, dict[str, list[float]]] = {}
        for seed in range(seeds):
            hits = _traced(problem, particles, seed)
            for kind, make in kinds(cells).items():
                made = make(problem, surfaces, hits)
                values, _ = irradiance_at(made, patches.centres, patches.normals)
                of_kind = errors.setdefault(kind, {region: [] for region in regions})
                for region, mask in regions.items():
                    of_kind[region].append(error(np.nan_to_num(values), mask))
        where = f" on {shapes}" if shapes else ""
        title = f"Maps of {particles} particles of {name}: relative RMS error of the irradiance{where}"
        record = Record(title, ("map", *regions))
        for kind, of_kind in errors.items():
            record.add(kind, *(spread(of_kind[r], ".4f") for r in regions))
        count = builder.particles
        noise = error_of_reference(reference, patches.areas * everywhere)
        record.notes.append(
            f"{seeds} seeds, median and range; reference: a histogram of {count} particles in {len(patches)} cells, "
            f"whose own noise of {noise:.4f} is subtracted; dark: the half of the lit area with least light, bright: "
            f"the {_BRIGHT:.0%} with most"
        )
        yield record


def error_of_reference(reference: Any, areas: Array) -> float:
    """Relative noise of the reference."""
    return float(np.sqrt((areas[:, None] * reference.errors**2).sum() / (areas[:, None] * reference.values**2).sum()))


def cost(
    scenes: Names = "cornell-box",  # type: ignore[assignment]
    particles: Particle = 1_000_000,
    cells: Cell = 20_000,
    queries: Annotated[int, typer.Option(min=1, help="Points at which maps are asked.")] = 200_000,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds, after one that compiles.")] = 3,
) -> Iterator[Record]:
    """CPU seconds, of all threads, to build every map and to ask it at points of the surfaces, in turn."""
    for name in scenes:
        problem = _problem(name)
        hits = _traced(problem, particles, 1)
        surfaces = MapSurfaces(problem, queries)
        pick = np.random.default_rng(1).permutation(len(surfaces.patches))[:queries]
        points, normals = surfaces.patches.centres[np.sort(pick)], surfaces.patches.normals[np.sort(pick)]
        options = {
            "histogram": MapOptions("histogram", cells),
            "kernel": MapOptions("kernel", cells),
            "variable": MapOptions("variable", cells),
            "knn, k = 50": MapOptions("knn", cells),
        }
        times: dict[str, list[tuple[float, float]]] = {kind: [] for kind in options}
        for _ in range(rounds + 1):
            for kind, chosen in options.items():
                begin = time.process_time()
                made: MadeMap = make_map(problem, hits, replace(chosen))
                built = time.process_time()
                irradiance_at(made.map, points, normals)
                times[kind].append((built - begin, time.process_time() - built))
        title = f"Maps of {len(hits)} particles of {name}, asked at {len(points)} points: CPU seconds"
        record = Record(title, ("map", "build", "query", "build, relative to histogram"))
        base = statistics.median(build for build, _ in times["histogram"][1:])
        for kind, found in times.items():
            build, query = ([pair[k] for pair in found[1:]] for k in (0, 1))
            record.add(kind, spread(build, ".3g"), spread(query, ".3g"), f"{statistics.median(build) / base:.2f}")
        record.notes.append(f"{rounds} rounds after one; {cells} cells; the surfaces and their cells are made anew")
        yield record
