"""Every integrator against closed forms: unbiased over many seeds, honest about its error, on host and device."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.integrals import KNOWN, assert_honest, assert_unbiased, known, runs, spread, two_peaks
from support.tables import crossed, thinned

from etendue.integration import (
    Box,
    ControlVariate,
    Estimate,
    HitOrMiss,
    Importance,
    Integrand,
    IntegrationError,
    MeanSample,
    ProductDensity,
    QuasiMonteCarlo,
    RecursiveStratified,
    Stratified,
    Vegas,
    Warp,
    array_namespace,
    average,
    combine,
    constant,
    coordinate,
)
from etendue.points import Halton

#: name: (integrator of an integrand, samples, degrees of freedom of its error).
TABLE = {
    "mean sample": (lambda f: MeanSample(), 1000, math.inf),
    "hit-or-miss": (lambda f: HitOrMiss(), 1000, math.inf),
    "stratified": (lambda f: Stratified(), 1000, math.inf),
    "stratified 3": (lambda f: Stratified(3), 1000, math.inf),
    "quasi-Monte Carlo": (lambda f: QuasiMonteCarlo(), 1024, 15),
    "Halton": (lambda f: QuasiMonteCarlo(Halton, replicates=10), 1000, 9),
    "control variate": (lambda f: ControlVariate(coordinate(1, f.domain), middle(f.domain, 1)), 1000, math.inf),
    "fitted": (lambda f: ControlVariate(coordinate(1, f.domain), middle(f.domain, 1), factor=None), 2000, math.inf),
    "importance": (lambda f: Importance(slanted(f.domain)), 1000, math.inf),
    "vegas": (lambda f: Vegas(iterations=4, warm_up=1), 8000, math.inf),
    "vegas random": (lambda f: Vegas(iterations=4, warm_up=1, strata=1), 8000, math.inf),
    "vegas stratified": (lambda f: Vegas(iterations=4, warm_up=1, mode="stratified"), 8000, math.inf),
    "vegas pairs": (lambda f: Vegas([[0, 1]], iterations=4, warm_up=1), 8000, math.inf),
    "recursive": (lambda f: RecursiveStratified(), 4000, math.inf),
    "recursive vegas": (lambda f: RecursiveStratified("maximum", 3, borders="vegas"), 4000, math.inf),
}


def middle(box, axis):
    """Integral of a coordinate."""
    return box.volume * (box.lower[axis] + box.upper[axis]) / 2


def slanted(box):
    """p(x) = (1 + u_0) 2/3 / V, u_0 the first coordinate brought to [0, 1], by its inverse."""

    def sample(u):
        first = array_namespace(u[0]).sqrt(1.0 + 3.0 * u[0]) - 1.0
        return list(box.from_unit([first, *list(u)[1:]]))

    return Warp(box, sample, lambda x: (1.0 + box.to_unit(x)[0]) * (2 / 3 / box.volume))


@pytest.mark.parametrize(("name", "function"), crossed(sorted(TABLE), sorted(KNOWN), 4))
def test_unbiased_and_honest(name, function):
    f, integral = known(function)
    make, samples, freedom = TABLE[name]
    found = runs(make(f), f, samples, 100)
    assert all(0.5 * samples < e.samples <= samples for e in found)
    assert_unbiased(found, integral, name)
    if spread(found) > (1e-12 * integral) ** 2:  # a plane is exact for some
        assert_honest(found, integral, name, freedom)


@pytest.mark.parametrize("name", thinned(sorted(TABLE), sorted(TABLE)[::2]))
def test_the_device_estimates_the_same(name):
    f, integral = known("decay", "device")
    make, samples, freedom = TABLE[name]
    found = runs(make(f), f, samples, 40)
    assert_unbiased(found, integral, name)
    assert_honest(found, integral, name, freedom)
    on_host = runs(make(f), known("decay")[0], samples, 40)
    ratio = math.sqrt(spread(found) / spread(on_host))
    assert 0.5 < ratio < 2.0, f"{name}: errors on the device are {ratio:.2f} of those on the host"


def test_the_same_points_give_the_same_estimate_on_host_and_device():
    for points in (QuasiMonteCarlo(), QuasiMonteCarlo(Halton)):
        host = points.integrate(known("decay")[0], 4096, seed=5)
        device = points.integrate(known("decay", "device")[0], 4096, seed=5)
        assert device.value == pytest.approx(host.value, rel=1e-6)
        assert device.details["replicates"] == pytest.approx(host.details["replicates"], rel=1e-6)


@pytest.mark.parametrize("on", ["host", "device"])
@pytest.mark.parametrize("name", sorted(TABLE))
def test_a_seed_decides_the_estimate(name, on):
    f, _ = known("decay", on)
    make, samples, _ = TABLE[name]
    one, other = (make(f).integrate(f, samples, seed=s) for s in (1, 2))
    assert make(f).integrate(f, samples, seed=1).value == pytest.approx(one.value, rel=1e-6)
    assert one.value != other.value


def test_batches_do_not_change_what_is_estimated(monkeypatch):
    from etendue.integration import HostBackend

    f, integral = known("bell")
    whole = Stratified(6).integrate(f, 6**3 * 4, seed=3)
    monkeypatch.setattr(HostBackend, "batch", 300)
    for make, samples, freedom in list(TABLE.values())[::4]:
        assert_honest(runs(make(f), f, samples, 60), integral, freedom=freedom)
    parts = Stratified(6).integrate(f, 6**3 * 4, seed=3)
    assert parts.samples == whole.samples and parts.value == pytest.approx(whole.value, abs=6 * whole.standard_error)


def test_variance_falls_as_theory_says():
    """On a smooth function in two dimensions: 1/N for random points, 1/N^2 for strata, faster for scrambled nets."""
    f, _ = known("decay")
    for method, least, most in (
        (MeanSample(), 0.85, 1.15),
        (Stratified(), 1.85, 2.15),
        (QuasiMonteCarlo(replicates=2), 2.4, 4.0),
    ):
        sizes = [128, 2048]
        few, many = (spread(runs(method, f, n, 200)) for n in sizes)
        slope = math.log(few / many) / math.log(sizes[1] / sizes[0])
        assert least < slope < most, f"{type(method).__name__}: variance falls as N^-{slope:.2f}"


def test_halton_beats_random_points_and_goes_on():
    """Check 4 of the framework's list."""
    f, integral = known("decay")
    points = QuasiMonteCarlo(Halton, replicates=2)
    rms = [math.sqrt(np.mean([(e.value - integral) ** 2 for e in runs(points, f, n, 100)])) for n in (128, 8192)]
    assert math.log(rms[0] / rms[1]) / math.log(8192 / 128) > 0.7


def test_importance_by_the_integrand_itself_is_exact():
    box = Box.of(1)
    f = Integrand(lambda x: 1.0 + x[0], box)
    result = Importance(slanted(box)).integrate(f, 100)
    assert result.value == pytest.approx(1.5, rel=1e-12) and result.standard_error < 1e-12


def test_a_tabulated_density_lowers_the_variance():
    f, integral = known("decay")
    plain, tabulated = (runs(m, f, 1000, 60) for m in (MeanSample(), Importance(ProductDensity.tabulated(f))))
    assert_unbiased(tabulated, integral)
    assert spread(tabulated) < spread(plain) / 50


def test_a_control_variate_takes_away_what_it_knows():
    f, _ = known("plane")
    g = coordinate(0, f.domain) + 2 * coordinate(1, f.domain)
    exact = ControlVariate(g, 9.0).integrate(f, 100)
    assert exact.value == pytest.approx(9.0) and exact.standard_error < 1e-12
    fitted = ControlVariate(3 * g, 27.0, factor=None).integrate(f, 200)
    assert fitted.details["factor"] == pytest.approx(1 / 3) and fitted.value == pytest.approx(9.0)


def test_a_part_of_the_domain():
    f, _ = known("plane")
    assert_unbiased(runs(Stratified(), f, 200, 50), 9.0)
    part = [Stratified().integrate(f, 200, seed=s, domain=[(0, 0.5), (2, 3)]) for s in range(50)]
    assert_unbiased(part, 0.5 * (0.25 + 5.0))


def test_combination_by_inverse_variances():
    a, b = Estimate(1.0, 0.1, 10), Estimate(2.0, 0.2, 20, 3)
    both = combine([a, b])
    assert both.value == pytest.approx((1 / 0.01 + 2 / 0.04) / (1 / 0.01 + 1 / 0.04))
    assert both.standard_error == pytest.approx(math.sqrt(1 / (1 / 0.01 + 1 / 0.04)))
    assert (both.samples, both.rejected, both.details["degrees"]) == (30, 3, 1)
    assert both.details["chi2"] == pytest.approx(1.0 / (0.01 + 0.04))
    assert combine([Estimate(0.0, 0.0, 10), b]).value == pytest.approx(1.0)  # a lucky zero does not silence the rest
    alike = average([a, b])
    assert alike.value == pytest.approx((10 * 1.0 + 20 * 2.0) / 30) and alike.samples == 30
    assert alike.variance == pytest.approx(2 * ((1 / 3 * 2 / 3) ** 2 + (2 / 3 * 1 / 3) ** 2))  # they scatter more
    assert average([a, a]).variance == pytest.approx(0.1**2 / 2)
    for mean in (combine, average):
        with pytest.raises(IntegrationError, match="no estimates"):
            mean([])


@pytest.mark.parametrize(
    ("method", "dimension"),
    [(Stratified(), 1), (Vegas(iterations=1), 1), (Stratified(), 3), (Vegas([[0, 1, 2]], iterations=1), 3)],
)
def test_many_strata_in_single_precision(method, dimension):
    """Each stratum is still jittered: the estimate agrees with its standard error, and no point leaves the domain."""
    largest = []

    def f(x):
        largest.append(float(np.max(np.array(x[0]))))
        return x[0] * x[0]

    assert_honest(runs(method, Integrand(f, dimension, on="device"), 1 << 18, 20), 1 / 3)
    assert 0.99 < max(largest) <= 1.0


# What is not finite, and other bad input ----------------------------------------------------------------------------


@pytest.mark.parametrize("on", ["host", "device"])
@pytest.mark.parametrize("name", sorted(TABLE))
def test_what_is_not_finite_is_counted_and_left_out(name, on, caplog):
    """Below 1/2 the root of x - 1/2 does not exist: there the function counts as zero."""
    f = Integrand(lambda x: array_namespace(x[0]).sqrt(x[0] - 0.5) * (x[1] + 1.0), 2, (0.0, 2.0), on)
    make, samples, _ = TABLE[name]
    with np.errstate(invalid="ignore"):
        found = runs(make(f), f, samples, 30)
    assert_unbiased(found, 0.5**1.5 / 1.5 * 1.5, name)
    assert all(0 < e.rejected < e.samples for e in found)
    if "vegas" not in name and "recursive" not in name and name != "importance":
        assert np.mean([e.rejected / e.samples for e in found]) == pytest.approx(0.5, abs=0.05)
    assert f"{found[0].rejected} of {found[0].samples} values of the integrand were not finite" in caplog.text
    assert math.isfinite(found[0].standard_error)


@pytest.mark.parametrize("on", ["host", "device"])
def test_nothing_finite_is_an_error(on):
    f = Integrand(lambda x: x[0] * math.nan, 2, (0.0, 1.0), on)
    for make, samples, _ in TABLE.values():
        with pytest.raises(IntegrationError, match=r"none of .* values of the integrand was finite"):
            make(f).integrate(f, samples)


SQUARE = Integrand(lambda x: x[0] * x[1], 2)
TEN = Integrand(lambda x: x[0] * x[1], 10)
LINE = Integrand(lambda x: x[0], 1, on="device")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Integrand(lambda x: x[0], [(1, 1)]), "empty or infinite domain: dimension 0 runs from 1 to 1"),
        (lambda: Integrand(lambda x: x[0], [(0, 1), (3, 2)]), "dimension 1 runs from 3 to 2"),
        (lambda: Integrand(lambda x: x[0], [(0, math.inf)]), "from 0 to inf"),
        (lambda: Integrand(lambda x: x[0], [(0, math.nan)]), "from 0 to nan"),
        (lambda: Integrand(lambda x: x[0], 0), "a domain needs"),
        (lambda: Integrand(lambda x: x[0], [3, 4]), "pairs"),
        (lambda: Integrand(lambda x: x[0], 1, (2, 1)), "range"),
        (lambda: Integrand(lambda x: x[0], 1, on="moon"), "'host', 'device' or 'either'"),
        (lambda: MeanSample().integrate(SQUARE, 1), "at least 2, not 1"),
        (lambda: MeanSample().integrate(SQUARE, 10.5), "whole number"),
        (lambda: MeanSample().integrate(lambda x: x[0], 10), "takes an Integrand, not function"),
        (lambda: MeanSample().integrate(SQUARE, 10, domain=[(0, 2), (0, 1)]), "not within"),
        (lambda: HitOrMiss().integrate(SQUARE, 10), "needs the bounds"),
        (lambda: HitOrMiss().integrate(Integrand(lambda x: 2 * x[0], 1, (0, 1)), 100), "leave the declared range"),
        (
            lambda: Stratified().integrate(TEN, 1000),
            "too few to stratify 10 dimensions into 2 parts each: at least 2048",
        ),
        (lambda: Stratified(5).integrate(SQUARE, 49), "at least 50"),
        (lambda: Stratified(0), "at least one stratum"),
        (lambda: Stratified(70_000).integrate(LINE, 1_000_000), "too many for single precision: at most 65536"),
        (lambda: Vegas(strata=70_000, iterations=1).integrate(LINE, 1_000_000), "too many for single precision"),
        (lambda: QuasiMonteCarlo().integrate(SQUARE, 15), "too few for 16 randomisations"),
        (lambda: QuasiMonteCarlo(replicates=1), "2 randomisations or more"),
        (lambda: QuasiMonteCarlo(Halton(1)).integrate(SQUARE, 100), "has 1 dimensions, the integrand 2"),
        (lambda: Importance(Warp(2, list, lambda x: 2.0)).integrate(SQUARE, 1000), "not normalised"),
        (lambda: Importance(Warp(2, list, lambda x: 0.5)).integrate(SQUARE, 1000), "integrates to about 0.5"),
        (lambda: Importance(Warp(2, list, lambda x: 0.5 + x[0])).integrate(SQUARE, 1000), "does not match its samples"),
        (lambda: Importance(Warp(3, list, lambda x: 1.0)).integrate(SQUARE, 1000), "the density is on"),
        (lambda: ProductDensity.tabulated(constant(0.0, 1)), "zero everywhere: not normalisable"),
        (lambda: ProductDensity.tabulated(Integrand(lambda x: 1 / (x[0] - 0.5 / 64), 1)), "not finite"),
        (lambda: ControlVariate(constant(1.0, 3), 1.0).integrate(SQUARE, 10), "the control variate is on"),
        (lambda: ControlVariate(SQUARE, 0.25, factor=None).integrate(SQUARE, 50), "too few to fit"),
        (lambda: Vegas(mode="best"), "mode is"),
        (lambda: Vegas(iterations=3, warm_up=3), "at least one must count"),
        (lambda: Vegas(inertia=0), "inertia"),
        (lambda: Vegas(bins=0), "at least 1"),
        (lambda: Vegas().integrate(SQUARE, 15), "too few for 10 iterations"),
        (lambda: Vegas(strata=9).integrate(SQUARE, 1000), "into 9 parts each: at least 162"),
        (lambda: Vegas([[0, 1]], bins=9).integrate(SQUARE, 1000), "too few for 9 bins an axis in 2 dimensions"),
        (lambda: Vegas([[0], [0]]).integrate(SQUARE, 1000), "each may occur once"),
        (lambda: Vegas([[0], [2]]).integrate(SQUARE, 1000), "from 0 to 1"),
        (lambda: Vegas([[]]).integrate(SQUARE, 1000), "is empty"),
        (lambda: RecursiveStratified("entropy"), "the metric is one of range, maximum, variance"),
        (lambda: RecursiveStratified(divisions=1), "must be 2 or more"),
        (lambda: RecursiveStratified(borders="odd"), "'equal' or 'vegas'"),
        (lambda: RecursiveStratified(borders="vegas", dither=0.5), "dither moves the borders of equal parts only"),
        (lambda: RecursiveStratified(weights=[0, 0]), "nor all zero"),
        (lambda: RecursiveStratified(weights=[1]).integrate(SQUARE, 1000), "1 weights for 2 dimensions"),
        (lambda: RecursiveStratified(initial_depth=9).integrate(SQUARE, 1000), "too few for 9 initial levels"),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with np.errstate(divide="ignore"), pytest.raises(IntegrationError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_narrow_peaks_are_worth_adapting_to():
    """Both adaptive integrators against plain Monte Carlo at equal evaluations."""
    f, integral = two_peaks(narrow=200.0)
    plain = spread(runs(MeanSample(), f, 10_000, 60))
    for method in (RecursiveStratified(), Vegas([[0, 1]], iterations=5, warm_up=2)):
        found = runs(method, f, 10_000, 60)
        assert_unbiased(found, integral, type(method).__name__)
        assert spread(found) < plain / 5
