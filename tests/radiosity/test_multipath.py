"""Multipath: against closed forms and the direct solution, by measured errors; which engines it takes."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import adjacent, cube, opposite, room

from etendue.points import Halton, Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    Bundles,
    ChainedRays,
    Patches,
    RadiosityError,
    RayScene,
    SpherePairs,
    box,
    joined,
    multipath,
    multipath_bundles,
)
from etendue.radiosity.lines.spiral import ShuffledPoints, SpiralPoints


def lit_cube(reflectance=0.6):
    """The unit cube, one patch a wall, one of them lit; and its radiosities in closed form."""
    patches = cube(1, reflectance=reflectance, emission=(np.arange(6) == 0).astype(float)[:, None])
    facing = np.linalg.norm(patches.centres[:, None] - patches.centres, axis=2) > 0.99
    factors = np.where(facing, opposite(1, 1), adjacent(1, 1)) * (1 - np.eye(6))
    assert factors.sum(axis=1) == pytest.approx(1, abs=1e-12)
    return patches, np.linalg.solve(np.eye(6) - reflectance * factors, patches.emission)


class Pieces(ABuffer):
    """Casts so many bundles at once."""

    size = 8

    def piece(self, count):
        return self.size


def pieces_of(size, *arguments, **options):
    engine = Pieces(*arguments, **options)
    engine.size = size
    return engine


def assert_power_is_conserved(result, own):
    out = result.absorbed + result.to_sky + result.unshot.sum(axis=0)
    np.testing.assert_allclose(result.sent, out, rtol=1e-9)
    np.testing.assert_allclose(out, own, rtol=1e-6)


def assert_within_errors(found, exact):
    """Each within 3 standard errors of the mean over the first axis."""
    found = np.array(found)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    deviation = np.abs(found.mean(axis=0) - exact) / error
    assert deviation.max() < 3, deviation


def test_the_closed_form_of_a_lit_cube():
    _, exact = lit_cube()
    assert exact[0, 0] == pytest.approx(1.1607, abs=5e-5)
    np.testing.assert_allclose(exact[1:], 0.2679, atol=1.5e-4)


# ---------------------------------------------------------------------- line by line


@pytest.mark.parametrize("lines", [None, 64])
def test_parallel_lines_are_refused(lines):
    """On bundles the lit wall of the cube came to 1.54 for 1.16, however many there were."""
    patches, _ = lit_cube()
    engines = [ABuffer(patches, lines=lines)]
    if lines is not None:
        engines.append(ChainedRays(Bundles(patches, lines), RayScene(patches)))
    for engine in engines:
        assert engine.shares_directions
        with pytest.raises(RadiosityError, match=r"take multipath_bundles\(\), or one line per bundle") as error:
            multipath(engine, 64)
        assert type(engine).__name__ in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "kind",
    ["sphere pairs", "bundles of one line", pytest.param("one line of an A-buffer", marks=pytest.mark.slow)],
)
def test_lines_of_their_own_directions_come_to_the_closed_form(kind):
    patches, exact = lit_cube()
    found = []
    for seed in range(8):
        points = Independent(4, seed=seed)
        if kind == "one line of an A-buffer":
            engine = ABuffer(patches, points, 1)
        else:
            generator = SpherePairs(patches) if kind == "sphere pairs" else Bundles(patches, 1)
            engine = ChainedRays(generator, RayScene(patches), points)
        assert not engine.shares_directions
        result = multipath(engine, 1 << 12)
        out = result.absorbed + result.to_sky + result.unshot.sum(axis=0)
        np.testing.assert_allclose(result.sent, out, rtol=1e-9)
        found.append([result.radiosity[0, 0], result.radiosity[1:, 0].mean()])
    assert_within_errors(found, [exact[0, 0], exact[1:, 0].mean()])


# ---------------------------------------------------------------------- bundle by bundle


@pytest.mark.parametrize(
    ("size", "lines", "seeds", "count"),
    [
        (8, 5, 16, 64),
        *(pytest.param(size, lines, 32, 256, marks=pytest.mark.slow) for size in (1, 8, 64) for lines in (5, 300)),
    ],
)
def test_bundles_come_to_the_closed_form(size, lines, seeds, count):
    """One line a patch and bundle, and 64: no bias, and bounded variance. When each line took an equal part of what
    was unshot, unlit walls lost 20 % of their light with 64 bundles in pieces of 8, and 3 % with 512."""
    patches, exact = lit_cube()
    found = []
    for seed in range(seeds):
        result = multipath_bundles(pieces_of(size, patches, SpiralPoints(seed, count), lines), count)
        assert_power_is_conserved(result, 1.0)
        found.append([result.radiosity[0, 0], result.radiosity[1:, 0].mean()])
    assert_within_errors(found, [exact[0, 0], exact[1:, 0].mean()])
    # Independent bundles of many lines have 0.1 / sqrt(count).
    assert np.std(found, axis=0).max() < 0.12 / np.sqrt(count)


@pytest.mark.parametrize("points", [None, Halton(4), OwenSobol(4, seed=3)])
def test_the_size_of_a_piece_changes_nothing(points):
    patches = cube(2, reflectance=0.5, emission=np.arange(24.0)[:, None])
    results = [multipath_bundles(pieces_of(size, patches, points, 200), 48, 16) for size in (1, 8, 64)]
    for result in results[1:]:
        assert np.array_equal(result.radiosity, results[0].radiosity)


def test_backends_give_the_same():
    patches = cube(1, reflectance=0.5, emission=np.arange(6.0)[:, None])
    one, other = (
        multipath_bundles(ABuffer(patches, OwenSobol(4, seed=3), 200, backend=backend), 64)
        for backend in ("compiled", "drjit")
    )
    np.testing.assert_allclose(one.radiosity, other.radiosity, rtol=1e-5)


def test_single_lines_are_no_bundles():
    patches, _ = lit_cube()
    engine = ChainedRays.through(RayScene(patches))
    with pytest.raises(RadiosityError, match=r"single lines: take multipath\(\)"):
        multipath_bundles(engine, 8)
    for call in (multipath, multipath_bundles):
        with pytest.raises(RadiosityError, match="multipath needs at least one point, not 0"):
            call(ABuffer(patches, lines=1), 0)


@pytest.mark.parametrize("lines", [1, 30, 1000])
def test_no_bundle_has_more_lines_through_a_patch_than_stated(lines):
    """What the bound on the variance rests on: of flat patches, and of a bent sheet that is two of them."""
    sheet = np.array([[0.2, 0.2, 0.5], [0.8, 0.2, 0.4], [0.8, 0.8, 0.6], [0.2, 0.8, 0.7]])
    hung = joined(box((0, 0, 0), (1, 1, 1), 1, inward=True), (sheet, np.array([[0, 1, 2, 3]])))
    curved = Patches(*hung, two_sided=np.arange(7) == 6)
    for patches in (curved, room(2)):
        engine = ABuffer(patches, Independent(4, seed=5), lines)
        most = engine.bundles.most(patches)
        met = np.zeros(len(patches), dtype=int)
        for pairs in engine.stream(400, 0, 1):
            met = np.maximum(met, np.bincount(pairs.ravel(), minlength=len(patches) + 2)[:-2])
        assert (met <= most).all()
        if lines == 1000:
            assert (met > 0.4 * most).all()


def test_points_in_random_order():
    for base in (OwenSobol(4, seed=2), SpiralPoints(2, 64), Halton(4)):
        shuffled, plain = ShuffledPoints(base, 64, 32).block(64, 32), base.block(64, 32)
        assert not np.array_equal(shuffled, plain)
        assert np.array_equal(shuffled[np.lexsort(shuffled.T)], plain[np.lexsort(plain.T)])
        assert np.array_equal(shuffled, ShuffledPoints(base, 64, 32).block(64, 32))
    # Which comes first differs from seed to seed.
    firsts = [Halton(4).randomised(seed) for seed in range(8)]
    places = [
        int(np.flatnonzero((base.block(64) == ShuffledPoints(base, 64).block(1)).all(axis=1))[0]) for base in firsts
    ]
    assert len(set(places)) > 4
