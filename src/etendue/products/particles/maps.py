"""Maps from particles of any number: histograms and kernel maps in passes, nearest neighbours from memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

from etendue.core import Array, InNotebooks, OptionError, free_memory, short_repr
from etendue.particles import Particles
from etendue.scene import Problem, load
from etendue.surfaces import (
    PARTICLE_BYTES,
    HistogramBuilder,
    KernelBuilder,
    MapSurfaces,
    NearestMap,
    PatchMap,
    rule_bandwidths,
    variable_bandwidths,
)

from .sources import FileSource

#: Largest number of particles from which bandwidths are chosen.
_SAMPLE = 1 << 20

MapKind = Literal["histogram", "kernel", "variable", "knn"]
#: Particles in memory, or a function that opens their stream anew: a variable kernel reads it twice.
Source: TypeAlias = Particles | Callable[[], Iterable[Particles]]


@dataclass(frozen=True)
class MapOptions:
    """How a map is made. Raises :class:`OptionError` for an unknown kind, and for a boundary that ``knn`` lacks.

    ``kind``: ``histogram`` in cells, ``kernel`` of one bandwidth for a shape, ``variable`` kernels after a pilot, or
    ``knn``, the nearest particles. ``cells``: approximate number of cells (of all kinds but ``knn``). ``bandwidth`` of
    kernels in the scene's units, or None for ``rule`` (``silverman``, ``normal``, ``cross-validation``). ``kernel``,
    ``boundary``: see :class:`KernelBuilder`; ``knn`` knows ``renormalise`` and ``none``. ``k``: neighbours.
    """

    kind: MapKind = "histogram"
    cells: int = 20_000
    bandwidth: float | None = None
    rule: str = "silverman"
    kernel: str = "epanechnikov"
    boundary: str = "renormalise"
    k: int = 50

    def __post_init__(self) -> None:
        if self.kind not in get_args(MapKind):
            raise OptionError(f"a map is one of {', '.join(get_args(MapKind))}, not '{self.kind}'")
        if self.kind == "knn" and self.boundary not in ("renormalise", "none"):
            raise OptionError(f"a map of neighbours has the boundaries renormalise and none, not '{self.boundary}'")


@short_repr
@dataclass(frozen=True)
class MadeMap(InNotebooks):
    """A map, its surfaces, and the number of particles."""

    map: PatchMap | NearestMap
    surfaces: MapSurfaces
    particles: int


def make_map(
    scene: Any, particles: Source, options: MapOptions | None = None, tell: Callable[[str], object] = lambda text: None
) -> MadeMap:
    """A map of ``particles`` on the surfaces of ``scene``, an argument or a result of :func:`etendue.scene.load`.

    A histogram and kernels are added up pass by pass, in the memory of their cells and one pass; ``knn`` holds all
    particles, 350 bytes each. ``tell`` receives a line for each step and pass. Raises :class:`SurfaceError` for
    particles of another scene, for none, and for surfaces that cannot have a map, :class:`OptionError` for options.
    """
    o = options or MapOptions()
    problem = scene if isinstance(scene, Problem) else load(scene, check=False)
    tell("dividing the surfaces")
    surfaces = MapSurfaces(problem, o.cells)
    if o.kind == "knn":
        tell(f"reading particles for {len(surfaces.patches)} cells")
        held = _held(particles, problem.memory)
        nearest = NearestMap(surfaces, held, o.k, o.kernel, o.boundary == "renormalise", problem.memory)
        return MadeMap(nearest, surfaces, len(held))
    if o.kind == "histogram":
        builder: HistogramBuilder | KernelBuilder = HistogramBuilder(surfaces)
        total = _added(builder, particles, tell, "histogram")
        return MadeMap(builder.build(), surfaces, total)
    tell(f"choosing bandwidths for {len(surfaces.patches)} cells")
    widths = _widths(surfaces, particles, o)
    boundary: Any = o.boundary
    builder = KernelBuilder(surfaces, widths, o.kernel, boundary)
    total = _added(builder, particles, tell, "pilot" if o.kind == "variable" else "kernels")
    if o.kind == "variable":
        widths = variable_bandwidths(_built(builder, tell, "pilot"), widths)
        builder = KernelBuilder(surfaces, widths, o.kernel, boundary)
        _added(builder, particles, tell, "kernels")
    made = _built(builder, tell, "kernels")
    made.kind = o.kind
    return MadeMap(made, surfaces, total)


def _widths(surfaces: MapSurfaces, particles: Source, o: MapOptions) -> float | Array:
    """The given bandwidth, or that of the rule from an evenly spaced subset of the particles (each pass of a file
    is sorted by surface). Only a few passes of a file are read."""
    if o.bandwidth is not None:
        return o.bandwidth
    kept, stride, total = Particles.empty(), 1, 0
    for part in particles.sample(_SAMPLE) if isinstance(particles, FileSource) else _passes(particles):
        kept = Particles.joined([kept, part[-total % stride :: stride]])
        total += len(part)
        while len(kept) > _SAMPLE:
            kept, stride = kept[::2], 2 * stride
    rule: Any = o.rule
    every = len(particles) if isinstance(particles, FileSource) else total
    return rule_bandwidths(surfaces, kept, rule, o.kernel, every)


def _added(
    builder: HistogramBuilder | KernelBuilder, particles: Source, tell: Callable[[str], object], name: str
) -> int:
    total = 0
    for number, part in enumerate(_passes(particles), start=1):
        if len(part):
            builder.add(part)
            total += len(part)
            tell(f"{name}: {total} particles in {number} passes")
    return total


def _built(builder: KernelBuilder, tell: Callable[[str], object], name: str) -> PatchMap:
    step = f"{name}: the surface within each kernel"
    tell(step)
    return builder.build(tell=lambda share: tell(f"{step}, {100 * share:.0f} %"))


def _passes(particles: Source) -> Iterable[Particles]:
    return [particles] if isinstance(particles, Particles) else particles()


def _held(particles: Source, memory: int | None) -> Particles:
    """All particles; raises :class:`OptionError` before they fill the memory."""
    room = memory if memory is not None else free_memory()
    parts, total = [], 0
    for part in _passes(particles):
        parts.append(part)
        total += len(part)
        if room is not None and total * PARTICLE_BYTES > room:
            raise OptionError(
                f"a map of neighbours holds all particles in memory: {total} and more of them need over "
                f"{total * PARTICLE_BYTES / 1e9:.2g} GB, there are {room / 1e9:.2g}; make a histogram or kernel map"
            )
    return Particles.joined(parts)
