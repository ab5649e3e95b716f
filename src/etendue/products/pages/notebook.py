"""HTML of results, sessions and running work for notebooks."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.core import Array, Progress, describe, format_rate
from etendue.display import Figure, card, false_colour, number_text, time_text, tonemap
from etendue.film import BANDS

from .meshviews import mesh_views, on_pixels, seen_patches

#: Size of the pictures of a mesh.
_SIZE = 400, 300
#: Seconds between updates of the progress of a run.
_EVERY = 0.3
#: Largest number of layers of a result that are named.
_LAYERS = 6


def html_of(thing: Any) -> str | None:
    """HTML of a result, a session, a solution and so on; ``None`` for an unknown class."""
    for kind in type(thing).__mro__:
        if kind.__name__ in _CARDS:
            return _CARDS[kind.__name__](thing)
    return None


# ---------------------------------------------------------------- pictures


def _result(result: Any) -> str:
    """A picture with its metadata, and the names of its layers."""
    known, image = result.metadata, result.layers.get("image")
    facts = _of_run(known)
    if image is None:
        return card("Result", {**facts, "layers": ", ".join(result.layers) or "none"})
    height, width = image.shape[:2]
    layers = [name for name in result.layers if name != "image"]
    if layers:
        more = f" and {len(layers) - _LAYERS} more" if len(layers) > _LAYERS else ""
        facts["layers"] = ", ".join(layers[:_LAYERS]) + more
    return card(f"{known.get('method', 'picture')}, {width} × {height}", facts, _figures(image, "picture", known))


def _figures(image: Any, alt: str, known: Mapping[str, Any]) -> list[Figure]:
    """The picture; none of one whose channels are bands, not colours, as the metadata ``known`` say."""
    return [Figure(tonemap(image, "auto"), alt, "")] if image.shape[2] == 3 and BANDS not in known else []


def _of_run(known: Mapping[str, Any]) -> dict[str, Any]:
    facts: dict[str, Any] = {}
    for name, text in (("scene", str), ("passes", int), ("samples", int), ("seconds", lambda s: time_text(float(s)))):
        if known.get(name) is not None:
            facts["samples per pixel" if name == "samples" else name] = text(known[name])
    if known.get("error") is not None:
        facts["error"] = number_text(float(known["error"]))
    if known.get("seconds") and known.get("rays"):
        facts["speed"] = format_rate(float(known["rays"]) / float(known["seconds"]))
    if known.get("nonfinite"):
        facts["contributions not finite"] = int(known["nonfinite"])
    return facts


def _session(session: Any) -> str:
    """The progress of a run with its current picture; after its end, its result or its error."""
    if not session.running:
        try:
            result = session.result
        except Exception as error:
            return card("Session", {}, status=f"failed: {describe(error)}")
        html = html_of(result)
        return html if html is not None else card("Session", {}, status=f"done: {result!r}")
    image = session.image
    figures = [] if image is None else _figures(image, "the picture so far", {})
    return card("Session", {}, figures, **_progress(session.progress, session.prepared))


def _progress(progress: Progress, prepared: bool = True) -> dict[str, Any]:
    if not progress.passes:
        return {"status": "first pass, compiling" if prepared else "loading the scene"}
    return {"status": str(progress), "fraction": progress.fraction}


# ---------------------------------------------------------------- radiosity


def _solution(solution: Any, more: Mapping[str, Any] | None = None, title: str = "Radiosity") -> str:
    """The mesh with its radiosities, seen from both sides."""
    facts = {
        **(more or {}),
        "patches": len(solution.patches),
        "iterations": len(solution.residuals) or None,
        "residual": f"{solution.residual:.2g}" if solution.residuals else None,
        "imbalance of power": f"{100 * solution.imbalance:.2g} %",
    }
    radiosity = solution.radiosity
    colours = radiosity if radiosity.shape[1] == 3 else radiosity.mean(axis=1)
    return card(title, facts, _mesh(solution.patches, colours))


def _mesh(patches: Any, values: Array) -> list[Figure]:
    """Views from outside: colours of (n, 3) values by a tone curve, of (n,) in false colours."""
    figures, shown = [], []
    for view in mesh_views(patches, None, _SIZE[0] / _SIZE[1]):
        shown.append((view.name, on_pixels(values, seen_patches(patches, view, _SIZE))))
    if values.ndim == 2:
        return [Figure(tonemap(pixels, "auto"), f"mesh, {name}", name) for name, pixels in shown]
    positive = values[values > 0.0]
    low, high = np.percentile(positive, [1.0, 99.0]) if positive.size else (0.1, 1.0)
    for name, pixels in shown:
        figures.append(Figure(false_colour(pixels, 0.99 * low, 1.01 * high), f"mesh, {name}", name))
    return figures


def _patches(patches: Any) -> str:
    facts = {
        "patches": len(patches),
        "faces": len(patches.faces),
        "area": number_text(float(patches.areas.sum())),
        "channels": patches.channels,
        "emitters": int((patches.emission > 0).any(axis=1).sum()),
    }
    reflectance = patches.reflectance
    return card("Patches", facts, _mesh(patches, reflectance if patches.channels == 3 else reflectance.mean(axis=1)))


def _ended_by(reason: str, counted: str) -> str:
    """The limit or event that ended a run. ``counted``: the unit of its budget in samples."""
    words = {"seconds": "time", "samples": f"number of {counted}", "cancel": "cancelled", "failure": "an error"}
    return words.get(reason, reason)


def _solved(result: Any) -> str:
    """A result of radiosity: its picture, if it has one, and the solution."""
    counted = next((name for name in ("bundles", "passes") if getattr(result, name, 0)), "lines")
    facts: dict[str, Any] = {"ended by": _ended_by(result.stopped_by, counted), "time": time_text(result.elapsed)}
    for name in ("bundles", "points", "passes"):
        if getattr(result, name, 0):
            facts[name] = getattr(result, name)
    if result.solution is None:  # copies that were not put into one mesh
        return card("Radiosity", {**facts, "patches": result.parts.tree.total})
    error, areas = result.irradiance_error, result.patches.areas[:, None]
    light = float((areas * result.solution.irradiance).sum())
    if error is not None and light > 0.0:
        facts["standard error of irradiance"] = f"{100 * float((areas * error).sum()) / light:.2g} %"
    return _solution(result.solution, facts)


def _factors(factors: Any, more: Mapping[str, Any] | None = None) -> str:
    sums = factors.row_sums()[factors.areas > 0]
    facts = {
        **(more or {}),
        "patches": len(factors),
        "factors above zero": factors.matrix.nnz,
        "row sums with the sky": f"{sums.min():.6g} to {sums.max():.6g}",
        "standard error of a row": number_text(float(factors.row_errors().mean()), 2),
        "share of the sky": f"{100 * float((factors.areas * factors.outside).sum() / factors.areas.sum()):.3g} %",
    }
    figures = []
    if factors.matrix.nnz:
        figures = [Figure(_matrix(factors.matrix), "form factors, row over column", "F, logarithmic")]
    return card("Form factors", facts, figures)


def _matrix(matrix: Any) -> Any:
    """A matrix in false colours, in blocks of rows and columns: their largest entries."""
    side = min(matrix.shape[0], 256)
    entries = matrix.tocoo()
    block = [axis.astype(np.int64) * side // matrix.shape[0] for axis in entries.coords]
    largest = np.zeros((side, side))
    np.maximum.at(largest, tuple(block), entries.data)
    return false_colour(largest, *(max(float(largest.max()), 1e-30) * np.array([1e-4, 1.0])))


def _factor_result(result: Any) -> str:
    ended = _ended_by(result.stopped_by, "bundles")
    more = {"bundles": result.bundles, "ended by": ended, "time": time_text(result.elapsed)}
    return _factors(result.factors, more)


# ---------------------------------------------------------------- particles and maps


def _particles(particles: Any, more: Mapping[str, Any] | None = None) -> str:
    """Positions of particles: a projection along the axis in which they extend least."""
    facts: dict[str, Any] = {**(more or {}), "particles": len(particles)}
    if not len(particles):
        return card("Particles", facts)
    power = np.asarray(particles.power, dtype=np.float64).sum(axis=0)
    facts["power"] = ", ".join(number_text(float(p)) for p in power)
    facts["bounces"] = f"up to {int(particles.bounce.max())}"
    return card("Particles", facts, [Figure(_projected(particles), "where particles hit", "power, seen along an axis")])


def _projected(particles: Any) -> Any:
    """The power in squares of a projection, in false colours."""
    position = np.asarray(particles.position, dtype=np.float64)
    low, extent = position.min(axis=0), np.ptp(position, axis=0)
    across, up = sorted(np.argsort(-extent, kind="stable")[:2])
    scale = 256.0 / max(float(extent.max()), 1e-30)
    size = [max(1, int(np.ceil(extent[axis] * scale))) for axis in (across, up)]
    place = [
        np.minimum(((position[:, axis] - low[axis]) * scale).astype(int), n - 1)
        for axis, n in zip((across, up), size, strict=True)
    ]
    power = np.zeros(size[::-1])
    np.add.at(power, (size[1] - 1 - place[1], place[0]), np.abs(particles.power).sum(axis=1))
    positive = power[power > 0.0]
    low_, high = np.percentile(positive, [5.0, 99.5]) if positive.size else (0.1, 1.0)
    return false_colour(power, 0.5 * low_, 1.01 * high)


def _particle_result(result: Any) -> str:
    ended = _ended_by(result.stopped_by, "paths")
    facts = {"ended by": ended, "passes": result.passes, **_counted(result.counters)}
    facts["time"] = time_text(result.elapsed)  # the counter leaves out the time between passes
    if result.particles is not None:
        return _particles(result.particles, facts)
    return card("Particles", {"file": str(result.file), **facts})


def _particle_file(file: Any) -> str:
    head = file.header
    facts = {
        "file": str(file.path),
        "codec": head["codec"],
        "passes": len(file.passes),
        "size": f"{file.size / 1e6:.3g} MB",
        "finished": file.is_finished,
    }
    return card("Particles", {**facts, **_counted(file.counters)})


def _counted(counters: Mapping[str, float]) -> dict[str, Any]:
    """Counters of a tracing, each once and in its unit, without zeros."""
    left = dict(counters)
    seconds, rays = left.pop("seconds", 0.0), left.pop("rays", 0.0)
    facts: dict[str, Any] = {"particles": int(left.pop("particles", 0)), "light paths": int(left.pop("paths", 0))}
    facts["time"] = time_text(seconds)
    facts["speed"] = format_rate(rays / seconds) if rays and seconds else None
    facts["contributions not finite"] = int(left.pop("nonfinite", 0)) or None
    return facts | {name.replace("_", " "): value for name, value in left.items() if value}


def _patch_map(made: Any, more: Mapping[str, Any] | None = None) -> str:
    patches = made.surfaces.patches
    facts = {"kind": made.kind, **(more or {}), "cells": len(patches)}
    return card("Map of irradiance", facts, _mesh(patches, np.asarray(made.values)))


def _made_map(made: Any) -> str:
    more = {"particles": made.particles}
    if hasattr(made.map, "values"):
        return _patch_map(made.map, more)
    return card("Map of irradiance", {"kind": made.map.kind, **more})


# ---------------------------------------------------------------- checks


def _report(report: Any) -> str:
    """Failures and warnings with their meaning; then the number of tests that each component passed."""
    facts: dict[str, str] = {}
    for kind, findings in (("failed", report.failures), ("warning", report.warnings)):
        for finding in findings:
            figure = f" ({number_text(finding.figure)})" if np.isfinite(finding.figure) else ""
            facts[f"{kind}: {finding.component}, {finding.test}"] = f"{finding.meaning}{figure}"
    passed = Counter(finding.component for finding in report.findings if finding.verdict == "pass")
    tests = Counter(finding.component for finding in report.findings)
    facts |= {component: f"{passed[component]} of {count} passed" for component, count in tests.items()}
    counts = f"{passed.total()} tests passed, {len(report.warnings)} warn, {len(report.failures)} failed"
    return card(f"Check of {report.source}", facts, status=f"{counts}, in {time_text(report.seconds)}")


_CARDS: dict[str, Callable[[Any], str]] = {
    "Result": _result,
    "Rendering": _result,
    "Session": _session,
    "Solution": _solution,
    "Patches": _patches,
    "RadiosityResult": _solved,
    "FormFactorResult": _factor_result,
    "FormFactors": _factors,
    "Particles": _particles,
    "ParticleResult": _particle_result,
    "ParticleFile": _particle_file,
    "PatchMap": _patch_map,
    "MadeMap": _made_map,
    "Report": _report,
}


# ---------------------------------------------------------------- progress


class LiveProgress:
    """The progress of a run below its cell in a notebook."""

    def __init__(self, title: str, display: Any, html: Any) -> None:
        self._title, self._html = title, html
        self._next = 0.0
        self._latest = Progress()
        self._handle = display(html(card(title, {}, status="starting")), display_id=True)

    @classmethod
    def in_notebook(cls, title: str) -> LiveProgress | None:
        """Progress for a notebook; ``None`` elsewhere, as in IPython in a terminal."""
        if (module := sys.modules.get("IPython")) is None:
            return None
        shell = module.get_ipython()
        if shell is None or getattr(shell, "kernel", None) is None:
            return None
        from importlib import import_module

        shown: Any = import_module("IPython.display")
        return cls(title, shown.display, shown.HTML)

    def update(self, progress: Progress) -> None:
        """Show the progress, a few times a second."""
        self._latest = progress
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _EVERY
            self._show(**_progress(progress))

    def finishing(self, progress: Progress) -> None:
        """Show that all passes are made, and that the result is being computed and written."""
        self._latest = progress
        self._show(status=_after("finishing", progress))

    def end(self, how: str) -> None:
        """Show how the run has ended: ``done``, ``interrupted`` or ``failed``."""
        self._show(status=_after(how, self._latest))

    def _show(self, **shown: Any) -> None:
        if self._handle is not None:
            self._handle.update(self._html(card(self._title, {}, **shown)))


def _after(how: str, progress: Progress) -> str:
    """Status after the last pass, without a remaining time."""
    return f"{how}: {replace(progress, eta=None)}" if progress.passes else f"{how} before the first pass was done"
