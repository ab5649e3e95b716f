"""Maps of irradiance from Python: the function behind `etendue particles map`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError, use_variant
from etendue.jobs import PathLike, listed
from etendue.particles import Particles

if TYPE_CHECKING:
    from etendue.jobs import MadeMap


def map_particles(
    particles: Particles | PathLike | Callable[[], Iterable[Particles]],
    scene: Any = None,
    kind: str = "histogram",
    *,
    save: PathLike | Sequence[PathLike] = (),
    size: int = 1024,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    callback: Callable[[str], object] = lambda text: None,
    **options: Any,
) -> MadeMap:
    """A map of irradiance on the surfaces of a scene, from particles in memory, in a file, or from a function that
    opens their stream anew.

    ``scene``: as for :func:`etendue.render`; for a file, by default the scene in which it was traced. ``kind``:
    ``histogram``, ``kernel``, ``variable`` or ``knn``; ``options`` are those of :class:`etendue.jobs.MapOptions`:
    ``cells``, ``bandwidth``, ``rule``, ``kernel``, ``boundary``, ``k``. ``save`` names files as of
    :func:`etendue.jobs.write_map`, ``size`` the largest side of lightmaps in texels. ``callback`` receives a line of
    text for each pass.

    The result has the map, its surfaces and the number of particles; :func:`etendue.surfaces.irradiance_at` evaluates
    the map. Raises :class:`OptionError`, :class:`etendue.surfaces.SurfaceError`, and the errors of loading and writing.
    """
    from etendue.jobs import FileSource, MapOptions, check_map_file, make_map, write_map

    chosen = MapOptions(kind=kind, **options)  # type: ignore[arg-type]
    files = listed(save)
    for path in files:
        check_map_file(path)
    use_variant(variant)
    source: Any = particles
    if not isinstance(particles, Particles) and not callable(particles):
        source = FileSource(particles)
        scene = source.scene(scene, parameters, memory)
    elif scene is None:
        raise OptionError("particles in memory do not know their scene; give it as the second argument")
    made = make_map(scene, source, chosen, callback)
    for path in files:
        write_map(path, made.map, made.surfaces, size=size, metadata={"particles": made.particles})
    return made
