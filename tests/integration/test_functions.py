"""Functions and their algebra: identities, ranges, domains, and functions that are integrals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.integrals import assert_unbiased, runs

from etendue.integration import (
    Box,
    Importance,
    Integrand,
    IntegrationError,
    MeanSample,
    Metropolis,
    ProductDensity,
    QuasiMonteCarlo,
    Stratified,
    Vegas,
    array_namespace,
    constant,
    coordinate,
    integral,
)

POINTS = np.random.default_rng(0).random((2, 1000))
F = Integrand(lambda x: x[0] * x[0] + x[1], 2, (0.0, 2.0), on="either")
G = Integrand(lambda x: array_namespace(x[0]).exp(-x[0] * x[1]), 2, (math.exp(-1), 1.0), on="either")


COLOUR = Integrand(lambda x: [x[0], x[0] * x[1], 1 - x[1]], 2, (0.0, 1.0), on="either", values=3)


def values(f, x=POINTS):
    return np.broadcast_to(f.evaluate(x), x.shape[1:])


def on_device(f, x=POINTS):
    import mitsuba as mi

    return np.array(f.evaluate([mi.Float(np.array(row, dtype=np.float32)) for row in x]))


CASES = {
    "sum": (F + G, lambda f, g: f + g),
    "difference": (F - G, lambda f, g: f - g),
    "product": (F * G, lambda f, g: f * g),
    "negation": (-F, lambda f, g: -f),
    "numbers": (2 * F + 1 - 3 * G, lambda f, g: 2 * f + 1 - 3 * g),
    "from a number": (1 - G, lambda f, g: 1 - g),
    "distributes": (F * (F + G) - F * F, lambda f, g: f * g),
}


@pytest.mark.parametrize("name", sorted(CASES))
def test_algebra_is_that_of_the_values(name):
    f, expected = CASES[name]
    wanted = expected(values(F), values(G))
    assert values(f) == pytest.approx(wanted, abs=1e-12)
    assert on_device(f) == pytest.approx(wanted, abs=3e-6)
    assert f.range[0] - 1e-12 <= wanted.min() and wanted.max() <= f.range[1] + 1e-12
    assert f.domain == Box.of(2)


def test_ranges_are_bounds():
    assert (F + G).range == (math.exp(-1), 3.0)
    assert (F - G).range == (-1.0, 2.0 - math.exp(-1))
    assert (-F * G).range == (-2.0, 0.0)
    free = Integrand(lambda x: x[0], 2)
    assert (free + F).range == (-math.inf, math.inf) and (free * 0.0).range == (0.0, 0.0)


@pytest.mark.parametrize(
    "method", [MeanSample(), Stratified(), QuasiMonteCarlo(), Vegas(strata=1, damping=0.0, smoothing=False)]
)
def test_integration_is_linear(method):
    """With the same points: int (2 f - 3 g) = 2 int f - 3 int g to rounding. Check 2 of the framework's list."""
    if isinstance(method, Vegas):
        method = Vegas([], iterations=1)  # with nothing to adapt, its points do not depend on the function
    f, g, both = (method.integrate(h, 4096, seed=7).value for h in (F, G, 2 * F - 3 * G))
    assert both == pytest.approx(2 * f - 3 * g, rel=1e-12)


def test_composition():
    """Fig. 5.5 of the framework: diffuse lobe times a texture plus a lobe whose exponent depends on the position."""
    box = Box.of([(0, 1), (0, 1), (0, math.pi / 2)])
    u, v, theta = (coordinate(a, box) for a in range(3))
    texture = Integrand(lambda x: 0.5 + 0.3 * x[0] * x[1], 2, (0.5, 0.8), on="either")
    lobe = Integrand(
        lambda x: array_namespace(x[0]).cos(x[0]) ** x[1], [(0, math.pi / 2), (0, 40)], (0, 1), on="either"
    )
    exponent = Integrand(lambda x: 10.0 + 20.0 * x[0], 1, (10, 30), on="either")
    composite = texture.of([0, 1], box) * (1 / math.pi) + 0.2 * lobe.compose(theta, exponent.compose(u))
    x = np.random.default_rng(1).random((3, 500)) * np.array([[1], [1], [math.pi / 2]])
    closed = (0.5 + 0.3 * x[0] * x[1]) / math.pi + 0.2 * np.cos(x[2]) ** (10 + 20 * x[0])
    assert values(composite, x) == pytest.approx(closed, rel=1e-12)
    assert on_device(composite, x) == pytest.approx(closed, abs=2e-5)
    assert composite.range == (pytest.approx(0.5 / math.pi), pytest.approx(0.8 / math.pi + 0.2))
    assert values(v, x) == pytest.approx(x[1])


def test_fixing_a_parameter_is_a_slice():
    f = Integrand(lambda x: x[0] + 10 * x[1] + 100 * x[2], [(0, 1), (0, 2), (0, 3)])
    held = f.fix({1: 0.5})
    assert held.domain == Box.of([(0, 1), (0, 3)])
    assert held.evaluate(POINTS) == pytest.approx(POINTS[0] + 5 + 100 * POINTS[1])
    assert MeanSample().integrate(f.fix({0: 1.0, 2: 2.0}), 10_000).value == pytest.approx(2 * 211, rel=0.05)


def test_domains_meet():
    a, b = Integrand(lambda x: x[0], [(0, 2)]), Integrand(lambda x: x[0], [(1, 3)])
    assert (a + b).domain == Box.of([(1, 2)])
    assert a.restrict([(0.5, 1)]).domain == Box.of([(0.5, 1)])


def test_costs_follow_the_algebra():
    dear = Integrand(lambda x: x[0], 2, cost=lambda x: 1 + x[0])
    assert (F + dear).cost is not None and (F + F).cost is None
    assert (dear + dear).cost(POINTS) == pytest.approx(2 * (1 + POINTS[0]))
    assert dear.of([1, 0], 2).cost(POINTS) == pytest.approx(1 + POINTS[1])
    assert dear.fix({0: 0.5}).cost(POINTS[:1]) == pytest.approx(np.full(1000, 1.5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: F + constant(1.0, 3), "of 2 and 3 parameters cannot be combined"),
        (lambda: constant(1.0, [(0, 1)]) + constant(1.0, [(2, 3)]), "no points in common"),
        (lambda: F.restrict([(0, 2), (0, 1)]), "not within"),
        (lambda: F.fix({2: 0.5}), "from 0 to 1"),
        (lambda: F.fix({0: 0.5, 1: 0.5}), "must stay free"),
        (lambda: F.fix({0: 1.5}), "cannot be 1.5"),
        (lambda: F.compose(F), "composed with as many, not 1"),
        (lambda: F.compose(F, G), "its function ranges over"),
        (lambda: coordinate(2, 2), "from 0 to 1"),
        (lambda: Integrand(F.function, 2) + Integrand(F.function, 2, on="device"), "host and one on the device"),
        (lambda: integral(F, [0, 1]), "over some of the parameters"),
        (lambda: integral(F, [2]), "over some of the parameters"),
        (lambda: integral(Integrand(F.function, 2, on="device"), [0], Vegas()), "one integral at a time"),
        (lambda: integral(COLOUR, [0], Vegas()), "one integral at a time"),
        (lambda: integral(F, [0], Stratified(8), samples=7).evaluate(POINTS[:1]), "7 samples are too few for 8 strata"),
        (
            lambda: on_device(integral(F, [0], Stratified(70_000), samples=80_000), POINTS[:1, :1]),
            "too many for single precision: at most 65536",
        ),
        (lambda: COLOUR + Integrand(lambda x: [x[0], x[1]], 2, values=2), "of 3 and 2 values cannot be combined"),
        (lambda: COLOUR.dot([1, 2]), "as many weights"),
        (lambda: F.compose(COLOUR), "composed with as many, not 3"),
        (lambda: MeanSample().integrate(COLOUR, 100), "3 values at a point"),
        (lambda: Metropolis().sample(COLOUR, 1000), "3 values at a point"),
        (lambda: Integrand(F.function, 2, values=0), "at least 1, not 0"),
    ],
)
def test_what_cannot_be_combined(call, message):
    with pytest.raises(IntegrationError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_several_values_go_one_by_one():
    """A sum or product of two colours, or of a colour and a real function, is that of the values."""
    x = POINTS
    colour = np.array([x[0], x[0] * x[1], 1 - x[1]])
    f = x[0] * x[0] + x[1]
    cases = {
        "sum": (COLOUR + COLOUR, 2 * colour),
        "with a real function": (COLOUR * F, colour * f),
        "and before it": (F * COLOUR - COLOUR, (f - 1) * colour),
        "numbers": (2 * COLOUR + 1, 2 * colour + 1),
        "held": (COLOUR.fix({1: 0.5}).of([0], 2), np.array([x[0], 0.5 * x[0], 0 * x[0] + 0.5])),
        "placed": (COLOUR.of([1, 0], 2), np.array([x[1], x[0] * x[1], 1 - x[0]])),
    }
    for name, (g, expected) in cases.items():
        assert g.values == 3
        assert np.array(g.evaluate(x)) == pytest.approx(expected, abs=1e-12), name
        assert on_device(g) == pytest.approx(expected, abs=3e-6), name
    added = COLOUR.dot([1, -2, 0])
    assert added.values == 1 and added.range == (-2.0, 1.0)
    assert values(added) == pytest.approx(colour[0] - 2 * colour[1], abs=1e-12)
    assert COLOUR.restrict([(0, 0.5), (0, 1)]).values == 3


def test_composition_with_a_function_of_several_values():
    """One inner function may stand for several parameters in a row: the change to polar coordinates, and one more."""
    box = Box.of([(0.1, 1), (0, 1), (0, 1)])
    polar = Integrand(lambda x: [x[0] * np.cos(x[1]), x[0] * np.sin(x[1])], box, (0, 1), values=2)
    outer = Integrand(lambda x: x[0] ** 2 + x[1] ** 2 + 10 * x[2], 3)
    x = np.random.default_rng(3).random((3, 50)) * 0.9 + 0.1
    assert outer.compose(polar, coordinate(2, box)).evaluate(x) == pytest.approx(x[0] ** 2 + 10 * x[2])
    with pytest.raises(IntegrationError, match="its function ranges over"):
        outer.compose(2 * polar, coordinate(2, box))


@pytest.mark.parametrize("on", ["host", "device"])
@pytest.mark.parametrize("inner", ["mean", "strata", "sequence", "density"])
def test_integrals_of_many_points_at_once(inner, on):
    """Of several values, over parameters in any order and of different domains, by every integrator that can."""
    domain = [(0, 2), (0, 1), (-1, 1)]  # (x y, x + z), integrated over z and x: 4 y and 4
    f = Integrand(lambda x: [x[0] * x[1], x[0] + x[2]], domain, on=on, values=2)
    tilted = ProductDensity.tabulated(Integrand(lambda x: 1 + x[0] + x[1], [(0, 2), (-1, 1)]), bins=8)
    methods = {
        "mean": MeanSample(),
        "strata": Stratified(),
        "sequence": QuasiMonteCarlo(),
        "density": Importance(tilted),
    }
    marginal = integral(f, [2, 0], methods[inner], samples=19)
    assert marginal.values == 2 and marginal.domain == Box.of(1)
    y = np.array([0.1, 0.5, 0.5, 0.9])
    if on == "device":
        import mitsuba as mi

        many = np.array([np.array(marginal.evaluate([mi.Float(np.float32(y))])) for _ in range(200)], dtype=float)
    else:
        many = np.array([marginal.evaluate([y]) for _ in range(200)])
    assert many.shape == (200, 2, 4)
    error = many.std(axis=0, ddof=1) / math.sqrt(len(many))
    z = (many.mean(axis=0) - np.array([4 * y, 4 * np.ones(4)])) / error
    assert (z**2).sum() < 40  # chi-square of 8 at 3e-6
    # Two integrals at the same point are independent of each other.
    a, b = many[:, :, 1], many[:, :, 2]
    assert abs(np.corrcoef((a - a.mean(axis=0)).ravel(), (b - b.mean(axis=0)).ravel())[0, 1]) < 4.5 / math.sqrt(400)


@pytest.mark.parametrize(("better", "gain"), [(Stratified(), 4.0), (QuasiMonteCarlo(), 8.0)])
def test_even_points_help_many_integrals(better, gain):
    """Variance of smooth inner integrals against that of independent points, 64 samples each."""
    y = np.linspace(0, 1, 500)[None]

    def variance(method):
        smooth = Integrand(lambda x: np.exp(-x[0] * x[1] - x[2]), 3)
        return (integral(smooth, [1, 2], method, samples=64).evaluate(y) - exact).var()

    exact = (1 - np.exp(-1)) * np.where(y[0] > 0, -np.expm1(-y[0]) / np.maximum(y[0], 1e-9), 1.0)
    assert variance(better) * gain < variance(MeanSample())


def test_an_integral_has_the_range_of_its_values():
    for known, expected in (((0.5, math.inf), (0.05, math.inf)), ((-math.inf, 5.0), (-math.inf, 0.5))):
        marginal = integral(Integrand(lambda x: x[0], [(0, 1), (0, 0.1)], known), [1])
        assert marginal.range == pytest.approx(expected)


@pytest.mark.parametrize("inner", [MeanSample(), Stratified(), QuasiMonteCarlo(replicates=2)])
def test_an_integral_is_a_function_of_the_other_parameters(inner):
    f = Integrand(lambda x: x[0] * x[1] * x[1] + x[2], [(0, 1), (0, 2), (0, 1)])
    marginal = integral(f, [1], inner, samples=8)  # 8/3 x + 2 z
    assert marginal.domain == Box.of(2)
    many = np.stack([values(marginal, POINTS[:, :20]) for _ in range(300)])
    error = many.std(axis=0, ddof=1) / math.sqrt(len(many))
    z = (many.mean(axis=0) - (8 / 3 * POINTS[0, :20] + 2 * POINTS[1, :20])) / error
    assert (z**2).sum() < 60  # chi-square of 20 at 1e-5
    assert_unbiased(runs(MeanSample(), marginal, 50, 30), 4 / 3 + 1)


@pytest.mark.parametrize("on", ["host", "device"])
def test_inner_points_are_not_those_of_the_outer_integrator(on):
    """With the seeds that both have by default."""
    seen = []
    f = Integrand(lambda x: (seen.append([np.array(v) for v in x]), x[0] + x[1])[1], 2, on=on)
    MeanSample().integrate(integral(f, [1], samples=1), 100)
    ((outer, inner),) = seen
    # Numbers of single precision, of 23 bits: less than 0.01 of 100 are equal by chance to the number beside them.
    assert len(outer) == len(inner) == 100 and not (outer == inner).any()


def test_neighbouring_points_of_neighbouring_seeds_are_independent():
    """Of an inner integrator that takes one integral at a time."""
    found = []
    f = Integrand(lambda x: (found[-1].append(x[1]), x[0] + x[1])[1], 2)
    for seed in (0, 1, 2):
        marginal = integral(f, [1], Vegas(iterations=2), samples=64, seed=seed)
        for _ in range(2):
            found.append([])
            marginal.evaluate(np.array([[0.1, 0.2, 0.3]]))
    every = np.concatenate([np.ravel(x) for x in map(np.concatenate, found)])
    assert len(every) >= 6 * 3 * 32 and len(np.unique(every)) == len(every)


@pytest.mark.parametrize("on", ["host", "device"])
def test_an_integral_equation_by_recursion(on):
    """L(x) = x + int x y / 2 L(y) dy in miniature what light does; L = x (1 + int y/2 L dy) gives L = 6/5 x."""
    box = Box.of(2)
    kernel = Integrand(lambda x: 0.5 * x[0] * x[1], box, on=on)
    emitted = Integrand(lambda x: x[0], 1, on=on)
    radiance = emitted
    for bounce in range(4):
        radiance = emitted + integral(kernel * radiance.of([1], box), [1], samples=2, seed=bounce)
    # After n bounces: x (1 + 1/6 + ... + 6^-n).
    expected = 0.5 * sum(6.0**-n for n in range(5))
    found = runs(MeanSample(), radiance, 500, 30)
    assert_unbiased(found, expected)
    assert len({e.value for e in found}) == 30


def test_a_function_of_one_side_runs_there():
    seen = []

    def f(x):
        seen.append(type(x[0]).__module__.split(".")[0])
        return x[0]

    MeanSample().integrate(Integrand(f, 1), 10)
    MeanSample().integrate(Integrand(f, 1, on="either"), 10)
    MeanSample().integrate(Integrand(f, 1, on="device"), 10)
    assert seen == ["numpy", "numpy", "drjit"]
