"""Paths as points of a hypercube with named dimensions, and densities that learn."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.running import go, mitsuba_path, prepared, replicas, run
from support.statistics import assert_agree, assert_mean
from support.tables import crossed, thinned

from etendue import methods
from etendue.core import CheckpointError, EtendueError, IndependentSource, OptionError
from etendue.integration import AxisBins, CellGrid, HostBackend, PlaneBins
from etendue.methods.adaptive.dimensions import LENGTH, AdaptiveSource, Group, groups
from etendue.scene import LightTable
from etendue.transport import dimensions as dim

PICK, LIGHT_U, LIGHT_V = dim.NEXT_EVENT, dim.NEXT_EVENT + 1, dim.NEXT_EVENT + 2


# ---------------------------------------------------------------------------------------------------- names


def test_names_of_dimensions():
    assert groups("", 2) == []
    assert groups("film; lens", 1) == [
        Group("film", (((0, dim.FILM), (0, dim.FILM + 1)),)),
        Group("lens", (((0, dim.APERTURE), (0, dim.APERTURE + 1)),)),
    ]
    assert groups("bounce2", 2) == [Group("bounce2", (((2, dim.DIRECTION), (2, dim.DIRECTION + 1)),))]
    (light,) = groups("light", 2)
    assert light.dimension == 3
    assert light.draws == tuple(tuple((v, c) for c in (PICK, LIGHT_U, LIGHT_V)) for v in (1, 2))
    (joint,) = groups(" light1.u,  light1.v bounce1 ;", 1)
    assert joint.draws == (((1, LIGHT_U), (1, LIGHT_V), (1, dim.DIRECTION), (1, dim.DIRECTION + 1)),)
    assert groups("lobe; roulette1", 1)[1].draws == (((1, dim.ROULETTE),),)


def test_what_decides_nothing_is_left_out():
    assert groups("light.pick; light1", 1, {(1, PICK)}) == [Group("light1", (((1, LIGHT_U), (1, LIGHT_V)),))]
    assert groups("lens", 1, {(0, dim.APERTURE), (0, dim.APERTURE + 1)}) == []


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("lights", "there is no 'lights'.*light"),
        ("bounce1.w", "bounce has the components u v"),
        ("lobe.u", "lobe is one number"),
        ("film1", "film, lens have no number"),
        ("light0", "numbered from 1"),
        ("bounce3", "only the first 2 adapt"),
        ("light; light1.u", "in another group"),
        ("bounce1 bounce1.v", "a number twice"),
        ("light bounce1", "with and without the number"),
        ("film light", "with and without the number"),
    ],
)
def test_words_that_are_no_names(text, complaint):
    with pytest.raises(OptionError, match=complaint):
        methods.get("vegas")(methods.get("vegas").Settings(groups=text))


def test_settings_that_do_not_fit():
    cls = methods.get("vegas")
    with pytest.raises(OptionError, match="set merge=false"):
        cls(cls.Settings(groups="light.pick"))
    with pytest.raises(OptionError, match="set maps=0"):
        cls(cls.Settings(maps=1, one_path=True))
    with pytest.raises(OptionError, match="at most 8 for the group 'light bounce' of 4 dimensions"):
        prepared(scenes.room("rectangle", ("diffuse",)), "vegas", groups="light bounce", bins=20)


# ---------------------------------------------------------------------------------------------------- numbers


def some_density(kind: type, seed: int) -> Any:
    random = np.random.default_rng(seed)

    def borders(*shape: int) -> np.ndarray:
        widths = random.uniform(0.2, 1.0, shape)
        reached = np.cumsum(widths, axis=-1) / widths.sum(axis=-1, keepdims=True)
        return np.concatenate([np.zeros((*shape[:-1], 1)), reached], axis=-1)

    if kind is AxisBins:
        return AxisBins(borders(7))
    return PlaneBins(borders(5), borders(5, 4)) if kind is PlaneBins else CellGrid(random.uniform(0.1, 1.0, (3, 3, 3)))


@pytest.mark.parametrize(
    ("kind", "name"), [(AxisBins, "lobe2"), (PlaneBins, "bounce2"), (CellGrid, "light2"), (AxisBins, "bounce2.v")]
)
def test_warped_numbers_have_the_density_of_their_row(kind, name):
    """By chi-square on the bins, and by the mean of a function times the weight."""
    (group,) = groups(name, 2)
    rows = [some_density(kind, seed) for seed in range(3)]
    n = 3 << 15
    lane = mi.UInt32(np.arange(n, dtype=np.uint32))
    row = lane % 3
    source = AdaptiveSource(IndependentSource(lane, 1, "test", 0), [group], [rows], row)
    vertex = mi.UInt32(2)
    numbers = {
        dim.LOBE: source.decide(vertex, dim.LOBE),
        PICK: source.next_1d(vertex, PICK),
        **dict(zip((dim.DIRECTION, dim.DIRECTION + 1), source.next_2d(vertex, dim.DIRECTION), strict=True)),
        **dict(zip((LIGHT_U, LIGHT_V), source.next_2d(vertex, LIGHT_U), strict=True)),
    }
    numbers = {component: np.array(value, float) for component, value in numbers.items()}
    x = np.stack([numbers[c] for _, c in group.draws[0]])
    assert (x >= 0).all()
    assert (x < 1).all()
    (drawn,) = source.drawn
    weight, place = np.array(drawn.weight, float), np.array(drawn.bin)
    bins = rows[0].bins
    expected = n / 3 * np.concatenate([np.broadcast_to(f.shares, bins) for f in rows])
    assert stats.chisquare(np.bincount(place, minlength=3 * bins), expected).pvalue > 1e-4
    assert_mean(weight * np.prod(1 + 2 * x, axis=0), 2.0 ** len(x), name)
    for r, factor in enumerate(rows):
        mine = np.arange(n) % 3 == r
        there = 1 / factor.pdf(HostBackend(0), x[:, mine])
        assert np.isclose(weight[mine], there, rtol=1e-3).mean() > 0.999  # rounding moves some across a border
    # Numbers of no group, and those of other vertices, are those of the base.
    base = IndependentSource(lane, 1, "test", 0)
    np.testing.assert_array_equal(source.next_1d(mi.UInt32(1), PICK), base.next_1d(1, PICK))
    np.testing.assert_array_equal(source.next_2d(0, dim.FILM)[1], base.next_2d(0, dim.FILM)[1])


def test_one_length_in_six():
    lane = mi.UInt32(np.arange(1 << 16, dtype=np.uint32))
    density = CellGrid(np.array([0.1, 0.3, 0.2, 0.2, 0.1, 0.1]))
    source = AdaptiveSource(IndependentSource(lane, 1, "test", 0), [LENGTH], [[density]], mi.UInt32(0))
    weight = np.array(source.weight(mi.UInt32(1), False), float)
    for edges in (1, 2, 5):
        counted = np.array(source.counts(mi.UInt32(edges)))
        assert_mean(counted, density.probability[edges - 1], edges)
        np.testing.assert_allclose(weight[counted], 1 / density.probability[edges - 1], rtol=1e-5)
    for edges in (6, 9):
        assert_mean(np.array(source.counts(mi.UInt32(edges))), 0.1, edges)
    assert_mean(np.array(source.goes_on(mi.UInt32(3))), 0.4, "longer than three edges")
    assert_mean(np.array(source.goes_on(mi.UInt32(7))), 0.1, "no end to the last")


def test_what_a_number_has_left():
    """One number picks a light and is uniform again, whatever the light."""
    lights = LightTable(scenes.room("two", ("diffuse",)).scene)
    u = mi.Float((np.arange(1 << 16) + 0.5) / (1 << 16))
    left, row = np.array(lights.left_by_pick(u)), np.array(lights.pick(u).row)
    assert (left >= 0).all()
    assert (left < 1).all()
    assert len(set(row)) == 2
    for light in set(row):
        counts = np.histogram(left[row == light], 16, (0, 1))[0]
        np.testing.assert_allclose(counts, counts.mean(), rtol=0.02)


# ---------------------------------------------------------------------------------------------------- the estimate


def lit_room(**view: Any) -> Any:
    return scenes.room("mixed", scenes.FEW, **view)


@pytest.mark.parametrize("bsdf_sampling", [True, False])
@pytest.mark.parametrize(("method", "none"), [("vegas", {"groups": ""}), ("stratified", {"parameters": ""})])
def test_without_dimensions_it_is_path(method, none, bsdf_sampling):
    settings = {"samples_per_pass": 4, "bsdf_sampling": bsdf_sampling}
    mine = go(prepared(lit_room(), method, **none, **settings), 2).mean
    path = prepared(lit_room(), "path", **settings)
    path.lights = path.lights.alike_everywhere()  # which ``path`` picks by place
    plain = go(path, 2).mean
    np.testing.assert_array_equal(mine, plain)
    other = go(prepared(lit_room(), "path", **settings | {"bsdf_sampling": not bsdf_sampling}), 2).mean
    assert np.abs(other - plain).max() > 1e-3


#: What changes the numbers, and must not change the picture.
SWITCHES: dict[str, dict[str, Any]] = {
    "all vertices alike": {"groups": "light; bounce; lobe; roulette", "bounces": 3, "rr_depth": 2},
    "stratified": {"learning": "stratified", "bins": 8},
    "pick apart": {"merge": False, "groups": "light.pick; light.u light.v; bounce1"},
    "grids": {"merge": False, "groups": "light; bounce1 bounce2"},
    "joint": {"groups": "light1 bounce1.u; film bounce2.v", "inertia": 1.0},
    "tiles": {"tile": 5, "damping": 0.0, "smoothing": False},
    "one path": {"one_path": True, "lengths": 4, "groups": "film; light; bounce1; bounce2"},
    "one path, next event": {"one_path": True, "mode": "next_event"},
    "naive": {"mode": "naive", "groups": "bounce"},
    "uniform directions": {"bsdf_sampling": False},
    "uniform directions, one path": {"bsdf_sampling": False, "one_path": True, "groups": "light; bounce"},
}


@pytest.mark.parametrize("name", thinned(SWITCHES, list(SWITCHES)[:1]))
def test_switches_do_not_change_the_mean(name):
    emitter = "rectangle" if "naive" in name else "mixed"
    scene = scenes.room(emitter, scenes.FEW, rfilter="gaussian")
    reference = mitsuba_path(scene, passes=6, samples=256)
    images = replicas(scene, "vegas", runs=6, passes=3, samples=192, **SWITCHES[name])
    assert_agree(images, reference, name, precision=0.03)


#: The same of ``stratified``.
PLANS: dict[str, dict[str, Any]] = {
    "light and bounce": {"parameters": "light1 bounce1"},
    "pick apart": {"merge": False, "parameters": "light1", "weights": "2, 1, 1"},
    "range": {"parameters": "bounce1 film", "metric": "range", "divisions": 3, "dither": 0.5},
    "maximum": {"parameters": "light1 light2", "metric": "maximum", "borders": "vegas", "exponent": 1.0},
    "blind": {"parameters": "lobe1 bounce1", "initial_depth": 3, "exploration": 0.3, "depth": 6, "minimum": 64},
    "uniform directions": {"parameters": "bounce1", "bsdf_sampling": False},
}


@pytest.mark.parametrize("name", thinned(PLANS, list(PLANS)[:1]))
def test_plans_do_not_change_the_mean(name):
    scene = lit_room(rfilter="gaussian")
    reference = mitsuba_path(scene, passes=6, samples=256)
    images = run(scene, "stratified", passes=6, samples=384, **{"minimum": 256} | PLANS[name])
    assert_agree(images.images, reference, name, precision=0.03)
    assert images.measurement.counters["regions"] / 6 > 20


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"parameters": "light1; bounce1"}, "one group"),
        ({"parameters": "light"}, "one group"),
        ({"parameters": "light1.pick"}, "set merge=false"),
        ({"weights": "a"}, "must be numbers"),
        ({"borders": "vegas", "dither": 0.5}, "dither moves"),
    ],
)
def test_plans_that_cannot_be(settings, complaint):
    cls = methods.get("stratified")
    with pytest.raises(EtendueError, match=complaint):
        cls(cls.Settings(**settings))


@pytest.mark.slow
@pytest.mark.parametrize("group", ("wrapped", "specular"))
def test_uniform_directions_need_not_know_the_material(group):
    """Delta components among them."""
    scene = scenes.room("rectangle", group)
    reference = mitsuba_path(scene, passes=6, samples=256)
    images = replicas(scene, "vegas", runs=6, passes=2, samples=384, bsdf_sampling=False)
    assert_agree(images, reference, group, precision=0.03)


@pytest.mark.slow
def test_a_lens_adapts():
    scene = lit_room(sensor="thinlens")
    images = replicas(scene, "vegas", runs=6, passes=3, samples=128, groups="film; lens; light")
    assert_agree(images, mitsuba_path(scene, passes=6, samples=256), "lens")


def test_one_path_traces_fewer_rays():
    rays = [
        run(lit_room(), "vegas", 2, 64, one_path=one_path).measurement.counters["rays"] for one_path in (False, True)
    ]
    assert rays[1] < 0.7 * rays[0]


# ---------------------------------------------------------------------------------------------------- learning


def hidden_lamps(size: tuple[int, int] = scenes.SIZE) -> Any:
    """One lamp of nine lights the room; the others, just as strong, shine above its ceiling."""
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera(size=size),
        "floor": scenes.plate([0, 0, 0], 2.0, up=True),
        "ceiling": scenes.plate([0, 2.3, 0], 6.0, up=False),
        "ball": {"type": "sphere", "center": [0, 0.4, 0], "radius": 0.4, "bsdf": scenes.diffuse(0.6, 0.4, 0.3)},
        "lamp": scenes.lamp([-0.8, 2.2, 0.3], 0.15, 30.0),
    }
    for i in range(8):
        scene[f"above-{i}"] = scenes.lamp([0.4 * i - 1.4, 3.5, 0.0], 0.15, 30.0)
    return scenes.load(scene)


def variance(images: np.ndarray) -> float:
    """Relative to the brightness, of one picture."""
    mean = images.mean(0)
    return float((images.var(0, ddof=1) / (mean**2 + 0.01)).mean())


@pytest.mark.parametrize(("method", "bsdf_sampling"), crossed(["vegas", "stratified"], [True, False], 2))
def test_it_learns_which_lamp_matters(method, bsdf_sampling):
    scene = hidden_lamps()
    settings = {"bsdf_sampling": bsdf_sampling}
    learned = variance(replicas(scene, method, runs=6, passes=6, samples=64, **settings))
    images = []
    for seed in range(1, 7):
        path = prepared(scene, "path", seed, samples_per_pass=64, **settings)
        path.lights = path.lights.alike_everywhere()  # which ``path`` picks by place
        images.append(go(path, 6, seed).mean)
    plain = variance(np.stack(images))
    assert learned < 0.4 * plain


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("vegas", {"groups": "light; bounce1", "update": 2}),
        ("vegas", {"groups": "light; bounce1", "update": 2, "maps": 2}),
        ("stratified", {"update": 4, "maps": 2}),
    ],
    ids=str,
)
def test_a_run_goes_on_where_it_stopped(method, settings):
    settings = {"samples_per_pass": 16} | settings
    whole = go(prepared(lit_room(), method, **settings), 6)
    first = prepared(lit_room(), method, **settings)
    go(first, 3)
    state = dict(first.state())
    resumed = prepared(lit_room(), method, **settings)
    resumed.restore(state)
    rest = go(resumed, 3, first=3)
    np.testing.assert_allclose(rest.images, whole.images[3:], rtol=1e-4, atol=1e-6)
    if method == "vegas":
        forgetful = go(prepared(lit_room(), "vegas", **settings), 3, first=3)
        assert np.abs(forgetful.images - rest.images).max() > 1e-3


@pytest.mark.parametrize("other", [{"bins": 5}, {"groups": "light"}, {"tile": 8}, {"learning": "stratified"}], ids=str)
def test_densities_of_another_size(other):
    state = prepared(lit_room(), "vegas", samples_per_pass=16).state()
    with pytest.raises(CheckpointError, match="do not fit"):
        prepared(lit_room(), "vegas", samples_per_pass=16, **other).restore(state)
