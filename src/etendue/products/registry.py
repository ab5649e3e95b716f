"""All methods by name, whatever they make, and what their budgets count."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from functools import cache
from typing import Any

from etendue import methods
from etendue.core import Method, OptionError, is_number, logger, suggest
from etendue.engine import Budget, check_count
from etendue.scene import integrator_of

#: The method of pictures, if none is asked for.
DEFAULT = "auto"

#: Names of methods in earlier versions.
_EARLIER = {
    "global-lines": "lines",
    "hierarchical-lines": "spheres",
    "hierarchical-multipath": "boxes",
}
#: The verb of a method, by what it counts.
_VERBS = {
    "bundles": "etendue.compute_form_factors and solve_radiosity",
    "points": "etendue.solve_radiosity",
    "passes": "etendue.solve_radiosity",
    "paths": "etendue.trace_particles",
}
#: Methods by what they make.
FACTORS, SOLUTIONS, PARTICLES = (
    ("lines", "spheres"),
    ("lines", "multipath", "boxes"),
    ("particles", "metropolis_particles"),
)
#: Methods that make no picture.
_OTHERS = (*dict.fromkeys(FACTORS + SOLUTIONS), *PARTICLES)


@cache
def _others() -> dict[str, type[Method]]:
    """The methods that make no picture. Their modules are imported when one is asked for."""
    from etendue import radiosity

    kinds: tuple[Any, ...] = (
        radiosity.LineCasting,
        radiosity.HierarchicalCasting,
        radiosity.MultipathPasses,
        radiosity.HierarchicalMultipath,
        methods.ParticleTracing,
        methods.MetropolisParticles,
    )
    return {kind.name: kind for kind in kinds}


def table() -> dict[str, type[Method]]:
    """Names and classes: the methods of pictures in the order of the manual, then the others."""
    return {**methods.table(), **_others()}


def find(name: str) -> type[Method]:
    """The class of a method. Raises :class:`OptionError` if there is none, with the nearest name."""
    name = current(name)
    if name in _OTHERS:
        return _others()[name]
    if (
        isinstance(name, str)
        and get_close_matches(name, _OTHERS, 1)
        and not get_close_matches(name, methods.names(), 1)
    ):
        raise OptionError(f"no method '{name}'; {suggest(name, _OTHERS)}")
    return methods.get(name)


def chosen(name: str, among: tuple[str, ...], what: str) -> type[Method]:
    """The class of a method that makes ``what``. Raises :class:`OptionError` for a method that does not."""
    name = current(name)
    if name not in among:
        raise OptionError(f"no method '{name}' for {what}; {suggest(str(name), among)}")
    return find(name)


def choose_method(
    name: str | None, scene: Any, parameters: Mapping[str, Any] | None, tell: Callable[[str], object] = logger.info
) -> type[Any]:
    """The class of the picture method ``name``; by default that of the scene's integrator (except ``path``), else
    ``auto``.

    ``tell`` receives a line if the scene's integrator is not used. Raises :class:`OptionError` for an unknown name, and
    the errors of parsing the scene.
    """
    if name is not None:
        if current(name) in _OTHERS:
            raise OptionError(f"method '{name}' makes no picture: it is for {_VERBS[find(name).counts]}")
        return methods.get(name)
    named = integrator_of(scene, parameters)
    if (method := methods.by_plugin(named)) is not None:
        return method
    if named:
        tell(f"the scene names the integrator '{named}'; no method is given, so {DEFAULT} renders it")
    return methods.get(DEFAULT)


def current(name: Any) -> Any:
    """The present name of a method."""
    return _EARLIER.get(name, name) if isinstance(name, str) else name


def budget_of(method: type[Method], limits: Mapping[str, Any]) -> Budget:
    """The budget of a run: ``seconds``, ``error`` (a relative standard error) and what the method counts.

    Raises :class:`OptionError` for a limit that the method does not count, and for values that are not above 0.
    """
    given, count = {name: value for name, value in limits.items() if value is not None}, method.counts
    seconds, error, number = (given.pop(name, None) for name in ("seconds", "error", count))
    if given:
        raise OptionError(f"method '{method.name}' counts {count}: give {count} in place of {', '.join(given)}")
    if error is not None:
        if count == "paths":
            raise OptionError("particles have no error: limit the paths, the particles or the seconds")
        if not is_number(error) or error <= 0:
            raise OptionError(f"a budget in error must be a number above 0, not {error!r}")
        error = error**2  # the engine works with variances
    number = check_count(count, number)
    return Budget(seconds, None if count == "passes" else number, number if count == "passes" else None, error)


def limits_of(budget: Budget, count: str = "spp") -> dict[str, float]:
    """The limits of a budget by the names of :func:`budget_of`; ``count``: what its method counts."""
    names = {"samples": count, "iterations": "passes"}
    limits = {names.get(name, name): value for name, value in budget.to_dict().items()}
    return limits | ({"error": float(f"{limits['error'] ** 0.5:.12g}")} if "error" in limits else {})
