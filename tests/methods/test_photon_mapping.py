"""Photon mapping, progressive and stochastic progressive: what the tables of the other files do not ask."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, run
from support.statistics import assert_agree, assert_mean, z_scores
from support.tables import crossed, thinned
from support.tasks import rendering

from etendue import methods
from etendue.core import CheckpointError, OptionError, Replica
from etendue.engine import Budget, Checkpoint, Job, Task

#: Of a pass of ``pm``: building the tree is most of its time.
PHOTONS = 60_000
#: Every switch that changes which photons are looked up.
VARIANTS = {
    "sppm": ("sppm", {"radius": 0.02, "radius_unit": "absolute", "alpha": 1.0}),
    "sppm photons": ("sppm", {"radius": 0.02, "radius_unit": "absolute", "alpha": 1.0, "direct": "photons"}),
    "pm": ("pm", {"neighbours": 12, "photons": PHOTONS}),
    "pm photons": ("pm", {"neighbours": 12, "photons": PHOTONS, "direct": "photons"}),
    "pm final gather": ("pm", {"neighbours": 12, "photons": PHOTONS, "final_gather": True}),
}


def scene(**elements: Any) -> Any:
    return scenes.load({"type": "scene", "sensor": scenes.camera(), "floor": floor()} | elements)


def floor(*reflectance: float) -> dict[str, Any]:
    to_world = scenes.transform().rotate([1, 0, 0], -90).scale(2.0)
    return {"type": "rectangle", "to_world": to_world, "bsdf": scenes.diffuse(*(reflectance or (0.5, 0.5, 0.5)))}


def near(images: np.ndarray, reference: np.ndarray, bias: float, what: Any = "") -> None:
    """The same mean but for noise, as measured, and a share of bias."""
    means = [stack.mean(axis=(1, 2)) for stack in (images, reference)]
    error = np.sqrt(sum(m.var(0, ddof=1) / len(m) for m in means))
    difference, expected = means[0].mean(0) - means[1].mean(0), means[1].mean(0)
    assert (error < 0.02 * expected).all(), f"{what}: too noisy to say anything, {error / expected}"
    assert (np.abs(difference) < bias * expected + 4.0 * error).all(), f"{what}: off by {difference / expected}"


#: Rough materials that keep all light and scatter it into a narrow peak.
PEAKS: dict[str, dict[str, Any]] = {
    "conductor 0": {"type": "roughconductor", "material": "none", "alpha": 0.0},
    "conductor": {"type": "roughconductor", "material": "none", "alpha": 0.002},
    "dielectric": {"type": "roughdielectric", "alpha": 0.001},
}


@pytest.mark.parametrize(("method", "name"), crossed(["sppm", "pm"], PEAKS, 2))
def test_nearly_smooth_materials_lose_no_light(method, name):
    """A ball inside a lamp that reflects half of its own light: twice the lamp's radiance in every direction. No photon
    arrives in the peak of the ball's material."""
    ball = {"type": "sphere", "center": [-0.3, 0.25, -0.2], "radius": 0.25, "bsdf": PEAKS[name]}
    settings = {"photons": PHOTONS} if method == "pm" else {"radius": 1.4, "radius_unit": "pixel"}
    made = run(scenes.furnace("sphere", 1.0, 0.5, ball=ball), method, passes=6, samples=32, **settings)
    means = made.images.mean(axis=(1, 2, 3))
    assert means.std(ddof=1) < 0.02 * means.mean()
    assert means.mean() == pytest.approx(2.0, rel=0.015)
    assert np.abs(made.mean - 2.0).max() < 0.2


# ---------------------------------------------------------------------------------------------------- progressive


def test_the_update_of_the_radius():
    """M photons within R make N + alpha M of N, and R^2 shrinks by (N + alpha M) / (N + M) [Hachisuka 2008, eq. 6, 8];
    where there is none, both stay."""
    settings = {"alpha": 0.5, "radius": 0.3, "radius_unit": "absolute", "light_paths": 10.0}
    runner = prepared(scenes.field(0.5, 1.3), "ppm", samples_per_pass=1, direct="photons", **settings)
    size = len(runner.state()["count"])
    assert size == 64
    before = np.where(np.arange(size) < 32, 0.09, 1e-12).astype(np.float32)
    runner.restore({"radius_squared": before, "count": np.full(size, 10.0, np.float32), "most": 1.0, "passes": 0})
    runner.step(0, 1)
    state = runner.state()
    found = (np.asarray(state["count"]) - 10.0) / 0.5
    assert found[:32].min() > 3.0 and not found[32:].any()
    np.testing.assert_allclose(found, np.round(found), atol=1e-3)
    np.testing.assert_allclose(state["radius_squared"], before * (10.0 + 0.5 * found) / (10.0 + found), rtol=1e-5)


@pytest.mark.parametrize("kernel", ["uniform", "cone"])
def test_the_picture_is_tau_over_r_squared(kernel):
    """Three passes against N, R and tau carried along as the paper does, by NumPy over the same photons and points."""
    albedo, alpha, radius = 0.5, 0.6, 0.3
    problem = scenes.field(albedo, 1.3)
    settings = {"alpha": alpha, "radius": radius, "radius_unit": "absolute", "light_paths": 10.0, "kernel": kernel}
    runner = prepared(problem, "ppm", samples_per_pass=1, direct="photons", **settings)
    picture = np.zeros((8, 8))
    lanes = mi.UInt32(np.arange(64, dtype=np.uint32))
    ray, _, _ = runner.camera.primary(lanes, runner.camera_numbers(lanes, 1, 1, 0))
    points = np.array(runner.scene.ray_intersect(ray).p).T
    squared, count, tau, paths = np.full(64, radius**2), np.zeros(64), np.zeros(64), 0
    for iteration in range(3):
        shot = runner.shoot(iteration, 1)
        position, _, held = shot.vertices.positions()
        slots = mi.UInt32(np.flatnonzero(np.array(held)).astype(np.uint32))
        everything = mi.UInt32(np.arange(shot.capacity, dtype=np.uint32))
        read = shot.vertices.sorted_by(everything).read(slots, True)
        cos = np.array(read.direction)[1]
        flux = np.array(read.fluence)[0] * np.maximum(cos, 0.0)  # of the side that is seen; the other is lit, too
        photons = np.array(position).T[np.array(held)]
        picture += runner.step(iteration, 1).mean()[..., 0] / 3

        share = ((photons[None] - points[:, None]) ** 2).sum(-1) / squared[:, None]
        inside = (share <= 1.0) & (cos > 0.0)
        weight = 3.0 * (1.0 - np.sqrt(np.minimum(share, 1.0))) if kernel == "cone" else 1.0
        found = inside.sum(1)
        factor = (count + alpha * found) / np.maximum(count + found, 1)
        tau = (tau + (inside * weight * flux * albedo / np.pi).sum(1)) * factor
        bound = radius**2 * np.prod([(j + alpha) / (j + 1) for j in range(1, iteration + 2)])
        assert (squared * factor < bound).all()
        squared, count, paths = squared * factor, count + alpha * found, paths + shot.paths
        np.testing.assert_allclose(runner.state()["count"], count, rtol=1e-5)
        np.testing.assert_allclose(runner.state()["radius_squared"], squared, rtol=1e-5)
    assert count.min() > 3.0
    np.testing.assert_allclose(picture.ravel(), tau / (np.pi * squared * paths), rtol=2e-4)


@pytest.mark.parametrize("method", ["sppm", "ppm"])
def test_radii_shrink_where_no_photon_is_found(method):
    """The sky beside a plane: the grid of photons is as coarse as the largest radius, which must not stay."""
    alpha, passes = 0.6, 6
    settings = {"samples_per_pass": 4, "alpha": alpha, "radius": 0.3, "radius_unit": "absolute"}
    runner = prepared(scenes.room("envmap", "specular", size=(12, 8)), method, **settings)
    for iteration in range(passes):
        runner.step(iteration, 1)
    found, squared = (np.asarray(runner.state()[name]) for name in ("count", "radius_squared"))
    bound = 0.3**2 * np.prod([(j + alpha) / (j + 1) for j in range(1, passes + 1)])
    assert found.min() == 0.0, "the test needs points that no photon is near"
    np.testing.assert_allclose(squared[found == 0.0], bound, rtol=1e-5)
    assert squared.max() == pytest.approx(bound, rel=1e-5)


def test_paths_of_a_pixel_share_their_radius():
    """Four points of a pixel count their photons together; those of ppm by themselves."""
    counts = {}
    for method in ("sppm", "ppm"):
        runner = prepared(scenes.field(0.5, 1.3), method, samples_per_pass=4, radius=0.3, radius_unit="absolute")
        runner.step(0, 1)
        counts[method] = np.asarray(runner.state()["count"])
    assert len(counts["sppm"]) == 64
    np.testing.assert_allclose(counts["sppm"], counts["ppm"].reshape(64, 4).sum(1), rtol=1e-6)


def test_ppm_looks_at_the_same_points_in_each_pass():
    """Glass, mirrors, a lens, and a sky with a gradient: no light but what specular surfaces lead to."""
    dictionary = {"type": "scene", "sensor": scenes.camera(sensor="thinlens")} | scenes.EMITTERS["envmap"]()
    for i, material in enumerate(("dielectric", "conductor")):
        bsdf = scenes.MATERIALS[material]()
        dictionary[material] = {"type": "sphere", "center": [i - 0.5, 0.5, 0], "radius": 0.5, "bsdf": bsdf}
    problem = scenes.load(dictionary)
    fixed, moving = (run(problem, method, passes=2, samples=2).images for method in ("ppm", "sppm"))
    np.testing.assert_array_equal(fixed[0], fixed[1])
    assert np.abs(moving[0] - moving[1]).max() > 0.01
    other = run(problem, "ppm", passes=1, samples=2, seed=5).images
    assert np.abs(fixed[0] - other[0]).max() > 0.01


def test_ppm_has_several_points_in_a_pixel():
    problem = scenes.field(0.5, 1.0, size=(3000, 1500))  # a GPU has as many paths in a pass
    assert prepared(problem, "sppm").samples_per_iteration == 1
    assert prepared(problem, "ppm").samples_per_iteration == 4
    assert prepared(problem, "ppm", samples_per_pass=1).samples_per_iteration == 1


@pytest.mark.parametrize("method", ["ppm", "sppm"])
def test_the_first_radius_holds_as_many_photons_as_asked_for(method):
    """On a plane, k photons of density n lie within r^2 = k / (pi n); where the most allowed is less, it is that."""
    settings = {"light_paths": 20.0, "radius": 0.7, "radius_unit": "absolute", "direct": "photons"}
    runner = prepared(scenes.field(0.5, 1.3), method, samples_per_pass=16, neighbours=30, **settings)
    squared = np.array(runner.state()["radius_squared"])
    density = runner.step(0, 1).counters["photons"] / 4.0
    assert_mean(squared * np.pi * density / 30, 1.0, sigmas=9.0)  # near points have the same neighbours
    assert squared.std() > 0.1 * squared.mean()
    # Half of the photons come from below, and are not counted.
    points = 1 if method == "ppm" else 16
    assert_mean(np.array(runner.state()["count"]) / (15 * points * runner.settings.alpha), 1.0, sigmas=9.0)
    narrow = settings | {"radius": 0.05}
    smaller = prepared(scenes.field(0.5, 1.3), method, samples_per_pass=16, neighbours=30, **narrow)
    small = np.array(smaller.state()["radius_squared"])
    np.testing.assert_allclose(small.max(), 0.05**2, rtol=1e-6)
    if method == "ppm":  # of sppm, the mean over the points of a pixel
        np.testing.assert_allclose(small, np.minimum(squared, 0.05**2), rtol=1e-3)


@pytest.mark.parametrize(("method", "per_pass"), thinned([("sppm", 2), ("ppm", 1), ("pm", 2)], [("sppm", 2)]))
def test_a_resumed_run_equals_an_uninterrupted_one(method, per_pass, tmp_path):
    cls = methods.get(method)
    settings = {"samples_per_pass": str(per_pass)} | ({"photons": "5000"} if method == "pm" else {"radius": "0.05"})

    def task(passes: int) -> Task:
        budget = Budget(samples=passes * per_pass)
        return rendering("cornell-glass", cls, settings, 4, budget, size=(16, 12))

    whole = Job.open(task(4)).runner().run()
    half = Job.open(task(2))
    half.checkpoint(half.runner().run()).write(tmp_path / "a.checkpoint")
    read = Checkpoint.read(tmp_path / "a.checkpoint")
    job = Job.resume(read, task(4))
    rest = job.runner().run()
    assert rest.measurement.counters["photons"] == whole.measurement.counters["photons"]
    np.testing.assert_allclose(rest.measurement.mean(), whole.measurement.mean(), rtol=1e-4, atol=1e-6)
    if method != "pm":  # and it would not, had it begun with the first radius again
        squared = np.array(rest.state["radius_squared"])
        assert squared.min() < 0.8 * squared.max()
        replica = Replica(job.method, 4)
        anew = Checkpoint.read(tmp_path / "a.checkpoint").measurement + replica.step(2) + replica.step(3)
        assert np.abs(anew.mean() - whole.measurement.mean()).max() > 1e-3


def test_statistics_of_another_size_are_refused():
    runner = prepared(scenes.field(0.5, 1.0), "sppm", samples_per_pass=2)
    with pytest.raises(CheckpointError, match="photon statistics"):
        runner.restore({"radius_squared": np.ones(5), "count": np.ones(5)})


# ---------------------------------------------------------------------------------------------------- nearest photons


def test_more_photons_less_error():
    """The error of nearest photons falls with their number, noise and blur alike."""
    problem = scenes.room("rectangle", ("diffuse", "dielectric", "conductor"))
    reference = run(problem, "path", passes=4, samples=1024).mean
    errors = []
    for photons in (500, 5_000, 50_000):
        settings = {"photons": photons, "neighbours": 20, "direct": "photons"}
        images = run(problem, "pm", passes=4, samples=64, **settings).images
        errors.append(float(np.sqrt(((images - reference) ** 2).mean(axis=(1, 2, 3)) / (reference**2).mean()).mean()))
    assert errors[1] < 0.7 * errors[0], errors
    assert errors[2] < 0.7 * errors[1], errors


def test_photons_are_as_many_as_asked_for():
    problem = scenes.room("sphere", scenes.FEW)
    for photons in (1, 1000, 20_000):
        stored = prepared(problem, "pm", photons=photons, samples_per_pass=1).step(0, 1).counters["photons"]
        assert abs(stored - photons) < 6.0 * np.sqrt(5.0 * photons) + 0.05 * photons, photons


# ---------------------------------------------------------------------------------------------------- which light


@pytest.mark.parametrize(("name", "depth"), crossed(VARIANTS, range(5), 6))
def test_max_depth_counts_edges_as_path_does(name, depth):
    method, settings = VARIANTS[name]
    problem = scene(**scenes.EMITTERS["rectangle"](), ball=scenes.thing("dielectric", (0.0, 0.302, 0.0)))
    images = run(problem, method, passes=6, samples=64, max_depth=depth, **settings).images
    reference = run(problem, "path", passes=6, samples=256, max_depth=depth).images
    if depth < 2:  # the lamp faces away from the eye
        assert not images.any()
        assert not reference.any()
    else:
        near(images[..., :1], reference[..., :1], 0.03, (name, depth))


@pytest.mark.parametrize("name", thinned(VARIANTS, ("sppm",)))
def test_a_veil_before_the_lamp_is_no_vertex(name):
    """Light that comes through what does not bend it is direct light, found once; the veil's own light is added."""
    method, settings = VARIANTS[name]
    sheet = scenes.transform().translate([0.1, 1.6, -0.1]).rotate([1, 0, 0], 90).scale(1.5)
    veil = {"type": "rectangle", "to_world": sheet, "bsdf": scenes.MATERIALS["veil"]()}
    problem = scene(**scenes.EMITTERS["rectangle"](), veil=veil)
    images = run(problem, method, passes=6, samples=128, **settings).images
    near(images, run(problem, "path", passes=6, samples=256).images, 0.02, name)


@pytest.mark.parametrize("name", thinned(("sppm", "pm", "pm final gather"), ("sppm",)))
def test_light_that_a_coated_surface_mirrors_is_a_caustic(name):
    """The first vertex has a smooth component too (black here), and stores a photon; what it reflects without
    scattering is still LS+D, to be looked up where the camera sees it."""
    method, settings = VARIANTS[name]
    coat = {"type": "plastic", "diffuse_reflectance": scenes.rgb(0, 0, 0), "int_ior": 3.0}
    problem = scene(
        lamp={"type": "point", "position": [-0.6, 1.0, 0.0], "intensity": scenes.rgb(1, 1, 1)},
        # Keeps the lamp's direct light off what the camera sees.
        shade=disk([-0.6, 0.5, 0.0], [-0.6, -1.0, 0.0], 0.9),
        mirror=disk([0.2, 1.4, 0.0], [0.2, 0.0, 0.0], 1.2) | {"bsdf": {"type": "twosided", "a": coat}},
    )
    images = run(problem, method, passes=6, samples=128, **settings).images
    reference = run(problem, "bpt", passes=6, samples=256).images
    assert reference.mean() > 1e-3
    near(images[..., :1], reference[..., :1], 0.03, name)


def disk(at: list[float], towards: list[float], radius: float) -> dict[str, Any]:
    up = [1, 0, 0] if at[0] == towards[0] else [0, 0, 1]
    place = scenes.transform().look_at(at, towards, up).scale([radius, radius, 1.0])
    return {"type": "disk", "to_world": place, "bsdf": scenes.diffuse(0, 0, 0)}


@pytest.mark.parametrize("name", thinned(VARIANTS, ("sppm", "pm photons")))
def test_a_beam_is_found_by_its_photons(name):
    """Next event cannot find what a directionalarea shines on: irradiance E on a white floor is E / pi to the eye."""
    method, settings = VARIANTS[name]
    beam = {"type": "directionalarea", "radiance": scenes.rgb(2, 2, 2)}
    lamp = {"type": "rectangle", "to_world": scenes._down(2.2, 3.0), "emitter": beam}
    if method == "pm":  # the rule of k - 1 of k is for independent photons; even ones are nearer to k - 1/2
        settings = settings | {"sampler": "independent"}
    images = run(scene(lamp=lamp, floor=floor(0.8, 0.8, 0.8)), method, passes=6, samples=64, **settings).images
    assert_mean(images[:, 6:, 4:12].mean(axis=(1, 2, 3)), 0.8 * 2.0 / np.pi, name)


@pytest.mark.parametrize("method", ["bpt", "vcm"])
def test_a_beam_is_found_where_direct_light_is_left_to_next_event(method):
    """Splats and merges remain where next event finds nothing."""
    beam = {"type": "directionalarea", "radiance": scenes.rgb(2, 2, 2)}
    lamp = {"type": "rectangle", "to_world": scenes._down(2.2, 3.0), "emitter": beam}
    problem = scene(lamp=lamp, floor=floor(0.8, 0.8, 0.8))
    images = run(problem, method, passes=6, samples=64, direct_light="next_event").images
    assert_mean(images[:, 6:, 4:12].mean(axis=(1, 2, 3)), 0.8 * 2.0 / np.pi, method)


def caustic_in_a_mirror(bulb: bool) -> Any:
    """A floor under a point light, seen only in a mirror; the light may be the centre of a glass ball.

    From the centre every ray leaves the ball unbent, and what is reflected inside comes back: all the light gets out,
    evenly. So the two pictures are the same, but only without the ball can next event make them. The light is behind
    the mirror, which therefore throws none of it on the floor.
    """
    elements = {
        "lamp": {"type": "point", "position": [0.0, 1.2, 1.6], "intensity": scenes.rgb(1, 2, 3)},
        "mirror": disk([0.0, 1.6, 0.8], [0.0, 0.9, -0.2], 0.5) | {"bsdf": {"type": "conductor"}},
        "sensor": scenes.camera((0.0, 2.0, -1.8), (0.0, 1.6, 0.8), fov=16.0),
    }
    if bulb:
        ball = {"type": "sphere", "center": [0.0, 1.2, 1.6], "radius": 0.1, "bsdf": {"type": "dielectric"}}
        elements["bulb"] = ball
    return scene(**elements)


@pytest.mark.parametrize("method", ["path", "bpt"])
def test_the_caustic_of_a_point_light_in_a_mirror_is_out_of_reach(method):
    """LS+DSE: nothing that joins vertices by edges can make it."""
    assert not run(caustic_in_a_mirror(bulb=True), method, passes=2, samples=64).images.any()


@pytest.mark.parametrize("method", thinned(("pm", "ppm", "sppm", "vcm"), ("sppm",)))
def test_the_caustic_of_a_point_light_in_a_mirror(method):
    """What photons make of it is what next event makes of the same light without the bulb."""
    settings = {"radius": 0.06, "radius_unit": "absolute", "alpha": 1.0, "light_paths": 2.0}
    if method == "pm":
        settings = {"neighbours": 20, "photons": PHOTONS}
    images = run(caustic_in_a_mirror(bulb=True), method, passes=6, samples=64, **settings).images
    reference = run(caustic_in_a_mirror(bulb=False), "path", passes=6, samples=64).images
    assert reference.mean() > 0.05
    near(images, reference, 0.03, method)


# ---------------------------------------------------------------------------------------------------- memory


def test_photons_beyond_memory_are_refused_or_fewer():
    problem = scenes.room("sphere", scenes.FEW)
    with pytest.raises(
        OptionError, match=r"photons=100000000 needs a memory limit of \d+ MB; raise the limit, or lower photons to \d+"
    ):
        prepared(problem, "pm", photons=100_000_000)
    problem.memory = 1_300_000
    with pytest.raises(OptionError, match="memory limit"):
        prepared(problem, "pm")
    settings = {"radius": 0.05, "radius_unit": "absolute", "alpha": 1.0}
    few = prepared(problem, "sppm", samples_per_pass=64, **settings)
    few_images = go(few, 6)
    assert few_images.measurement.counters["photons"] / 6 * 128 < 0.4 * problem.memory
    problem.memory = None
    all_images = run(problem, "sppm", passes=6, samples=64, seed=2, **settings)
    assert all_images.measurement.counters["photons"] > 1.5 * few_images.measurement.counters["photons"]
    assert_agree(few_images.images, all_images.images, "fewer light paths")


@pytest.mark.parametrize("method", thinned(["pm", "sppm"], ["sppm"]))
def test_a_pilot_that_guessed_too_low(method):
    """The store overflows, and the light paths are traced again with more room: as many, and the same picture."""
    problem = scenes.room("sphere", scenes.FEW)
    first, second = (prepared(problem, method, samples_per_pass=16) for _ in range(2))
    expected = first.step(0, 1)
    second.tracer.room.per_path = 0.01
    result = second.step(0, 1)
    assert result.counters["photons"] == expected.counters["photons"]
    np.testing.assert_allclose(result.mean(), expected.mean(), rtol=1e-4, atol=1e-6)


def test_final_gather_needs_next_event():
    with pytest.raises(OptionError, match="final_gather"):
        prepared(scenes.field(0.5, 1.0), "pm", final_gather=True, direct="photons")


def test_radii_shrink_and_the_mean_stays():
    """alpha below 1 on a plane of constant irradiance: no bias whatever the radius, and less and less of it left."""
    settings = {"radius": 0.3, "radius_unit": "absolute", "alpha": 0.3, "direct": "photons"}
    runner = prepared(scenes.field(0.5, 1.3), "sppm", samples_per_pass=64, **settings)
    images = go(runner, 12).images
    assert np.array(runner.state()["radius_squared"]).max() < 0.5 * 0.3**2
    z = z_scores(images[6:].mean(axis=(1, 2)), 0.5 * 1.3)
    assert np.abs(z).max() < 4.0, z
