"""All uses of a reconstruction filter against numerical integration, and against Mitsuba's own film."""

from functools import cache, lru_cache

import drjit as dr
import numpy as np
import pytest
from support.tables import crossed, thinned

FILTERS = ["box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos", "wide"]
SIZES = [(8, 5), (3, 9), (1, 2)]


@pytest.fixture(scope="module")
def mi(variant):
    import mitsuba

    return mitsuba


def make_filter(mi, name):
    # "wide" has a radius that is no multiple of half a pixel, and reaches across the whole film.
    return mi.load_dict({"type": "gaussian", "stddev": 0.77} if name == "wide" else {"type": name})


def radiance(x, y):
    """Smooth, different at each border, and never far from 1."""
    return 1.0 + 0.5 * np.sin(1.3 * x + 0.4) + 0.03 * y * y / (1.0 + 0.1 * y * y) + 0.2 * np.cos(0.9 * y)


def filter_matrix(mi, rfilter, size, points):
    """Rows: normalised weight of every integration point, for each pixel of an axis."""
    position = (np.arange(size * points) + 0.5) / points
    offset = position[None, :] - np.arange(size)[:, None] - 0.5
    values = np.array(rfilter.eval(mi.Float(offset.ravel().astype(np.float32))), dtype=np.float64).reshape(offset.shape)
    values[np.abs(offset) > rfilter.radius()] = 0.0
    values /= over_pixels(mi, rfilter, position)
    return position, values / values.sum(axis=1, keepdims=True)


def over_pixels(mi, rfilter, position):
    """Sum of the filter over all pixels of an endless film, relative to its mean."""
    offset = (position % 1.0)[None, :] + np.arange(-6, 7)[:, None] - 0.5
    values = np.array(rfilter.eval(mi.Float(offset.ravel().astype(np.float32))), dtype=np.float64).reshape(offset.shape)
    values[np.abs(offset) > rfilter.radius()] = 0.0
    total = values.sum(axis=0)
    return total / total.mean()


@cache
def expected_image(mi, name, width, height):
    rfilter = make_filter(mi, name)
    x, across = filter_matrix(mi, rfilter, width, 512)
    y, down = filter_matrix(mi, rfilter, height, 512)
    return down @ radiance(x[None, :], y[:, None]) @ across.T


@lru_cache(maxsize=2)
def lattice(count, dimensions, seed):
    """Columns of a randomly shifted Korobov-like lattice: far less noise than independent numbers."""
    golden = np.array([1.0])
    for _ in range(30):  # the root of g^(d+1) = g + 1, whose powers make the lattice [Roberts 2018]
        golden = (1.0 + golden) ** (1.0 / (dimensions + 1))
    shift = np.random.default_rng(seed).random(dimensions)
    steps = golden ** -np.arange(1, dimensions + 1)
    points = (np.arange(count)[:, None] * steps[None, :] + shift) % 1.0
    return np.minimum(points, 1.0 - 2.0**-24).astype(np.float32).T


def camera_image(mi, sampler, width, height, samples):
    u1, u2 = lattice(samples, 2, seed=1)
    pixels = np.repeat(np.arange(width * height), samples)
    x, y, weight = sampler.camera(
        mi.UInt32(pixels % width),
        mi.UInt32(pixels // width),
        mi.Float(np.tile(u1, width * height)),
        mi.Float(np.tile(u2, width * height)),
    )
    x, y = x.numpy().astype(np.float64), y.numpy().astype(np.float64)
    assert x.min() >= 0 and x.max() <= width and y.min() >= 0 and y.max() <= height
    return (radiance(x, y) * weight.numpy()).reshape(height, width, samples).mean(axis=2)


def splat_image(mi, sampler, width, height, samples):
    s1, s2, u1, u2 = lattice(samples, 4, seed=2)
    x, y = s1 * np.float32(width), s2 * np.float32(height)
    index, weight, valid = sampler.splat(mi.Float(x), mi.Float(y), mi.Float(u1), mi.Float(u2))
    valid = valid.numpy() & np.ones(samples, dtype=bool)
    value = radiance(x.astype(np.float64), y.astype(np.float64)) * weight.numpy() * valid
    image = np.bincount(index.numpy(), weights=value, minlength=width * height) * (width * height / samples)
    return image.reshape(height, width)


def spread_image(mi, pixel_filter, width, height, samples):
    """Samples at the same places in all pixels."""
    u1, u2 = lattice(samples, 2, seed=6)
    pixel = np.arange(width * height)[:, None]
    value = radiance(pixel % width + u1.astype(np.float64), pixel // width + u2.astype(np.float64))
    pixels = pixel_filter.spread(mi.Float(value.ravel().astype(np.float32)), mi.Float(u1), mi.Float(u2))
    return pixels.numpy().reshape(height, width) / samples


def taps_image(mi, pixel_filter, width, height, samples):
    """Samples anywhere, each for all pixels in reach."""
    s1, s2 = lattice(samples, 2, seed=2)
    x, y = s1 * np.float32(width), s2 * np.float32(height)
    value = radiance(x.astype(np.float64), y.astype(np.float64))
    image, taps = np.zeros(width * height), list(pixel_filter.taps(mi.Float(x), mi.Float(y)))
    dr.eval(taps)  # in one kernel
    for index, weight, valid in taps:
        shares = value * weight.numpy() * valid.numpy()
        image += np.bincount(index.numpy() * valid.numpy(), weights=shares, minlength=width * height)
    return image.reshape(height, width) * (width * height / samples)


def cells_image(mi, pixel_filter, width, height, samples):
    """Samples anywhere, added to cells, under several shifts of the grid."""
    s1, s2 = lattice(samples, 2, seed=2)
    x, y = mi.Float(s1 * np.float32(width)), mi.Float(s2 * np.float32(height))
    value = radiance(x.numpy().astype(np.float64), y.numpy().astype(np.float64))
    image, shifts = np.zeros((height, width)), lattice(64, 2, seed=8).T
    for u1, u2 in shifts:
        grid = pixel_filter.cells(u1, u2)
        image += in_cells(mi, grid, x, y, value[:, None])[:, 0].reshape(height, width)
    return image * (width * height / (samples * len(shifts)))


def in_cells(mi, grid, x, y, value):
    """A picture of splats (N, channels up to 4) that are added to the cells of a grid."""
    cell = grid.cell(x, y).numpy()
    packets = np.zeros((grid.count, 4))
    for channel, values in enumerate(value.T):
        packets[:, channel] = np.bincount(cell, weights=values, minlength=grid.count)
    return grid.pixels(mi.Float(packets.ravel().astype(np.float32))).numpy().T


SOFT = ["gaussian", "mitchell", "catmullrom", "lanczos", "wide"]


@pytest.mark.parametrize("name", SOFT)
def test_splats_in_cells_have_the_weights_of_the_filter_on_average(mi, name):
    """Position by position over all shifts, up to the border of the film: the table of the filter over Z."""
    from etendue.film.cells import CellAxis, cell_weights
    from etendue.film.filters import BINS_PER_PIXEL, FilterTable

    size, bins = 5, BINS_PER_PIXEL // 2
    table = FilterTable(make_filter(mi, name))
    integral, _ = table.integrals(size)
    weights = cell_weights(table.values, bins)
    position = np.concatenate([[0.0, 0.001, 4.999], np.random.default_rng(5).uniform(0, size, 29)]).astype(np.float32)
    line, pixel = np.repeat(np.arange(32), size), np.tile(np.arange(size), 32)
    mean = np.zeros(32 * size)
    for shift in range(bins):
        axis = CellAxis(weights, bins, mi.Float(1.0 / integral), (shift + 0.5) / bins)
        packets = np.zeros((32, axis.count, 4), np.float32)
        packets[np.arange(32), axis.cell(mi.Float(position)).numpy(), 1] = 1.0
        first = mi.UInt32(line * axis.count)
        mean += axis.convolve(mi.Float(packets.ravel()), first, mi.UInt32(1), mi.UInt32(pixel))[1].numpy() / bins
    place = np.floor((position[line] - pixel - 0.5) * BINS_PER_PIXEL).astype(int) + len(table.values) // 2
    inside = (place >= 0) & (place < len(table.values))
    expected = np.where(inside, table.values[np.clip(place, 0, len(table.values) - 1)], 0.0) / integral[pixel]
    np.testing.assert_allclose(mean, expected, atol=2e-5 * expected.max())


def test_cells_of_a_sharp_filter_would_be_noisier_than_what_they_save(mi):
    """A tent's weights grow by an eighth an axis, and it reaches four pixels only."""
    from etendue.film import PixelFilter

    assert PixelFilter(make_filter(mi, "tent"), 4, 4).cells(0.5, 0.5) is None
    assert PixelFilter(make_filter(mi, "box"), 4, 4).cells(0.5, 0.5) is None


@pytest.mark.parametrize(
    ("image", "samples", "rtol"),
    [(spread_image, 2048, 2e-3), (taps_image, 200_000, 6e-3), (cells_image, 50_000, 1e-2)],
)
@pytest.mark.parametrize(("name", "size"), crossed(FILTERS, SIZES, 2))
def test_samples_that_count_for_all_pixels_in_reach(mi, image, samples, rtol, name, size):
    from etendue.film import PixelFilter

    width, height = size
    if image is cells_image and name not in SOFT:
        return
    rfilter = make_filter(mi, name)
    got = image(mi, PixelFilter(rfilter, width, height), width, height, samples)
    np.testing.assert_allclose(got, expected_image(mi, name, width, height), rtol=rtol)


@pytest.mark.parametrize("name", FILTERS)
def test_a_constant_picture_stays_one(mi, name):
    """Whatever the place of the samples, at the border too."""
    from etendue.film import PixelFilter

    pixel_filter = PixelFilter(make_filter(mi, name), 16, 13)
    for u in ((0.02, 0.97), (0.5, 0.31)):
        pixels = pixel_filter.spread(mi.Float(np.ones(16 * 13, np.float32)), *(mi.Float([v]) for v in u)).numpy()
        np.testing.assert_allclose(pixels, 1.0, rtol=2e-5)


@pytest.mark.parametrize("narrow", [{"type": "gaussian", "stddev": 0.1}, {"type": "tent", "radius": 0.4}])
def test_a_filter_that_misses_samples_leaves_pixels_alone(mi, narrow):
    """A sample at the corner of its pixel is in reach of none."""
    from etendue.film import PixelFilter

    pixel_filter = PixelFilter(mi.load_dict(narrow), 5, 4)
    assert pixel_filter.has_gaps
    values = np.arange(20, dtype=np.float32)
    corner = mi.Float([0.01])
    np.testing.assert_array_equal(pixel_filter.spread(mi.Float(values), corner, corner).numpy(), values)


@pytest.mark.parametrize("name", ["gaussian", "lanczos"])
def test_samples_are_filtered_together_as_one_by_one(mi, name):
    """Several layers, and samples whose reach begins at different pixels; a film that is not square. Near the border
    samples have their share of the weights of all, as in a constant picture."""
    from etendue.film import PixelFilter

    pixel_filter, rng = PixelFilter(make_filter(mi, name), 21, 17), np.random.default_rng(4)
    u1, u2 = rng.random((2, 5)).astype(np.float32)
    numbers = rng.random((4, 21 * 17, 5)).astype(np.float32)
    layers = [mi.Color3f(*numbers[:3].reshape(3, -1)), mi.Float(numbers[3].ravel())]
    colour, grey = pixel_filter.spread_together(layers, mi.Float(u1), mi.Float(u2))
    found = np.stack([*colour.numpy(), grey.numpy()]).reshape(4, 17, 21)
    alone = np.zeros((4, 17, 21))
    for j in range(5):
        places = mi.Float([u1[j]]), mi.Float([u2[j]])
        alone += [
            pixel_filter.spread(mi.Float(row), *places).numpy().reshape(17, 21) for row in numbers[:, :, j].copy()
        ]
    np.testing.assert_allclose(found[:, 4:-4, 4:-4], alone[:, 4:-4, 4:-4], rtol=1e-5, atol=1e-5)
    constant = pixel_filter.spread(mi.Float(np.ones(21 * 17 * 5, np.float32)), mi.Float(u1), mi.Float(u2))
    np.testing.assert_allclose(constant.numpy(), 5.0, rtol=2e-5)


def test_samples_of_colours_and_of_one_place_may_be_added_first(mi):
    """Two samples a pixel at one place are one sample of their sum; colours are filtered channel by channel."""
    from etendue.film import PixelFilter

    pixel_filter = PixelFilter(make_filter(mi, "mitchell"), 5, 4)
    values = np.random.default_rng(3).random((3, 40)).astype(np.float32)
    two = pixel_filter.spread(mi.Color3f(*values), mi.Float([0.3, 0.3]), mi.Float([0.8, 0.8]))
    for channel, sums in zip(two, values.reshape(3, 20, 2).sum(axis=2), strict=True):
        one = pixel_filter.spread(mi.Float(sums), mi.Float([0.3]), mi.Float([0.8]))
        np.testing.assert_allclose(channel.numpy(), one.numpy(), rtol=1e-5)


@pytest.mark.parametrize(("name", "size"), crossed(FILTERS, SIZES, 2))
def test_camera_paths_converge_to_the_convolution(mi, name, size):
    from etendue.film import PixelFilter

    width, height = size
    rfilter = make_filter(mi, name)
    image = camera_image(mi, PixelFilter(rfilter, width, height), width, height, samples=30_000)
    np.testing.assert_allclose(image, expected_image(mi, name, width, height), rtol=6e-3)


@pytest.mark.parametrize(("name", "size"), crossed(FILTERS, SIZES, 4))
def test_splats_converge_to_the_same_convolution(mi, name, size):
    from etendue.film import PixelFilter

    width, height = size
    rfilter = make_filter(mi, name)
    samples = 50_000 * width * height
    image = splat_image(mi, PixelFilter(rfilter, width, height), width, height, samples)
    expected = expected_image(mi, name, width, height)
    np.testing.assert_allclose(image, expected, atol=8e-3 * expected.max())


@pytest.mark.parametrize("name", FILTERS)
def test_splat_probabilities_are_the_filter_at_that_position(mi, name):
    """One film position near a corner: frequencies times weights are f / Z for every pixel, lobes with their sign."""
    from etendue.film import PixelFilter

    width, height, samples = 9, 6, 300_000
    rfilter = make_filter(mi, name)
    sampler = PixelFilter(rfilter, width, height)
    for x, y in [(0.2, 0.35), (8.7, 5.9), (4.26, 2.61)]:
        u1, u2 = lattice(samples, 2, seed=3)
        index, weight, valid = sampler.splat(
            mi.Float(np.full(samples, x)), mi.Float(np.full(samples, y)), mi.Float(u1), mi.Float(u2)
        )
        signed = weight.numpy() * valid.numpy() * np.ones(samples)
        got = np.bincount(index.numpy(), weights=signed, minlength=width * height).reshape(height, width) / samples
        rows = []
        for size, position in ((width, x), (height, y)):
            points = 1000
            grid, matrix = filter_matrix(mi, rfilter, size, points)
            rows.append([np.interp(position, grid, row) * points for row in matrix])
        expected = np.outer(rows[1], rows[0])
        np.testing.assert_allclose(got, expected, atol=4e-3 * np.abs(expected).max())


def test_weights_are_one_without_negative_lobes_and_signed_with_them(mi):
    from etendue.film import PixelFilter

    u1, u2 = lattice(20_000, 2, seed=4)
    px = mi.UInt32(np.arange(20_000) % 8)
    for name, signs in [("box", {1}), ("tent", {1}), ("gaussian", {1}), ("mitchell", {-1, 1}), ("lanczos", {-1, 1})]:
        _, _, weight = PixelFilter(make_filter(mi, name), 8, 8).camera(px, px, mi.Float(u1), mi.Float(u2))
        weight = weight.numpy()
        assert set(np.sign(weight)) == signs
        if signs == {1}:
            np.testing.assert_allclose(weight, 1.0, atol=1e-5)


@pytest.mark.parametrize("name", ["box", "gaussian", "lanczos"])
def test_positions_off_the_film_are_not_valid(mi, name):
    from etendue.film import PixelFilter

    x = np.array([-0.01, 4.01, 2.0, 2.0, 1e9, -1e9, np.nan, 2.0], dtype=np.float32)
    y = np.array([1.0, 1.0, -0.01, 3.01, 1.0, 1.0, 1.0, 1.0], dtype=np.float32)
    half = mi.Float(np.full(8, 0.5))
    index, _, valid = PixelFilter(make_filter(mi, name), 4, 3).splat(mi.Float(x), mi.Float(y), half, half)
    assert valid.numpy().tolist() == [False] * 7 + [True]
    assert index.numpy()[:7].tolist() == [0] * 7


def test_inversion_is_monotone_and_reaches_the_whole_support(mi):
    """Neighbouring numbers give neighbouring positions, which point sequences and Markov chains rely on."""
    from etendue.film import PixelFilter

    u = np.linspace(0.0, 1.0 - 2**-24, 5000, dtype=np.float32)
    pixel = mi.UInt32(np.full(5000, 5))
    x, _, _ = PixelFilter(make_filter(mi, "tent"), 11, 11).camera(pixel, pixel, mi.Float(u), mi.Float(u))
    x = x.numpy()
    assert (np.diff(x) >= 0).all()
    assert x[0] == pytest.approx(4.5, abs=2e-3) and x[-1] == pytest.approx(6.5, abs=2e-3)


def test_works_inside_a_symbolic_loop(mi):
    from etendue.film import PixelFilter

    sampler = PixelFilter(make_filter(mi, "mitchell"), 6, 4)
    n = 64
    u = mi.Float(lattice(n, 1, seed=5)[0])

    def body(i, total):
        _, _, weight = sampler.camera(dr.arange(mi.UInt32, n) % 6, mi.UInt32(i) % 4, u, u)
        index, splat_weight, valid = sampler.splat(u * 6.0, u * 4.0, u, u)
        return i + 1, total + weight + dr.select(valid, splat_weight, 0.0) + mi.Float(index)

    _, looped = dr.while_loop((mi.UInt32(dr.zeros(mi.UInt32, n)), dr.zeros(mi.Float, n)), lambda i, _: i < 4, body)
    total = dr.zeros(mi.Float, n)
    for i in range(4):
        _, total = body(dr.full(mi.UInt32, i, n), total)
    np.testing.assert_allclose(looped.numpy(), total.numpy(), rtol=1e-5)


@pytest.mark.parametrize("name", thinned(["tent", "gaussian", "mitchell", "lanczos"], ["gaussian", "lanczos"]))
def test_borders_agree_with_a_mitsuba_render(mi, name):
    """A textured emitter seen head-on, by Mitsuba's film and by all estimators of ours: a Z-test per pixel."""
    from etendue.film import PixelFilter

    width, height, spp, runs = 6, 4, 1024, 12
    rng = np.random.default_rng(7)
    texture = rng.random((4, 6, 3)).astype(np.float32)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": name}},
                "sampler": {"type": "independent"},
            },
            "screen": {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().scale([1.4, 1.0, 1.0]),
                "emitter": {
                    "type": "area",
                    "radiance": {"type": "bitmap", "bitmap": mi.Bitmap(texture), "raw": True},
                },
            },
        }
    )
    theirs = np.array([np.array(mi.render(scene, spp=spp, seed=k)) for k in range(runs)])
    sampler = PixelFilter(scene.sensors()[0].film().rfilter(), width, height)

    def seen(x, y):
        ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(x / width, y / height), mi.Point2f(0.5))
        si = scene.ray_intersect(ray)
        return np.array(si.emitter(scene).eval(si)).T

    camera, splat, spread, taps, cells = [], [], [], [], []
    pixels = np.tile(np.arange(width * height), spp)
    n = len(pixels)
    for _ in range(runs):
        u = rng.random((4, n)).astype(np.float32)
        x, y, weight = sampler.camera(
            mi.UInt32(pixels % width), mi.UInt32(pixels // width), mi.Float(u[0]), mi.Float(u[1])
        )
        value = seen(x, y) * weight.numpy()[:, None]
        camera.append(value.reshape(spp, height, width, 3).mean(axis=0))
        x, y = mi.Float(u[0] * width), mi.Float(u[1] * height)
        index, weight, valid = sampler.splat(x, y, mi.Float(u[2]), mi.Float(u[3]))
        value = seen(x, y) * (weight.numpy() * valid.numpy())[:, None]
        sums = [np.bincount(index.numpy(), weights=value[:, k], minlength=width * height) for k in range(3)]
        splat.append(np.stack(sums, axis=-1).reshape(height, width, 3) / spp)
        value, image = seen(x, y), np.zeros((3, width * height))
        every = list(sampler.taps(x, y))
        dr.eval(every)
        for index, weight, valid in every:
            share, place = weight.numpy() * valid.numpy(), index.numpy() * valid.numpy()
            image += [np.bincount(place, weights=value[:, k] * share, minlength=width * height) for k in range(3)]
        taps.append(image.T.reshape(height, width, 3) / spp)
        if name in SOFT:
            # A shift for every 1024 splats, as passes have.
            image = np.zeros((width * height, 3))
            for part in np.split(np.arange(n), spp // 64):
                grid = sampler.cells(*rng.random(2))
                image += in_cells(mi, grid, mi.Float(x.numpy()[part]), mi.Float(y.numpy()[part]), value[part])[:, :3]
            cells.append(image.reshape(height, width, 3) / spp)
        u1, u2 = rng.random((2, spp)).astype(np.float32)
        pixel = np.repeat(np.arange(width * height), spp)
        places = mi.Float(pixel % width + np.tile(u1, n // spp)), mi.Float(pixel // width + np.tile(u2, n // spp))
        value = mi.Color3f(*np.ascontiguousarray(seen(*places).T))
        spread.append(sampler.spread(value, mi.Float(u1), mi.Float(u2)).numpy().T.reshape(height, width, 3) / spp)

    # Pixels of `spread` share the places of their samples, and so their errors: the mean is that of a few numbers.
    for ours, bound in ((camera, 1.9), (splat, 1.9), (taps, 1.9), (cells, 1.9), (spread, 4.0)):
        if not ours:
            continue
        ours = np.array(ours)
        variance = (ours.var(axis=0, ddof=1) + theirs.var(axis=0, ddof=1)) / runs
        z = (ours.mean(axis=0) - theirs.mean(axis=0)) / np.sqrt(variance)
        assert np.abs(z).max() < 5.0  # 72 values, t-distributed with some 20 degrees of freedom
        assert np.mean(z * z) < bound
