"""Ambient terms: closed forms, and what the thesis lets expect of them [Castro 2002, ch. 6] (checks 28 to 32)."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.radiosity.ambient import equal_factors
from support.patches import cube, room

import etendue
from etendue.cli.main import main
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    ChainedRays,
    Part,
    Patches,
    RadiosityError,
    RayScene,
    SpherePairs,
    SubScene,
    SurfaceError,
    ambient_solution,
    box,
    exact_form_factors,
    find_objects,
    finished,
    form_factors,
    grouped,
    hierarchical_ambient,
    joined,
    multipath,
    multipath_bundles,
    read_solution,
    shot_at_patches,
    solve,
    spread,
    sub_scenes,
    sub_scenes_of,
)
from etendue.surfaces import AMBIENT_TERMS, class_factors, class_light, class_weights


def some_power(patches, seed=0):
    return np.random.default_rng(seed).random((len(patches), patches.channels)) * patches.areas[:, None]


def mean(patches, light):
    return (patches.areas[:, None] * light).sum(axis=0) / patches.areas.sum()


def directions(count=400, seed=1):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


# ---------------------------------------------------------------------------------------------------- terms


def test_the_classic_term_is_the_mean_irradiance_of_a_closed_scene():
    """U / (A (1 - rho)), which form factors by contours give, too."""
    patches = cube(3, reflectance=0.6, emission=np.random.default_rng(3).random((54, 1)))
    exact = solve(patches, exact_form_factors(patches), "gauss-seidel", tolerance=1e-10)
    power = (patches.areas[:, None] * patches.emission).sum()
    light = ambient_solution(patches, "classic").irradiance
    np.testing.assert_allclose(light, power / (patches.areas.sum() * 0.4), rtol=1e-12)
    np.testing.assert_allclose(mean(patches, exact.irradiance), light[0], rtol=1e-7)


def test_terms_by_classes_have_the_mean_of_the_classic_one():
    patches = cube(2, reflectance=0.6)
    power = some_power(patches)
    classic = spread(patches, power, "classic")[0]
    for term in ("crisp", "fuzzy"):
        np.testing.assert_allclose(mean(patches, spread(patches, power, term)), classic, rtol=1e-12)
        even = patches.areas[:, None] * 0.7
        np.testing.assert_allclose(spread(patches, even, term), spread(patches, even, "classic"), rtol=1e-12)


def test_no_light_is_made_or_lost_in_rooms_of_any_shape():
    """By reciprocal class form factors; by those of a cube a flat room has half as much light again."""
    patches = Patches(*box((0, 0, 0), (10, 8, 2), 1, inward=True), reflectance=0.6)
    power = np.zeros((6, 1))
    power[0] = 1.0
    weights = class_weights("crisp", patches.normals)
    classic = spread(patches, power, "classic")[0]
    np.testing.assert_allclose(mean(patches, spread(patches, power, "crisp")), classic, rtol=1e-12)
    of_a_cube = class_light(weights, patches.areas, patches.reflectance, power, factors=equal_factors)
    assert mean(patches, weights @ of_a_cube) > 1.3 * classic


def test_colours_bleed_onto_what_faces_them():
    """A white cube between a red wall (low x) and a green one: the classic term shows no tint."""
    red, green, grey = (0.8, 0.1, 0.1), (0.1, 0.8, 0.1), (0.5, 0.5, 0.5)
    walls = box((0, 0, 0), (3, 3, 3), 1, inward=True)
    x = walls[0][walls[1]].mean(axis=1)[:, 0]
    white = box((1, 1, 1), (2, 2, 2), 1)
    rho = [red if at == 0 else green if at == 3 else grey for at in x] + [(0.9, 0.9, 0.9)] * 6
    patches = Patches(*joined(walls, white), reflectance=rho)
    ceiling = (patches.normals[:, 2] == -1) & (np.arange(12) < 6)
    patches = patches.with_properties(emission=ceiling[:, None] * np.ones((12, 3)))
    for term in ("crisp", "fuzzy"):
        light = ambient_solution(patches, term).irradiance[6:]
        r_over_g = light[:, 0] / light[:, 1]
        towards = patches.normals[6:, 0]
        assert r_over_g[towards == -1] > 1.05
        assert r_over_g[towards == 1] < 1 / 1.05
        np.testing.assert_allclose(r_over_g[towards == 0], 1.0, rtol=1e-12)
    assert np.ptp(ambient_solution(patches, "classic").irradiance, axis=0).max() == 0


def test_class_weights():
    """They sum to 1; at most three are above zero; along an axis fuzzy is crisp."""
    normals = np.concatenate([directions(), np.zeros((1, 3))])
    for term in AMBIENT_TERMS:
        np.testing.assert_allclose(class_weights(term, normals).sum(axis=1), 1.0, rtol=1e-12)
    assert (class_weights("fuzzy", normals[:-1]) > 0).sum(axis=1).max() == 3
    assert (class_weights("crisp", normals[:-1]) > 0).sum(axis=1).max() == 1
    axes = np.repeat(np.eye(3), 2, axis=0) * np.tile([1, -1], 3)[:, None]
    np.testing.assert_array_equal(class_weights("crisp", axes), np.eye(6))
    np.testing.assert_array_equal(class_weights("fuzzy", axes), np.eye(6))
    crisp, fuzzy = (spread(room(2, reflectance=0.5), some_power(room(2)), term) for term in ("crisp", "fuzzy"))
    np.testing.assert_array_equal(crisp, fuzzy)


def test_on_a_sphere_the_fuzzy_term_is_continuous():
    """Around a circle in ten thousand steps: the crisp term jumps, the fuzzy one does not."""
    angle = np.linspace(0, 2 * np.pi, 10_000)
    normals = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.ones_like(angle)], axis=1) / np.hypot(1, 0.3)
    light = np.random.default_rng(2).random((6, 1))
    steps = {term: np.abs(np.diff((class_weights(term, normals) @ light)[:, 0])).max() for term in ("crisp", "fuzzy")}
    assert steps["fuzzy"] < 0.002
    assert steps["crisp"] > 0.05


@pytest.mark.parametrize(
    "areas",
    [
        np.ones(6),
        np.array([1, 2, 3, 4, 5, 6.0]),
        np.array([1, 1, 1, 1, 4, 6.0]),  # the largest less than the rest by little
        np.array([1, 1, 1, 1, 1, 5.0]),  # as large
        np.array([1, 1, 0, 0, 3, 9.0]),
        np.array([0, 0, 0, 0, 1, 1.0]),
        np.array([0, 0, 0, 0, 0, 1.0]),
        np.ones(1),
    ],
    ids=str,
)
def test_class_factors(areas):
    """Reciprocal, closed, not negative; a class sees itself only by what the others leave."""
    factors = class_factors(areas)
    assert (factors >= 0).all()
    np.testing.assert_allclose(factors.sum(axis=1), 1.0, rtol=1e-12)
    has_area = areas > 0
    exchange = (areas[:, None] * factors)[has_area][:, has_area]
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-9 * areas.max())
    itself = np.diag(factors)[has_area]
    most = np.maximum(2 * areas - areas.sum(), 0)[has_area] / areas[has_area]
    np.testing.assert_allclose(itself, most, atol=1e-9)
    if len(set(areas)) == 1 and len(areas) > 1:
        np.testing.assert_allclose(factors, equal_factors(areas), atol=1e-12)


def test_where_things_are_makes_no_difference(monkeypatch):
    """Nor what hides what: and all that is solved is one system of 6 x 6 for each channel."""
    near = joined(box((0, 0, 0), (4, 4, 4), 2, inward=True), box((1, 1, 1), (2, 2, 2), 2))
    far = joined(box((0, 0, 0), (4, 4, 4), 2, inward=True), box((2.5, 2.5, 2.9), (3.5, 3.5, 3.9), 2))
    solved, inner = [], np.linalg.solve
    monkeypatch.setattr(np.linalg, "solve", lambda a, b: solved.append(a.shape) or inner(a, b))
    lit = {"reflectance": (0.5, 0.6, 0.7), "emission": np.random.default_rng(0).random((48, 3))}
    lit["reflectance"] = np.broadcast_to(lit["reflectance"], (48, 3))
    one, other = (ambient_solution(Patches(*mesh, **lit)) for mesh in (near, far))
    np.testing.assert_allclose(one.irradiance, other.irradiance, rtol=1e-12)
    assert solved == [(3, 6, 6), (3, 6, 6)]


def test_light_that_leaves_the_scene():
    """A share of 0.3 that is lost at every surface: sent is absorbed and lost."""
    patches = room(2, reflectance=0.5)
    lost = np.full(len(patches), 0.3)
    power = some_power(patches)
    for term in AMBIENT_TERMS:
        light = spread(patches, power, term, lost)
        areas = patches.areas[:, None]
        away = 0.3 * (power + areas * patches.reflectance * light).sum()
        np.testing.assert_allclose((areas * 0.5 * light).sum() + away, power.sum(), rtol=1e-12)
        assert spread(patches, power, term, np.ones(len(patches))).max() < 1e-12


def test_bad_input():
    with pytest.raises(SurfaceError, match="no ambient term 'diffuse'; there are: classic"):
        ambient_solution(cube(1, emission=1.0), "diffuse")
    with pytest.raises(RadiosityError, match="what sees the sky"):
        ambient_solution(cube(1, emission=1.0, sky=1.0))
    with pytest.raises(RadiosityError, match="no patch emits"):
        ambient_solution(cube(1))


# ---------------------------------------------------------------------------------------------------- finishing


class Sphere:
    """Transport inside a sphere: every patch sees all others by their areas, and a share of what is outside."""

    exchange_weights = None

    def __init__(self, patches, sky=0.0):
        self.patches, self.outside = patches, np.full(len(patches), sky)

    def gather(self, values, sky):
        share = self.outside[0]
        return np.broadcast_to((1 - share) * mean(self.patches, values), values.shape) + share * sky


@pytest.mark.parametrize("sky", [0.0, 0.25])
def test_inside_a_sphere_the_classic_term_is_exact(sky):
    """After however few bounces."""
    patches = room(2, reflectance=0.7, emission=np.random.default_rng(0).random((48, 1)), sky=1.0)
    exact = solve(patches, Sphere(patches, sky), "jacobi", tolerance=1e-12)
    for bounces in (1, 3):
        early = solve(patches, Sphere(patches, sky), "jacobi", max_iterations=bounces, ambient="classic")
        np.testing.assert_allclose(early.radiosity, exact.radiosity, rtol=1e-9)
        np.testing.assert_allclose(early.irradiance, exact.irradiance, rtol=1e-9)
        assert len(early.residuals) == bounces
    with pytest.raises(RadiosityError, match="after 3 iterations"):
        solve(patches, Sphere(patches, sky), "jacobi", max_iterations=3)


@pytest.mark.parametrize("solver", ["jacobi", "southwell", "conjugate-gradient"])
def test_what_solvers_leave(solver):
    """Stopped after an iteration, the fuzzy term takes away most of the error; converged, it changes nothing."""
    emission = np.zeros((room(3).areas.size, 1))
    emission[:5] = 1.0
    patches = room(3, reflectance=0.7, emission=emission)
    factors = form_factors(ABuffer(patches, lines=4096.0).cast(256))
    exact = solve(patches, factors, "direct").irradiance
    early = solve(patches, factors, solver, max_iterations=1, ambient="fuzzy").irradiance
    late = solve(patches, factors, solver, ambient="fuzzy").irradiance
    # What is left without the term, from the same iteration by a tolerance that it just meets.
    residual = solve(patches, factors, solver, max_iterations=1, ambient="fuzzy").residual
    without = solve(patches, factors, solver, tolerance=residual).irradiance
    error = [np.sqrt((patches.areas[:, None] * (found - exact) ** 2).sum()) for found in (early, without, late)]
    assert error[0] < 0.5 * error[1]
    assert error[2] < 1e-3 * error[1]


def test_what_multipath_leaves():
    """With few lines much is unshot: with it all power is absorbed, and the error is less."""
    patches = room(2, reflectance=0.8, emission=np.arange(48)[:, None] < 24)
    exact = solve(patches, form_factors(ABuffer(patches).cast(512)), "direct").radiosity
    errors = []
    for seed in range(8):
        found = multipath(ChainedRays(SpherePairs(patches), RayScene(patches), Independent(4, seed=seed)), 100)
        whole = finished(patches, found)
        # A closed room: what is neither absorbed nor unshot is rounding.
        np.testing.assert_allclose(whole.to_sky, found.to_sky, rtol=0, atol=1e-9 * whole.sent.max())
        assert found.unshot.sum() > 0.01 * found.sent
        errors.append([mean(patches, (result.radiosity - exact) ** 2)[0] for result in (found, whole)])
    before, after = np.mean(errors, axis=0)
    assert after < before


# ---------------------------------------------------------------------------------------------------- parts of scenes


def three_rooms(powers=(3.0, 2.0, 1.0)):
    """A hall with three open booths; each has a lamp of its own power."""
    meshes, parts, emission = [box((0, 0, 0), (12, 4, 4), (6, 2, 2), inward=True)], [], []
    for k, _ in enumerate(powers):
        meshes += [
            box((4 * k + 1, 1, 1), (4 * k + 3, 3, 1.2), 2),
            box((4 * k + 1.5, 1.5, 2.8), (4 * k + 2.5, 2.5, 3), 1),
        ]
    sizes = [len(mesh[1]) for mesh in meshes]
    parts = np.repeat([-1, 0, 0, 1, 1, 2, 2], sizes)
    emission = np.zeros(len(parts))
    ends = np.cumsum(sizes)
    for k, power in enumerate(powers):
        emission[ends[2 * k + 1] : ends[2 * k + 2]] = power
    return Patches(*joined(*meshes), reflectance=0.5, emission=emission), parts


@pytest.mark.parametrize("term", AMBIENT_TERMS)
def test_parts_keep_their_light(term):
    """The stronger the lamp, the more light in its part; in one piece, equal normals have equal light. No light is made
    or lost, whatever the number of iterations."""
    patches, parts = three_rooms()
    power = patches.areas[:, None] * patches.emission
    scene = sub_scenes(patches, parts)
    found = hierarchical_ambient(patches, scene, power, term)
    light = [mean_of(patches, found.irradiance, parts == k) for k in range(3)]
    assert light[0] > 1.1 * light[1] > 1.1**2 * light[2]
    whole = spread(patches, power, term)
    light = [mean_of(patches, whole, parts == k) for k in range(3)]
    np.testing.assert_allclose(light, light[0], rtol=1e-12)
    for iterations in (1, 4, 1000):
        part = hierarchical_ambient(patches, scene, power, term, iterations=iterations)
        absorbed = (patches.areas[:, None] * 0.5 * part.irradiance).sum()
        np.testing.assert_allclose(absorbed + part.left, power.sum(), rtol=1e-12)
    assert part.left < 1e-6 * power.sum()
    assert part.iterations < 100


def mean_of(patches, light, which):
    return float((patches.areas[which] * light[which, 0]).sum() / patches.areas[which].sum())


def test_without_parts_nothing_changes():
    patches, _ = three_rooms()
    power = patches.areas[:, None] * patches.emission
    for scene in (SubScene(np.arange(len(patches))), sub_scenes(patches, np.full(len(patches), -1))):
        for term in AMBIENT_TERMS:
            found = hierarchical_ambient(patches, scene, power, term)
            np.testing.assert_allclose(found.irradiance, spread(patches, power, term), rtol=1e-12)
            assert found.iterations == 1


def test_parts_inside_parts():
    """A box between two parts of one level and three patches inside: power is kept, and a part that holds nothing but
    another does not change what is inside by much."""
    patches, parts = three_rooms()
    power = patches.areas[:, None] * patches.emission
    flat = sub_scenes(patches, parts)
    nested = SubScene(
        flat.patches, (SubScene(np.zeros(0, int), flat.parts[:1], *bounds(flat.parts[0])), *flat.parts[1:])
    )
    for scene in (flat, nested):
        found = hierarchical_ambient(patches, scene, power)
        absorbed = (patches.areas[:, None] * 0.5 * found.irradiance).sum()
        np.testing.assert_allclose(absorbed + found.left, power.sum(), rtol=1e-12)
        assert (found.left < 1e-6 * power.sum()).all()


def bounds(part):
    return part.low - 0.1, part.high + 0.1


def test_bad_parts():
    patches, parts = three_rooms()
    with pytest.raises(RadiosityError, match=f"one for each of {len(patches)} patches, not float64"):
        sub_scenes(patches, parts.astype(float))
    twice = SubScene(np.arange(len(patches)), (SubScene(np.array([3, 4])),))
    with pytest.raises(RadiosityError, match="patch 3 is in several of the parts of the scene, as 1 others"):
        ambient_solution(patches, "fuzzy", twice)
    with pytest.raises(RadiosityError, match="patch 0 is in none"):
        ambient_solution(patches, "fuzzy", SubScene(np.arange(1, len(patches))))


# ---------------------------------------------------------------------------------------------------- doors


def test_at_once(tmp_path):
    """By Python and by the command line, to files that are read again."""
    patches = room(2, reflectance=0.6, emission=np.arange(48)[:, None] < 8)
    file = tmp_path / "room.npz"
    result = etendue.solve_radiosity(patches, ambient="crisp", save=file)
    np.testing.assert_array_equal(result.solution.irradiance, ambient_solution(patches, "crisp").irradiance)
    assert (result.bundles, result.segments, result.stopped_by) == (0, None, "ambient")
    assert np.isnan(result.solution.residual) and result.solution.imbalance < 1e-12
    read, error = read_solution(file)
    np.testing.assert_array_equal(read.radiosity, result.solution.radiosity)
    assert error is None and read.residuals == ()
    other = tmp_path / "box.npz"
    found = etendue.solve_radiosity("cornell-box", "ambient", max_area=0.1).solution
    # With a name, without one, and as a method.
    for words in ("cornell-box --ambient fuzzy", "--ambient cornell-box", "cornell-box -m ambient"):
        assert main(["radiosity", *words.split(), "-o", str(other), "--max-area", "0.1"]) == 0
        np.testing.assert_array_equal(read_solution(other)[0].radiosity, found.radiosity)


def test_after_some_bounces():
    patches = room(2, reflectance=0.6, emission=np.arange(48)[:, None] < 8)
    asked = {"bundles": 32, "shot": False, "local_rays": False}
    early = etendue.solve_radiosity(patches, ambient="fuzzy", bounces=2, **asked)
    jacobi = etendue.solve_radiosity(patches, solver="jacobi", ambient="fuzzy", bounces=2, **asked)
    # On a GPU sums are added in any order.
    np.testing.assert_allclose(early.solution.radiosity, jacobi.solution.radiosity, rtol=1e-13)
    assert len(early.solution.residuals) == 2 and early.bundles == 32
    whole = etendue.solve_radiosity(patches, solver="jacobi", **asked).solution
    np.testing.assert_allclose(mean(patches, early.solution.radiosity), mean(patches, whole.radiosity), rtol=0.01)


def test_an_iteration_of_conjugate_gradient_is_no_bounce(caplog):
    asked = {"ambient": "fuzzy", "bundles": 4, "shot": False, "local_rays": False}
    patches = room(2, reflectance=0.6, emission=np.arange(48)[:, None] < 8)
    for bounces, warns in ((1, False), (2, True)):
        etendue.solve_radiosity(patches, solver="conjugate-gradient", bounces=bounces, **asked)
        assert ("leave out the solver for jacobi" in caplog.text) == warns


def test_sub_scenes_by_name_and_by_boxes(tmp_path, monkeypatch, caplog):
    """From Python and the command line: booths by an array, and boxes around groups of objects."""
    meshio = pytest.importorskip("meshio")
    patches, parts = three_rooms()
    asked = {"ambient": "fuzzy"}
    exact = ambient_solution(patches, "fuzzy", sub_scenes(patches, parts)).irradiance
    monkeypatch.chdir(tmp_path)
    glow = patches.emission[:, 0]
    cells = {"booth": [parts], "glow": [glow]}
    meshio.write("hall.vtu", meshio.Mesh(patches.vertices, [("quad", patches.faces)], cell_data=cells))
    words = "radiosity hall.vtu --emission glow --reflectance 0.5 --ambient fuzzy -o a.npz"
    assert main([*words.split(), "--sub-scenes", "objects", "--objects", "booth"]) == 0
    np.testing.assert_allclose(read_solution("a.npz")[0].irradiance, exact, rtol=1e-12)
    named = etendue.solve_radiosity(patches, sub_scenes="objects", objects=parts, **asked).solution
    np.testing.assert_allclose(named.irradiance, exact, rtol=1e-12)
    boxed = sub_scenes_of(grouped(patches, find_objects(patches).of_patch, 0.5, least=1))
    assert 1 < len(boxed.parts) < 6
    exact = ambient_solution(patches, "fuzzy", boxed).irradiance
    boxes = etendue.solve_radiosity(patches, sub_scenes="boxes", threshold=0.5, least=1, **asked).solution
    np.testing.assert_allclose(boxes.irradiance, exact, rtol=1e-12)
    assert main([*words.split(), "--sub-scenes", "boxes", "--threshold", "0.5", "--least", "1"]) == 0
    np.testing.assert_allclose(read_solution("a.npz")[0].irradiance, exact, rtol=1e-12)
    slabs = etendue.solve_radiosity(patches, sub_scenes="components", **asked).solution
    assert slabs.imbalance < 1e-5 and np.abs(slabs.irradiance / exact - 1).max() > 0.01
    etendue.solve_radiosity(patches, sub_scenes="boxes", least=1000, **asked)
    assert "no object or group is worth a box" in caplog.text


def test_copies_of_a_part_are_sub_scenes_where_they_are():
    """As if their patches had been grouped in the scene; a turned copy has the box around it along the axes."""
    booth = Patches(*box((-0.5, -0.5, 0), (0.5, 0.5, 1), 1), reflectance=0.5, emission=1.0)
    hall = Patches(*box((0, 0, 0), (6, 4, 3), 2, inward=True), reflectance=0.5)
    places = np.array([np.eye(4)] * 2)
    places[:, :3, 3] = (1, 1, 0.5), (4, 2, 1)
    places[1, :2, :2] = [[0, -2], [2, 0]]
    places[1, 2, 2] = 2
    root = Part(hall, [(Part(booth), places)])
    joined_patches, number = root.joined(), np.repeat([-1, 0, 1], [24, 6, 6])
    found, expected = sub_scenes_of(root, is_joined=True), sub_scenes(joined_patches, number)
    for one, other in zip(found.parts, expected.parts, strict=True):
        np.testing.assert_array_equal(one.patches, other.patches)
        np.testing.assert_allclose([one.low, one.high], [other.low, other.high], atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ambient": "fuzz"}, "no ambient term 'fuzz'; did you mean 'fuzzy'"),
        ({"ambient": "fuzzy", "bundles": 4}, "no lines are cast, so leave out bundles"),
        ({"ambient": "fuzzy", "lines": 9, "checkpoint": "c"}, "leave out checkpoint, lines"),
        ({"ambient": "fuzzy", "solver": "jacobi"}, "a solver is for method lines; ambient solves by itself"),
        ({"ambient": "fuzzy", "method": "multipath"}, "ambient light without bounces needs no method 'multipath'"),
        ({"method": "multipath", "ambient": "fuzzy", "bounces": 3}, "bounces is for method lines"),
        ({"bounces": 3}, "bounces leaves light over: say by ambient how to spread it"),
        ({"sub_scenes": "objects"}, "sub_scenes is for an ambient solution at once"),
        ({"ambient": "fuzzy", "bounces": 2, "sub_scenes": "objects"}, "without bounces"),
        ({"ambient": "fuzzy", "objects": "labels"}, "objects is for boxes and sub-scenes"),
        ({"ambient": "fuzzy", "sub_scenes": "booth"}, "or by an array of a mesh file, not by 'booth'"),
        ({"ambient": "fuzzy", "sub_scenes": "objects", "levels": 2}, "levels is for boxes"),
        ({"ambient": "fuzzy", "sub_scenes": "boxes", "levels": 0}, "option 'levels' must be at least 1"),
        ({"ambient": "fuzzy", "bounces": 0}, "bounces is a whole number of at least 1"),
        ({"ambient": "fuzzy", "wait": False}, "makes its result at once, without passes: leave out wait"),
    ],
)
def test_options_that_do_not_go_together(options, message):
    with pytest.raises(etendue.OptionError, match=message):
        etendue.solve_radiosity(cube(1, emission=1.0), **options)


def test_after_direct_light():
    """With a shot, what it has brought is not spread again: all power is found."""
    patches = room(2, reflectance=0.6, emission=np.arange(48)[:, None] < 4)
    shot = shot_at_patches(RayScene(patches), 1 << 12)
    found = ambient_solution(patches, "fuzzy", shot=shot)
    assert found.imbalance < 1e-9
    assert (found.irradiance >= shot.irradiance).all()
    exact = solve(patches, ABuffer(patches).cast(256), "conjugate-gradient", shot=shot).irradiance
    plain = ambient_solution(patches, "fuzzy").irradiance
    error = [np.sqrt(mean(patches, (light - exact) ** 2)) for light in (found.irradiance, plain)]
    assert error[0] < 0.5 * error[1]


def test_one_round_of_bundles_does():
    """Of multipath by bundles: with what is left spread, the error of one round is that of all."""
    patches = room(2, reflectance=0.7, emission=np.arange(48)[:, None] < 24)
    exact = solve(patches, ABuffer(patches).cast(1024), "conjugate-gradient").radiosity
    errors = []
    for seed in range(4):
        engine = ABuffer(patches, OwenSobol(4, seed=seed))
        one = multipath_bundles(engine, 64, rounds=1)
        found = one, finished(patches, one), multipath_bundles(engine, 64)
        errors.append([mean(patches, (each.radiosity - exact) ** 2)[0] for each in found])
    left, spread_out, whole = np.mean(errors, axis=0)
    assert spread_out < 0.5 * left
    assert spread_out < 2 * whole
