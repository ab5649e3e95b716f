"""What bounded loss adds to maps: histogram and nearest neighbours on surfaces, beside the noise of the same maps.

Two independent sets of particles make the same map; the root mean square of their difference over the root of two is
its noise. The bandwidth is that of cross-validation; texels have the area of its disc, and k is the mean number of
particles in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
import typer

from etendue.core import Array
from etendue.density import Histogram, NearestNeighbours, Samples, cross_validation
from etendue.integration import Box
from etendue.particles import Codec, Grid, Particles, decode, encode

from ..measuring import Record
from .tracing import Count, Scene, Traced, traced

BAR = 0.1
_QUERIES = 200_000


def measure(
    count: Count = 10_000_000,
    scene: Scene = "caustics",
    shapes: Annotated[
        str, typer.Option(help="Rectangles, by name, separated by commas.", metavar="NAME,...")
    ] = "floor-back,floor-right,ceiling,pool-bottom",
    codec: Annotated[str, typer.Option(help="A codec with bounded loss.", metavar="NAME")] = "packed",
) -> Record:
    """Maps of each shape from all its particles, from the packed ones, and from those of another seed."""
    sets = [traced(scene, count, seed) for seed in (1, 2)]
    record = Record(
        f"Error that {codec} adds to maps, {sets[0].count} particles of {scene}",
        ("shape", "particles", "h", "map", "noise", "added", "added / noise", "bar"),
    )
    for name in shapes.split(","):
        one, other = (_on(each, name) for each in sets)
        packed = _packed(sets[0], name, codec)
        for cells in _compared(sets[0], name, one, packed, other):
            record.add(*cells)
    record.notes += [
        "h: radius of the disc by cross-validation, scene units; noise and added: root mean square over the surface, "
        "relative to the mean of the map; green channel",
        "histogram: texels of the area of the disc; nearest: the k nearest particles, k the mean number in the disc",
    ]
    return record


def _on(particles: Traced, name: str) -> Particles:
    """Those on a shape; their power is that of all paths."""
    number = particles.surfaces.names.index(name)
    rows = np.concatenate([rows[rows[:, 9] == number] for rows in particles.passes])
    return Particles.of_rows(rows, 1.0 / particles.paths)


def _packed(particles: Traced, name: str, codec: str) -> Particles:
    """The same, packed and unpacked; packing sorts, so that only chunks with the shape are needed."""
    number, grid, found = particles.surfaces.names.index(name), Grid(particles.surfaces), []
    for rows in particles.passes:
        for make in encode(rows, Codec.parse(codec), grid):
            chunk = make()
            if any(shape == number for shape, _ in chunk.head["shapes"]):
                back = decode(chunk.head, b"".join(chunk.strips), grid)
                found.append(back[back[:, 9] == number])
    return Particles.of_rows(np.concatenate(found), 1.0 / particles.paths)


def _compared(
    known: Traced, name: str, one: Particles, packed: Particles, other: Particles
) -> Iterator[tuple[str, ...]]:
    frame = known.surfaces.frames[known.surfaces.first[known.surfaces.names.index(name)]].astype(float)
    corner, axes = frame[:3], frame[3:].reshape(2, 3)
    sides = np.linalg.norm(axes, axis=1)

    def placed(particles: Particles) -> Samples:
        # By positions, whose error is larger than that of the parameters.
        along = (particles.position - corner) @ (axes / sides[:, None]).T
        weights = particles.power[:, 1].astype(float)
        return Samples(np.clip(along, 0, sides), weights, mass=float(weights.sum()))

    exact, lossy, another = map(placed, (one, packed, other))
    h, _, _ = cross_validation(exact, "uniform")
    box = Box((0.0, 0.0), tuple(sides))
    bins = np.maximum(1, np.rint(sides / (np.sqrt(np.pi) * h))).astype(int).tolist()
    k = max(2, round(len(exact.positions) * np.pi * h**2 / float(np.prod(sides))))
    points = np.random.default_rng(3).random((_QUERIES, 2)) * sides

    def histogram(samples: Samples) -> Array:
        return Histogram(samples, bins, box).values

    def nearest(samples: Samples) -> Array:
        return np.asarray(NearestNeighbours(samples, k, domain=box)(points))

    for label, make in ((f"histogram {bins[0]}x{bins[1]}", histogram), (f"nearest, k = {k}", nearest)):
        a, b, c = make(exact), make(lossy), make(another)
        noise = _rms(a - c) / np.sqrt(2) / a.mean()
        added = _rms(a - b) / a.mean()
        reached = "reached" if added <= BAR * noise else "missed"
        yield (
            *(name, str(len(one)), f"{h:.4f}", label, f"{noise:.2e}", f"{added:.2e}"),
            *(f"{added / noise:.4f}", f"≤ {BAR:g}: {reached}"),
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
