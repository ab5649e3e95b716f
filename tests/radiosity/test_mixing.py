"""Small patches, which few lines meet: local rays among the segments, unbiased and symmetric."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, cube, joined, square

from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    MixedSegments,
    Patches,
    RadiosityError,
    RayScene,
    Segments,
    form_factors,
    local_form_factors,
    save_segments,
    solve,
    with_local_rays,
)


def pebbles(missing=0, **properties):
    """Two tiny boxes beside each other in a room, the last 12 patches; without some of its walls it is open."""
    boxes = [box((x, 0.3, 0.4), (x + 0.01, 0.31, 0.41)) for x in (0.6, 0.615)]
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), *boxes)
    return Patches(vertices, faces[missing:], **properties)


def cast(patches, points, bundles=64, lines=400):
    return ABuffer(patches, points, lines).cast(bundles)


def test_patches_that_are_alike_get_no_rays():
    segments = cast(cube(2), OwenSobol(4))
    assert with_local_rays(segments) is segments
    assert with_local_rays(cast(pebbles(), OwenSobol(4)), least=0).extra is None


def test_batches_may_have_no_lines():
    lines = cast(pebbles(), OwenSobol(4, seed=1))
    batches = [0] * (len(lines.chunks) - 1) + [3]
    segments = with_local_rays(Segments(lines.patches, lines.chunks, batches, lines.expected), least=64)
    np.testing.assert_allclose(segments.gather(np.ones(len(lines.patches)), 1.0), 1)


@pytest.mark.parametrize("missing", [0, 4])
def test_rows_are_whole_and_symmetric(missing):
    patches = pebbles(missing)
    lines = cast(patches, OwenSobol(4, seed=1))
    assert len(lines.unseen) > 0
    segments = with_local_rays(lines, least=64)
    assert isinstance(segments, MixedSegments) and segments.rays == 12 * 64
    assert len(segments.unseen) == 0 and (segments.extra[:-12] == 0).all() and segments.to_dark.sum() == 0
    np.testing.assert_allclose(segments.gather(np.ones(len(patches)), 1.0), 1)
    factors = form_factors(segments)
    np.testing.assert_allclose(factors.row_sums(), 1)
    assert factors.exchange_weights is not None
    values = np.random.default_rng(2).uniform(size=(len(patches), 2))
    np.testing.assert_allclose(factors.gather(values, 0.3), segments.gather(values, 0.3))
    np.testing.assert_allclose(factors.sky, segments.sky)
    assert (missing > 0) == (segments.to_sky.sum() > 0)
    # 64 rays and hardly a line: the error of a factor is that of as many hits; of twice as many between two of them.
    first = len(patches) - 12
    entries = factors.matrix.data[factors.matrix.indptr[first] :]
    rays = np.where(factors.matrix.indices[factors.matrix.indptr[first] :] < first, 64, 128)
    errors = factors.errors.data[factors.errors.indptr[first] :]
    np.testing.assert_allclose(errors, np.sqrt(entries * (1 - entries) / rays), rtol=0.1)


@pytest.mark.parametrize("missing", [0, 4])
def test_sums_have_the_mean_of_lines_alone_and_the_error_of_rays(missing):
    """Over seeds: small patches against many rays from them, the walls against many lines; errors by the scatter."""
    patches = pebbles(missing)
    scene, small = RayScene(patches), np.arange(len(patches) - 12, len(patches))
    values = np.exp(patches.centres @ [1.0, 2.0, -1.0])
    values[small] = 50.0
    exact = cast(patches, OwenSobol(4, seed=7), 2048, 20_000).gather(values, 2.0)
    exact[small] = local_form_factors(scene, 1 << 14, rows=small).gather(values, 2.0)[small]
    runs = [
        with_local_rays(
            cast(patches, Independent(4, seed=seed)), scene, least=64, points=Independent(4, seed=100 + seed)
        )
        for seed in range(16)
    ]
    found = np.array([run.gather(values, 2.0) for run in runs])
    errors = np.array([run.gather_error(values, 2.0) for run in runs])
    scatter = found.std(axis=0, ddof=1)
    deviation = (found.mean(axis=0) - exact) / (scatter / 4 + 2e-3 * exact)
    assert np.sqrt((deviation**2).mean()) < 1.5
    for chosen in (small, np.arange(len(patches) - 12)):
        assert np.sqrt((errors[:, chosen] ** 2).mean()) == pytest.approx(
            np.sqrt((scatter[chosen] ** 2).mean()), rel=0.25
        )
    # Small patches weigh as much as their area asks for, to the scatter of 64 rays and the lines.
    counted = np.mean([run.counted for run in runs], axis=0)
    np.testing.assert_allclose(counted[small], runs[0].expected[small], rtol=0.05)
    assert (scatter[small] < 0.2 * exact[small]).all()


def test_solutions_on_them():
    """By conjugate gradient, which needs the symmetry, and by elimination on the matrix."""
    reflectance = np.random.default_rng(1).uniform(0.1, 0.8, len(pebbles()))
    patches = pebbles(reflectance=reflectance, emission=np.arange(len(reflectance)) % 5 == 0)
    segments = with_local_rays(cast(patches, OwenSobol(4, seed=1)), least=64)
    found = solve(patches, segments, "conjugate-gradient", tolerance=1e-10)
    exact = solve(patches, form_factors(segments), "direct", tolerance=1e-10)
    np.testing.assert_allclose(found.radiosity, exact.radiosity, rtol=1e-7)
    assert (found.irradiance_error(segments) > 0).all()


def test_a_small_patch_that_sees_itself():
    """The inside of a tiny box is one patch: all of its lines and rays stay there."""
    tiny = box((0.5, 0.5, 0.5), (0.51, 0.51, 0.51), inward=True)
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), box((0.45,) * 3, (0.55,) * 3), tiny)
    ids = np.minimum(np.arange(len(faces)), len(faces) - 6)
    patches = Patches(vertices, faces, ids=ids)
    segments = with_local_rays(cast(patches, OwenSobol(4, seed=1)), least=128)
    assert segments.extra[-1] > 0
    factors = form_factors(segments)
    assert factors.matrix[len(patches) - 1, len(patches) - 1] == pytest.approx(1)
    assert segments.counted[-1] == pytest.approx(segments.expected[-1], rel=0.3)


def test_rays_are_never_many_more_than_an_eighth_of_the_segments():
    vertices, faces = joined(square((0, 0, 0), (9, 0, 0), (0, 9, 0)), box((4, 4, 1), (4.1, 4.1, 1.1), 4))
    segments = ABuffer(Patches(vertices, faces), OwenSobol(4), 300).cast(100)
    mixed = with_local_rays(segments, least=1 << 12)
    assert 0 < mixed.rays <= len(segments) / 8
    each = mixed.rays // np.count_nonzero(mixed.extra)
    assert each in (1, 2, 4, 8, 16, 32, 64, 128) and mixed.rays == each * np.count_nonzero(mixed.extra)


def test_what_cannot_be_mixed():
    segments = cast(pebbles(), OwenSobol(4, seed=1))
    mixed = with_local_rays(segments)
    with pytest.raises(RadiosityError, match="have local rays already"):
        with_local_rays(mixed)
    for one, other in ((mixed, segments), (segments, mixed)):
        with pytest.raises(RadiosityError, match="cannot be added"):
            one + other
    with pytest.raises(RadiosityError, match="segments with local rays cannot be saved"):
        save_segments("mixed.nc", mixed)


@pytest.mark.parametrize("rays", [1, 2])
def test_errors_of_patches_with_fewer_rays_than_there_are_batches(rays):
    """Mean square of the errors against the variance over seeds, both known to 7 % by 40 seeds of 12 patches."""
    patches = pebbles()
    scene, small = RayScene(patches), np.arange(len(patches) - 12, len(patches))
    values = np.exp(patches.centres @ [1.0, 2.0, -1.0])
    found, errors = [], []
    for seed in range(40):
        lines = cast(patches, Independent(4, seed=seed), bundles=128, lines=10)
        run = with_local_rays(lines, scene, least=rays, points=Independent(4, seed=100 + seed))
        found.append(run.gather(values)[small])
        errors.append(run.gather_error(values)[small])
        assert run.batch_count == 16 and run.rays == 12 * max(rays, 2)
    assert np.square(errors).mean() == pytest.approx(np.var(found, axis=0, ddof=1).mean(), rel=0.2)
