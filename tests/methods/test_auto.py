"""Sample counts that are chosen while it renders: the moments, the arithmetic of the choice, and the runs."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.running import go, prepared, replicas, run
from support.statistics import assert_agree
from support.tables import thinned

from etendue import scene
from etendue.core import RELATIVE_EPSILON, CheckpointError
from etendue.methods.auto import CANDIDATES, FIXED, LEARNER, Learned, PassWork, describe, method as auto
from etendue.methods.auto.noise import noise_of_paths
from etendue.methods.bidirectional import BidirectionalSettings
from etendue.transport import TILE, Candidate

PATH = FIXED["path"]
WORK = PassWork(edges=3.0, smooth=2.0, photons=4.0, vertices=2.0)


def test_cost_grows_with_each_count():
    """Path tracing costs its edges; any light path costs more than none, and each count adds to the cost."""
    assert WORK.cost(PATH) == 3.0
    rising = [(0.0, 0, False), (0.125, 0, False), (0.125, 1, False), (0.125, 1, True), (0.5, 1, True), (0.5, 2, True)]
    costs = [WORK.cost(Candidate(*counts)) for counts in rising]
    assert costs == sorted(set(costs))


def learned(pictures, moment, mean):
    """Passes with these pictures, and moments and means of camera paths that are the same in all tiles."""
    result = Learned.none()
    for picture in pictures:
        rows, columns = (-(-side // TILE) for side in picture.shape)
        tiles = np.broadcast_to(np.array([moment, mean]), (rows, columns, 2, len(moment)))
        result = result.after(tiles, picture, [3.0, 2.0, 4.0, 2.0])
    return result


def test_error_is_the_moment_less_the_squared_mean():
    """A film whose sides no tile divides. The last candidate has half of its light from splats."""
    what = learned([np.full((13, 21), 2.0)] * 2, [5.0, 8.0, 5.0], [2.0, 2.0, 1.0])
    np.testing.assert_allclose(what.errors(), np.array([1.0, 4.0, 4.0]) / 4.01, rtol=1e-6)
    assert what.mean_work() == WORK


def test_contrast_within_a_tile_is_no_noise():
    """Pixels of 0 and 4, without noise: the mean of the squares is 8, that of the picture 2."""
    picture = np.indices((16, 16)).sum(axis=0) % 2 * 4.0
    what = learned([picture, picture], [8.0, 9.0], [2.0, 2.0])
    assert what.errors() == pytest.approx([1e-3 * 8.0 / 4.01, 1.0 / 4.01], rel=1e-5)
    noisy = [picture + noise for noise in (0.5, -0.5)]  # only products of different passes
    assert learned(noisy, [8.0, 9.0], [2.0, 2.0]).errors()[1] == pytest.approx(1.25 / 4.01, rel=1e-5)


def test_noise_that_all_candidates_have_does_not_decide():
    """A bright path in one of 400 tiles, which all candidates find; and light in a tile that one of them misses."""
    pictures, moments, means = [np.full((160, 160), 2.0)] * 2, np.array([5.0, 8.0]), np.array([2.0, 2.0])
    calm = learned(pictures, moments, means)

    def with_tile(more):
        tiles = np.array(calm.tiles)
        tiles[7, 3, 0] += 2 * np.array(more)  # over two passes
        return replace(calm, tiles=tiles.astype(np.float32)).errors()

    np.testing.assert_allclose(with_tile([1e4, 1e4]), calm.errors(), rtol=1e-5)
    np.testing.assert_allclose(with_tile([0.0, 1e4]) - calm.errors(), [0.0, 1e4 / 4.01 / 400], rtol=1e-3, atol=1e-4)


def test_what_was_learned_is_a_value():
    what = learned([np.full((13, 21), 2.0)] * 2, [5.0, 8.0], [2.0, 2.0])
    again = Learned.of(what.state())
    assert again.passes == 2 and (again.errors() == what.errors()).all() and again.mean_work() == what.mean_work()


# ---------------------------------------------------------------------- moments against brute force


def variance(images):
    """Mean over the film of the variance between passes."""
    return float(images.mean(axis=3).var(axis=0, ddof=1).mean())


SAMPLES = 16
BRUTE = {
    "path": PATH,
    "bpt": FIXED["bpt"],
    "few light paths": Candidate(0.125, 1, False),
    "splats only": Candidate(0.5, 0, False),
    "many connections": Candidate(0.5, 8, False),
    "vcm": FIXED["vcm"],
    "vcm, many light paths": Candidate(1.0, 1, True),
}


@pytest.fixture(scope="module")
def estimated():
    """Six runs of 32 passes that learn, in a room with a rough and a smooth thing; with a radius that does not blur: in
    a picture as small as this, that of the pixels' width is as large as the things."""
    methods = []
    for seed in range(1, 7):
        scene = scenes.room("rectangle", scenes.FEW)
        methods.append(prepared(scene, "auto", seed, samples_per_pass=SAMPLES, probe_passes=1000, radius=0.006))
        go(methods[-1], 32, seed)
    return methods


@pytest.mark.slow
@pytest.mark.parametrize("name", thinned(BRUTE, ("path", "bpt", "vcm")))
def test_moments_are_those_of_the_candidate(estimated, name):
    """The variance that the learning passes foresee, and that between passes with the candidate's counts. They differ
    by what is stratified within a pass, and by the first passes, which learn lamps; runs tell the precision."""
    counts, images = BRUTE[name], []
    method = estimated[0].method
    for iteration in range(100, 140):
        images.append(method._rendered(counts, iteration, 1, SAMPLES)[0]["image"] / SAMPLES)
    images = np.stack(images).astype(float)
    foreseen = []
    for what in (one.method._learned for one in estimated):
        moments, means = np.moveaxis(what.tiles.astype(float) / what.passes, 2, 0)[..., CANDIDATES.index(counts)]
        share = means.mean() / (what.picture.mean() / what.passes)
        foreseen.append(moments.mean() - share**2 * np.square(images.mean(axis=(0, 3))).mean())
    relative = np.array(foreseen) / (variance(images) * SAMPLES)
    error = relative.std(ddof=1) / np.sqrt(len(relative))
    assert error <= 0.15 and abs(relative.mean() - 1.0) <= 3.0 * error + 0.05, (relative, error)


@pytest.fixture(scope="module")
def many_lamps():
    """Passes that learn under nine lamps, of which one lights what is seen, and three have learned which. They play no
    roulette before shadow rays, as path tracing does not: it would add a quarter to what is foreseen of it."""
    scene = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 1.9, 0.8), (0.0, 0.0, 0.0)),  # no edges, which moments count as noise
        "floor": scenes.plate([0, 0, 0], 2.0, up=True),
        "ceiling": scenes.plate([0, 2.3, 0], 6.0, up=False),
        "lamp": scenes.lamp([-0.8, 2.2, 0.3], 0.15, 30.0),
    }
    hidden = {f"above{i}": scenes.lamp([0.4 * i - 1.4, 3.5, 0.0], 0.15, 60.0) for i in range(8)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BidirectionalSettings, "shadow_roulette", 0.0)
        method = prepared(scenes.load(scene | hidden), "auto", samples_per_pass=SAMPLES, probe_passes=1000)
        go(method, 10)
    return method


@pytest.mark.slow
def test_path_tracing_has_the_roulette_that_its_moments_are_of():
    """In a closed room, paths of six edges or more are common without roulette from the second edge on."""
    room = scene.load("ajar", size=(24, 16))
    learning, fixed = (prepared(room, "auto", samples_per_pass=4, choice=choice) for choice in ("learn", "path"))
    go(learning, 1)
    rays = [one.method._rendered(FIXED["path"], 5, 1, 4)[1]["rays"] for one in (learning, fixed)]
    assert rays[0] < 0.9 * rays[1]


@pytest.mark.slow
def test_path_tracing_selects_the_lamps_that_its_moments_are_of(many_lamps):
    """Those that passes with light paths have learned, and the moments are not those from before they had."""
    method = many_lamps.method
    foreseen = float(method._learned.errors()[CANDIDATES.index(PATH)])
    images = np.stack([method.render_with(PATH, 100 + i, 1) for i in range(40)])
    error = (images.var(axis=0, ddof=1) * SAMPLES / (np.square(images.mean(axis=0)) + RELATIVE_EPSILON)).mean()
    assert foreseen == pytest.approx(error, rel=0.3)


def test_a_pass_that_fails_teaches_nothing(many_lamps, monkeypatch):
    """It has been learned which lamps to sample when the pass fails."""
    method, before = many_lamps, many_lamps.state()
    with monkeypatch.context() as patch:
        patch.setattr(auto.Auto, "_decide", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            method.step(10, 1)
    again = many_lamps.method._vcm.left()["emission"]
    assert again["passes"] == before["vcm"]["emission"]["passes"] and again["seen"] == before["vcm"]["emission"]["seen"]


# ---------------------------------------------------------------------- the choice


def test_what_is_fixed_renders_as_the_method_itself():
    problem = scenes.room("rectangle", scenes.FEW)
    for name, settings in (("path", {}), ("bpt", {})):
        own = go(prepared(problem, name, samples_per_pass=4, **settings), 2)
        fixed = go(prepared(problem, "auto", choice=name, samples_per_pass=4), 2)
        np.testing.assert_allclose(fixed.mean, own.mean, rtol=1e-5, atol=1e-7)


def foresee(monkeypatch, best):
    """Make each learning pass find the next of ``best`` to have the least error, the last for ever after."""
    calls = [0]

    def errors(what):
        wanted = best[min(calls[0], len(best) - 1)]
        calls[0] += 1
        return np.array([1e-6 if c == wanted else 1.0 for c in CANDIDATES])

    monkeypatch.setattr(Learned, "errors", errors)


@pytest.mark.slow
def test_learning_is_a_bounded_share(monkeypatch):
    """Two passes first; later ones as the cost of the run grows. Path tracing has long to go until then."""
    foresee(monkeypatch, [PATH])
    monkeypatch.setattr(auto, "_SHARE", 0.2)
    method = prepared(scenes.room("rectangle", scenes.FEW), "auto", samples_per_pass=4)
    counts, learned_after = [], []
    for iteration in range(80):
        method.step(iteration, 1)
        counts.append(method.state()["counts"])
        learned_after.append(method.state()["learned"]["passes"])
    assert learned_after[:3] == [1, 2, 2] and counts[1:] == [[0.0, 0, False]] * 79
    spent, learning = method.state()["spent"]
    assert learned_after[-1] > 2 and learning <= 0.2 * spent


def test_light_that_is_found_late(monkeypatch):
    """The first passes see no caustic, and path tracing is chosen; a later one sees it."""
    foresee(monkeypatch, [PATH, PATH, FIXED["vcm"]])
    monkeypatch.setattr(auto, "_SHARE", 0.5)
    method = prepared(scenes.room("rectangle", ("dielectric",)), "auto", samples_per_pass=4)
    chosen = []
    for iteration in range(30):
        method.step(iteration, 1)
        chosen.append(describe(Candidate(*method.state()["counts"])))
    changed = chosen.index("vcm")
    assert changed > 2 and set(chosen[:changed]) == {"path"} and set(chosen[changed:]) == {"vcm"}


def test_the_choice_of_the_last_first_pass_is_free(monkeypatch):
    """What connections have learned in the first pass changes it. Later ones have to be worth a change."""
    better = {1: FIXED["vcm"], 2: FIXED["bpt"], 3: PATH}  # by the number of passes that have learned

    def errors(what):
        costs = np.array([what.mean_work().cost(c) for c in CANDIDATES])
        kept = [0.97 if c == better[what.passes] else 1.0 for c in CANDIDATES]
        return np.array([k if c in better.values() else 9.0 for c, k in zip(CANDIDATES, kept, strict=True)]) / costs

    monkeypatch.setattr(Learned, "errors", errors)
    monkeypatch.setattr(auto, "_SHARE", 0.9)
    method = prepared(scenes.room("rectangle", scenes.FEW), "auto", samples_per_pass=4)
    chosen = {}
    for iteration in range(20):
        method.step(iteration, 1)
        chosen.setdefault(method.state()["learned"]["passes"], Candidate(*method.state()["counts"]))
        if len(chosen) == 3:
            break
    assert list(chosen.values()) == [FIXED["vcm"], FIXED["bpt"], FIXED["bpt"]]


@pytest.mark.slow
def test_light_that_is_found_late_is_in_the_picture(monkeypatch):
    """The mean over 64 runs that change from path tracing to merging is that of path tracing."""
    problem = scenes.room("rectangle", ("dielectric",))
    reference = run(problem, "path", passes=12, samples=1024).images
    monkeypatch.setattr(auto, "_SHARE", 0.5)
    pictures = []
    for seed in range(64):
        with monkeypatch.context() as patch:
            foresee(patch, [PATH, PATH, FIXED["vcm"]])
            pictures.append(run(problem, "auto", 16, 16, 10 + seed, radius=0.001).mean)
    assert_agree(np.stack(pictures), reference, "auto that changes its choice")


@pytest.mark.parametrize("runs", thinned((8, 64), (8,)))
def test_the_mean_of_runs_that_learn(runs):
    """Learning included, against path tracing; the radius is small, so that merging has no bias to speak of."""
    problem = scenes.room("rectangle", scenes.FEW)
    reference = run(problem, "path", passes=8, samples=256).images
    assert_agree(replicas(problem, "auto", runs, 5, 16, radius=0.001), reference, "auto", precision=0.03)


def test_the_choice_goes_with_the_checkpoint():
    problem = scenes.room("rectangle", scenes.FEW)
    method = prepared(problem, "auto", samples_per_pass=4)
    total = go(method, 3).measurement
    state = method.state()
    assert state["learned"]["passes"] == 2
    metadata = method.develop(total).metadata
    assert metadata["chosen"] == describe(Candidate(*state["counts"])) and metadata["products"]
    again = prepared(problem, "auto", samples_per_pass=4)
    again.restore(state)
    np.testing.assert_allclose(again.step(3, 1).mean(), method.step(3, 1).mean(), rtol=1e-5, atol=1e-6)
    with pytest.raises(CheckpointError, match="another picture"):
        other = prepared(scenes.room("rectangle", scenes.FEW, size=(8, 8)), "auto", samples_per_pass=4)
        other.restore(state)
    with pytest.raises(CheckpointError, match="another version"):
        again.restore({"choice": "path", "costs": {}, "chosen": {}})


@pytest.mark.parametrize(
    ("lamp", "material", "seconds", "choice"),
    [
        ("point", ("dielectric",), 1.0, "vcm"),
        ("point", scenes.FEW, 5.0, "path"),
        ("rectangle", ("dielectric",), 0.5, "path"),
        ("rectangle", ("dielectric",), 1.5, "vcm"),
        ("constant", ("dielectric",), 5.0, "path"),
    ],
)
def test_a_short_run_learns_nothing(lamp, material, seconds, choice):
    """Of a point light and glass path tracing sees no caustic, however long it runs; that of an area light is rare."""
    method = prepared(scenes.room(lamp, material), "auto", samples_per_pass=1)
    method.plan(seconds, None, None)
    method.step(0, 1)
    assert describe(Candidate(*method.state()["counts"])) == choice
    assert method.state()["learned"]["passes"] == 0


def test_a_short_run_finds_beams():
    """Only light paths do."""
    beam = {"type": "rectangle", "emitter": {"type": "directionalarea", "radiance": scenes.rgb(2, 2, 2)}}
    method = prepared(scenes.hut(beam=beam), "auto").method
    method.plan(1.0, None, None)
    assert describe(method._brief) == "bpt"


@pytest.mark.parametrize(
    ("name", "seconds", "choice"),
    [("cornell-box", 5.0, "path"), ("ajar", 2.0, "bpt"), ("ajar", 1.5, "path"), ("street", 5.0, "vcm")],
)
def test_a_short_run_traces_light_paths_where_camera_paths_are_noisy(name, seconds, choice):
    """A lamp in the next room, or a thousand and glass, after a time in which their kernels can be compiled."""
    method = prepared(scene.load(name, size=(64, 48)), "auto").method
    method.plan(seconds, None, None)
    assert describe(method._brief) == choice


@pytest.mark.parametrize("spp", thinned([1, 4], [4]))
def test_noise_of_camera_paths_is_that_of_their_pictures(spp):
    """Pairs of pictures of one path per pixel, in the same groups of 64 pixels. The unit of light does not matter."""
    problem = scenes.room("rectangle", scenes.FEW)
    pictures = prepared(problem, "auto", samples_per_pass=1, reconstruction="independent")
    pictures.method.plan(0.5, None, None)
    light = go(pictures, 200).images.mean(axis=3).reshape(100, 2, -1, 64)
    variance, level = np.square(light[:, 0] - light[:, 1]).mean(axis=2) / 2.0, light.mean(axis=(1, 3))
    least = RELATIVE_EPSILON * level.mean(axis=1, keepdims=True) ** 2
    expected = (variance / (level**2 + least)).mean(axis=1)
    found = []
    for factor in (1.0, 1000.0):
        parameters = mi.traverse(problem.scene)
        (key,) = [key for key, _ in parameters if key.endswith("radiance.value")]
        parameters[key] = parameters[key] * factor
        parameters.update()
        measured = prepared(problem, "auto", samples_per_pass=spp, reconstruction="independent").method
        found.append([noise_of_paths(measured, measured._tracing(), seed) for seed in range(40)])
    np.testing.assert_allclose(*found, rtol=1e-3)
    z = (np.mean(found[0]) - expected.mean()) / np.hypot(stats.sem(found[0]), stats.sem(expected))
    assert abs(z) < 4.0


@pytest.mark.parametrize(("lamp", "sensor"), [("directional", "perspective"), ("point", "orthographic")])
def test_no_run_is_too_short_for_caustics_that_path_tracing_misses(lamp, sensor, monkeypatch):
    """Those of a sun, and where light paths reach no camera. What such a run has not learned, one that goes on from its
    state for longer does."""
    blank = {"image": np.zeros((12, 16, 3), np.float32)}, {"nonfinite": 0.0}
    learns = []
    monkeypatch.setattr(auto.Auto, "_rendered", lambda *_: blank)
    monkeypatch.setattr(auto.Auto, "_learn", lambda self, iteration, *_: learns.append(iteration) or blank)
    method = prepared(scenes.room(lamp, ("dielectric",), sensor=sensor), "auto", samples_per_pass=1)
    for iteration, limit in enumerate((0.5, 60.0)):
        method.plan(limit, None, None)
        method.step(iteration, 1)
        assert describe(Candidate(*method.state()["counts"])) == "vcm" and learns == [1] * iteration


def test_a_short_run_is_resumed_for_longer():
    """Its passes have learned no connections, and the state holds none; those after learn."""
    problem = scenes.room("point", ("dielectric",))
    short = prepared(problem, "auto", samples_per_pass=1)
    short.plan(5.0, None, None)
    short.step(0, 1)
    longer = prepared(problem, "auto", samples_per_pass=1)
    longer.plan(60.0, None, None)
    longer.restore(short.state())
    longer.step(1, 1)
    state = longer.state()
    assert state["learned"]["passes"] == 1 and state["vcm"]["connections"]["generation"] == 1
    longer.restore(short.state())
    again = longer.step(1, 1)  # as if it had learned nothing since
    assert longer.state()["vcm"]["connections"]["generation"] == 1
    assert again.counters["light_vertices"] > 0.0


def test_a_black_scene_is_no_error():
    problem = scenes.room("rectangle", scenes.FEW)
    method = prepared(problem, "auto", samples_per_pass=2, max_depth=0)
    assert not go(method, 3).mean.any()
    assert LEARNER not in FIXED.values()


def test_a_preview_learns_nothing():
    """A run of few samples; one of many learns."""
    method = prepared(scenes.room("rectangle", scenes.FEW), "auto").method
    for passes, brief in ((2, True), (1 << 20, False), (None, False)):
        method.plan(None, passes, None)
        assert (method._brief is not None) == brief
