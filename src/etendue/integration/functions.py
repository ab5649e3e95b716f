"""Functions on a box and their algebra: sums, products, compositions and restrictions are functions again.

Reflectances, a texture times a lobe, or the integrand of the rendering equation are composed from parts and passed to
any integrator [Leeson 2001].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from etendue.core import is_whole

from .errors import IntegrationError

#: Which arrays a function takes. A function that takes ``"either"`` adopts those of the function it is combined with.
Place = Literal["host", "device", "either"]
_EVERYTHING = (-math.inf, math.inf)


@dataclass(frozen=True)
class Box:
    """A box ``lower[i] <= x[i] <= upper[i]``. Raises :class:`IntegrationError` if it is empty or infinite."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", tuple(float(v) for v in self.lower))
        object.__setattr__(self, "upper", tuple(float(v) for v in self.upper))
        if not self.lower or len(self.lower) != len(self.upper):
            raise IntegrationError(f"a domain needs a lower and an upper end in each dimension, not {self}")
        for axis, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise IntegrationError(
                    f"empty or infinite domain: dimension {axis} runs from {low:g} to {high:g}; give finite ends"
                )

    def __str__(self) -> str:
        return " x ".join(f"[{low:g}, {high:g}]" for low, high in zip(self.lower, self.upper, strict=True))

    @classmethod
    def of(cls, domain: Domain) -> Box:
        """A box from a box, from pairs of ends, or from a number of dimensions: the unit cube."""
        if isinstance(domain, Box):
            return domain
        if isinstance(domain, int | np.integer):
            return cls((0.0,) * int(domain), (1.0,) * int(domain))
        try:
            ends = [(float(low), float(high)) for low, high in domain]
        except (TypeError, ValueError):
            raise IntegrationError(
                f"a domain is a number of dimensions or pairs (lower, upper), not {domain!r}"
            ) from None
        return cls(tuple(low for low, _ in ends), tuple(high for _, high in ends))

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return len(self.lower)

    @property
    def sides(self) -> tuple[float, ...]:
        """Lengths of the sides."""
        return tuple(high - low for low, high in zip(self.lower, self.upper, strict=True))

    @property
    def volume(self) -> float:
        """Product of the sides."""
        return math.prod(self.sides)

    def from_unit(self, u: Any) -> list[Any] | Any:
        """Points of the box from points of the unit cube, coordinate-major."""
        if self.lower == (0.0,) * self.dimension and self.upper == (1.0,) * self.dimension:
            return u
        return [low + (high - low) * v for low, high, v in zip(self.lower, self.upper, u, strict=True)]

    def to_unit(self, x: Any) -> list[Any]:
        """Inverse of :meth:`from_unit`."""
        return [(v - low) * (1 / (high - low)) for low, high, v in zip(self.lower, self.upper, x, strict=True)]

    def intersection(self, other: Box) -> Box:
        """The intersection; an error if it is empty."""
        if self.dimension != other.dimension:
            raise IntegrationError(f"functions of {self.dimension} and {other.dimension} parameters cannot be combined")
        if self == other:
            return self
        try:
            return Box(tuple(map(max, self.lower, other.lower)), tuple(map(min, self.upper, other.upper)))
        except IntegrationError:
            raise IntegrationError(f"empty domain: {self} and {other} have no points in common") from None


Domain = Box | int | Sequence[Sequence[float]]
Points = Any


@dataclass(frozen=True)
class Integrand:
    """A function on a box, evaluated over many points at once; real, or with several values at a point.

    Parameters
    ----------
    function: takes points ``x``, where ``x[i]`` is coordinate i of all n points (an ndarray of shape (d, n), or a
        list of Dr.Jit arrays), and returns n values. A function of several values returns them in the layout of points:
        ``v[k]`` is value k at all n points (an ndarray (values, n), a list, or a Dr.Jit vector such as a colour).
    domain: a :class:`Box`, pairs (lower, upper), or a number of dimensions for the unit cube.
    range: bounds of the values, if known.
    on: ``"host"`` if ``function`` takes NumPy arrays, ``"device"`` for Dr.Jit's, ``"either"`` if both.
    cost: cost of an evaluation at each point, in any unit, in the form of ``function``; adaptive integrators take it
        into account.
    values: number of values at each point: 1, or more for colours or for points of another function's domain (see
        :meth:`compose`). Sums and products act on each value; a real function combines with each of them.
    """

    function: Callable[[Points], Any]
    domain: Box
    range: tuple[float, float] = _EVERYTHING
    on: Place = "host"
    cost: Callable[[Points], Any] | None = field(default=None, compare=False)
    values: int = 1

    def __init__(
        self,
        function: Callable[[Points], Any],
        domain: Domain,
        range: tuple[float, float] = _EVERYTHING,
        on: Place = "host",
        cost: Callable[[Points], Any] | None = None,
        values: int = 1,
    ) -> None:
        low, high = (float(v) for v in range)
        if not low <= high:
            raise IntegrationError(f"the range of a function runs from its least to its greatest value, not {range}")
        if on not in ("host", "device", "either"):
            raise IntegrationError(f"a function is on 'host', 'device' or 'either', not {on!r}")
        if not is_whole(values) or values < 1:
            raise IntegrationError(f"a function has a whole number of values at a point, at least 1, not {values!r}")
        fields = {"function": function, "domain": Box.of(domain), "range": (low, high), "on": on, "cost": cost}
        for name, value in (fields | {"values": values}).items():
            object.__setattr__(self, name, value)

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return self.domain.dimension

    def evaluate(self, x: Points) -> Any:
        """Values at points ``x`` (coordinate-major); for a constant perhaps a single number."""
        return self.function(x)

    def parts(self, values: Any) -> list[Any]:
        """The result of :meth:`evaluate` as a list with an array for each value."""
        return [values] if self.values == 1 else [values[k] for k in range(self.values)]

    # Algebra -----------------------------------------------------------------------------------------------------

    def __add__(self, other: Integrand | float) -> Integrand:
        return self._with(other, lambda a, b: a + b, lambda a, b: (a[0] + b[0], a[1] + b[1]))

    def __sub__(self, other: Integrand | float) -> Integrand:
        return self._with(other, lambda a, b: a - b, lambda a, b: (a[0] - b[1], a[1] - b[0]))

    def __mul__(self, other: Integrand | float) -> Integrand:
        return self._with(other, lambda a, b: a * b, _product_range)

    def __neg__(self) -> Integrand:
        return self * -1.0

    def __rsub__(self, other: float) -> Integrand:
        return -self + other

    __radd__ = __add__
    __rmul__ = __mul__

    def _with(
        self, other: Integrand | float, operation: Callable[[Any, Any], Any], ranges: Callable[..., Any]
    ) -> Integrand:
        if not isinstance(other, Integrand):
            other = constant(float(other), self.domain)
        if self.values != other.values and 1 not in (self.values, other.values):
            raise IntegrationError(f"functions of {self.values} and {other.values} values cannot be combined")
        f, g, count = self, other, max(self.values, other.values)

        def combined(x: Points) -> Any:
            a, b = f.parts(f.function(x)), g.parts(g.function(x))
            found = [operation(a[k % len(a)], b[k % len(b)]) for k in range(count)]
            return found if count > 1 else found[0]

        return Integrand(
            combined,
            self.domain.intersection(other.domain),
            ranges(self.range, other.range),
            _common_place((self, other)),
            _common_cost((self, other)),
            count,
        )

    def dot(self, weights: Sequence[float]) -> Integrand:
        """Weighted sum of the values at a point, a real function: ``colour.dot([0.2126, 0.7152, 0.0722])``."""
        numbers = [float(w) for w in weights]
        if len(numbers) != self.values:
            raise IntegrationError(f"{self.values} values at a point are added with as many weights, not {numbers}")
        f, (low, high) = self, self.range
        ends = [_product_range((low, high), (w, w)) for w in numbers]
        return Integrand(
            lambda x: sum(v * w for v, w in zip(f.parts(f.function(x)), numbers, strict=True) if w),
            self.domain,
            (sum(end[0] for end in ends), sum(end[1] for end in ends)),
            self.on,
            self.cost,
        )

    def compose(self, *inner: Integrand) -> Integrand:
        """``x -> self(inner_0(x), inner_1(x), …)``: inner functions of common parameters, one for each parameter of
        this function.

        An inner function of several values stands for as many consecutive parameters. If the known range of an inner
        function exceeds the domain of this function, it raises :class:`IntegrationError`.
        """
        given = [g for g in inner for _ in range(g.values)]
        if len(given) != self.dimension:
            raise IntegrationError(
                f"a function of {self.dimension} parameters is composed with as many, not {len(given)}"
            )
        domain = inner[0].domain
        for axis, g in enumerate(given):
            domain = domain.intersection(g.domain)
            low, high = self.domain.lower[axis], self.domain.upper[axis]
            slack = 1e-9 * (high - low)
            if (math.isfinite(g.range[0]) and g.range[0] < low - slack) or (
                math.isfinite(g.range[1]) and g.range[1] > high + slack
            ):
                raise IntegrationError(
                    f"parameter {axis} is defined on [{low:g}, {high:g}], but its function ranges over {list(g.range)}"
                )
        outer, cost = self.function, self.cost

        def arguments(x: Points) -> list[Any]:
            return [value for g in inner for value in g.parts(g.function(x))]

        return Integrand(
            lambda x: outer(arguments(x)),
            domain,
            self.range,
            _common_place((self, *inner)),
            None if cost is None else (lambda x: cost(arguments(x))),
            self.values,
        )

    def restrict(self, domain: Domain) -> Integrand:
        """The same function on a part of its domain."""
        part = Box.of(domain)
        inside = self.domain.intersection(part)
        if inside != part:
            raise IntegrationError(f"{part} is not within the function's domain {self.domain}")
        return replace(self, domain=part)

    def fix(self, values: Mapping[int, float]) -> Integrand:
        """The function of the other parameters, with the parameters in ``values`` fixed: ``f.fix({2: 0.5})``."""
        axes = _axes(values, self.dimension)
        free = [a for a in range(self.dimension) if a not in axes]
        if not free:
            raise IntegrationError("at least one parameter of a function must stay free")
        for axis in axes:
            if not self.domain.lower[axis] <= values[axis] <= self.domain.upper[axis]:
                raise IntegrationError(f"parameter {axis} cannot be {values[axis]:g}: the domain is {self.domain}")
        lower, upper = self.domain.lower, self.domain.upper
        inner_domain = Box(tuple(lower[a] for a in free), tuple(upper[a] for a in free))
        place = {axis: number for number, axis in enumerate(free)}

        def full(x: Points) -> list[Any]:
            # Zero times a coordinate, so that a fixed parameter has as many entries as the free ones.
            return [x[place[a]] if a in place else x[0] * 0.0 + values[a] for a in range(self.dimension)]

        function, cost = self.function, self.cost
        return Integrand(
            lambda x: function(full(x)),
            inner_domain,
            self.range,
            self.on,
            None if cost is None else (lambda x: cost(full(x))),
            self.values,
        )

    def of(self, parameters: Sequence[int], domain: Domain) -> Integrand:
        """The same function of some of the parameters of a larger ``domain``: its parameter i is parameter
        ``parameters[i]`` of the domain. ``texture.of([0, 1], box) * lobe.of([2, 3], box)`` is a function of four
        parameters."""
        box = Box.of(domain)
        return self.compose(*(coordinate(axis, box) for axis in _axes(parameters, box.dimension)))


def _axes(axes: Any, dimension: int) -> list[int]:
    chosen = [int(a) for a in axes]
    if len(set(chosen)) != len(chosen) or any(not 0 <= a < dimension for a in chosen):
        raise IntegrationError(f"parameters {chosen}: they must be different and from 0 to {dimension - 1}")
    return chosen


def constant(value: float, domain: Domain) -> Integrand:
    """The function that is ``value`` everywhere."""
    return Integrand(lambda x: x[0] * 0.0 + value, domain, (value, value), "either")


def coordinate(axis: int, domain: Domain) -> Integrand:
    """The function ``x -> x[axis]``."""
    box = Box.of(domain)
    _axes([axis], box.dimension)
    return Integrand(lambda x: x[axis], box, (box.lower[axis], box.upper[axis]), "either")


def _product_range(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    # Zero times an infinite bound is zero, since the values themselves are finite.
    products = [0.0 if 0.0 in (p, q) else p * q for p in a for q in b]
    return min(products), max(products)


def _common_place(functions: Sequence[Integrand]) -> Place:
    places = {f.on for f in functions} - {"either"}
    if len(places) > 1:
        raise IntegrationError(
            "a function on the host and one on the device cannot be combined: write one for the other side"
        )
    return places.pop() if places else "either"


def _common_cost(functions: Sequence[Integrand]) -> Callable[[Points], Any] | None:
    costs = [f.cost for f in functions if f.cost is not None]
    if not costs:
        return None
    return lambda x: sum(cost(x) for cost in costs)
