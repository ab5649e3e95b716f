"""The emitter ``luminaire``: its rays, its far field, every way in which methods sample it, and its parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.guides import taught
from support.luminaires import eulumdat, ies, lambertian, lopsided
from support.running import mitsuba_path, replicas, run
from support.spectral import spectral_variant
from support.statistics import LEVEL, assert_agree, assert_mean
from support.tables import thinned

from etendue.conformance import check_emitter
from etendue.core import IndependentSource, OptionError, SceneError
from etendue.lighting import EFFICACY, LightingError, PhotometricWeb, read_photometry
from etendue.scene import LightTable, SceneEditor, fingerprint, load, name_elements, portable, restored
from etendue.scene.plugins.webs import WebTable
from etendue.transport import emit, sample_direct

N = 200_000
#: Where the lamp is, and how it is turned.
PLACE, AXIS, ANGLE = [0.3, 1.9, -0.2], [1.0, 2.0, 0.5], 70.0


def narrow(c: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """A beam off the axis, in the lower half only."""
    return 900.0 * np.exp(-20.0 * (gamma - 0.5) ** 2 - (c - 2.0) ** 2) * (gamma <= np.pi / 2)


WEBS = {
    "lopsided": lambda: ies(lopsided, np.arange(0.0, 361.0, 15.0)),
    "narrow": lambda: ies(narrow, np.arange(0.0, 361.0, 10.0), np.arange(0.0, 91.0, 2.5)),
    "turning": lambda: eulumdat(lambertian),
    "down": lambda: ies(lambda c, g: 200 * np.cos(g), gamma=np.arange(0.0, 91.0, 5.0)),
    "up": lambda: ies(lambda c, g: -200 * np.cos(g), gamma=np.array([90.0, 120.0, 180.0])),
    "dark pole": lambda: ies(lambda c, g: 100 * np.sin(g), gamma=np.array([0.0, 90.0, 180.0])),
    "two angles": lambda: ies(lambda c, g: 100 + 0 * g, gamma=np.array([0.0, 90.0])),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in WEBS.items():
        (tmp_path / f"{name}.ies").write_text(text())
    return tmp_path


def turned() -> Any:
    return scenes.transform().translate(PLACE).rotate((np.array(AXIS) / np.linalg.norm(AXIS)).tolist(), ANGLE)


def lamp(folder: Path, name: str = "lopsided", **more: Any) -> dict[str, Any]:
    return {"type": "luminaire", "filename": str(folder / f"{name}.ies"), "to_world": turned()} | more


def stage(light: dict[str, Any], **more: Any) -> Any:
    """A floor and a wall under a lamp."""
    parts = {"floor": scenes.plate((0.0, 0.0, 0.0), 2.0, True)} | more
    wall = scenes.transform().translate([0, 1.5, -1.3]).scale([2.0, 1.5, 1.0])
    parts["wall"] = {"type": "rectangle", "to_world": wall, "bsdf": scenes.diffuse(0.4, 0.5, 0.6)}
    return {"type": "scene", "sensor": scenes.camera(), "light": light} | parts


def to_local(directions: np.ndarray) -> np.ndarray:
    """(n, 3) directions of the world in the lamp's coordinates."""
    return directions @ np.asarray(turned().matrix, np.float64).reshape(4, 4)[:3, :3]


def numbers(n: int = N, seed: int = 3) -> mi.Point2f:
    return mi.Point2f(np.random.default_rng(seed).random((2, n)).astype(np.float32))


# ------------------------------------------------------------------------------------------------------ the web


@pytest.mark.parametrize("name", WEBS)
def test_rays_follow_the_web(name, folder):
    """Chi-square of the sampled directions in boxes of (C, gamma), whose flux is that of the interpolated intensity."""
    web = read_photometry(folder / f"{name}.ies")
    table = WebTable(web)
    d = np.array(table.sample(numbers()), np.float64)
    np.testing.assert_allclose((d**2).sum(0), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.array(table.pdf(mi.Vector3f(d))), web.intensity(d.T) / web.flux, rtol=1e-3, atol=1e-4)
    c, gamma = np.arctan2(d[1], d[0]) % (2 * np.pi), np.arctan2(np.hypot(d[0], d[1]), -d[2])
    bounds = np.linspace(0, 2 * np.pi, 9), np.linspace(0, np.pi, 25)
    found, *_ = np.histogram2d(c, gamma, bounds)
    fine_c, fine = ((np.arange(n) + 0.5) / n * high for n, high in ((240, 2 * np.pi), (1200, np.pi)))
    at = np.stack(np.broadcast_arrays(*_direction(fine_c[:, None], fine[None])), -1)
    flux = web.intensity(at) * np.sin(fine) * (2 * np.pi / 240 * np.pi / 1200)
    expected = flux.reshape(8, 30, 24, 50).sum((1, 3)) / web.flux * N
    many = expected > 5.0
    assert many.sum() > 8
    assert found[~many].sum() <= expected[~many].sum() + 5 * np.sqrt(expected[~many].sum()) + 5
    statistic = ((found - expected)[many] ** 2 / expected[many]).sum()
    assert stats.chi2.sf(statistic, many.sum() - 1) > LEVEL


def _direction(c: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, ...]:
    return np.sin(gamma) * np.cos(c), np.sin(gamma) * np.sin(c), -np.cos(gamma)


def test_random_numbers_at_their_limits(folder):
    """No direction is undefined or dark, also at the pole, where the density of the angle is zero."""
    low, high = 0.0, 1.0 - 2.0**-24
    corners = mi.Point2f(np.array([[low, low, high, high, 0.5, 0.5], [low, high, low, high, low, high]], np.float32))
    for name in WEBS:
        table = WebTable(read_photometry(folder / f"{name}.ies"))
        d = np.array(table.sample(corners), np.float64)
        np.testing.assert_allclose((d**2).sum(0), 1.0, atol=1e-5, err_msg=name)


# ------------------------------------------------------------------------------------------------------ the emitter


@pytest.mark.parametrize("name", ["lopsided", "narrow"])
@pytest.mark.parametrize("spectral", [False, True])
def test_conformance(name, spectral, folder):
    def check() -> None:
        problem = load(stage(lamp(folder, name)))
        rows = check_emitter(problem.scene.emitters()[0], problem.scene)
        assert {f.test for f in rows} == {"range", "power"}
        assert all(f.verdict == "pass" for f in rows), rows

    if spectral:
        with spectral_variant():
            check()
    else:
        check()


def test_emitted_flux_is_that_of_the_file(folder):
    """Over the efficacy of 683 lm/W, in the mean of the channels, that of every ray, and in the light table."""
    web = read_photometry(folder / "lopsided.ies")
    problem = load(stage(lamp(folder)))
    _, weight = problem.scene.emitters()[0].sample_ray(0.0, 0.5, mi.Point2f(0.5), numbers())
    np.testing.assert_allclose(np.array(weight), web.flux / EFFICACY, rtol=1e-5)
    assert LightTable(problem.scene).total_power * EFFICACY == pytest.approx(web.flux, rel=1e-5)
    dimmed = load(stage(lamp(folder, flux=3000.0, dimming=0.25, color=scenes.rgb(1.0, 0.5, 0.1))))
    light = np.array(dimmed.scene.emitters()[0].sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.4))[1]).ravel()
    assert light @ [0.2126, 0.7152, 0.0722] * EFFICACY == pytest.approx(750.0, rel=1e-4)
    np.testing.assert_allclose(light / light[0], [1.0, 0.5, 0.1], rtol=1e-5)


def test_emission_and_next_event_know_one_density(folder):
    """That of the web, of rays that are sampled and of light points; also where directions are learned."""
    web = read_photometry(folder / "lopsided.ies")
    problem = load(stage(lamp(folder), other=scenes.EMITTERS["point"]()["light"]))
    guide, source = taught(problem), IndependentSource(dr.arange(mi.UInt32, N), 5, "test", 0)
    for lights, departures in ((LightTable(problem.scene), None), (guide.lights, guide.departures)):
        emitted = emit(lights, source, mi.Bool(True), departures)
        mine = np.array(emitted.light) == [e.id() for e in problem.scene.emitters()].index("light")
        own = web.intensity(to_local(np.array(emitted.ray.d, np.float64).T)) / web.flux
        np.testing.assert_allclose(np.array(emitted.own_pdf)[mine], own[mine], rtol=1e-4)
        inverse = np.array(dr.select(emitted.active, dr.rcp(emitted.emission_density), 0.0), np.float64)
        assert_mean(mine * inverse, 4 * np.pi, sigmas=5.0)
        carried = np.array(emitted.throughput, np.float64)[0] / np.where(inverse > 0, inverse, 1.0)
        np.testing.assert_allclose(carried[mine], own[mine] * web.flux / EFFICACY, rtol=1e-3)
        # The same directions backwards, from points that they light.
        si = problem.scene.ray_intersect(emitted.ray)
        direct = sample_direct(lights, si, source, mi.UInt32(1), 0, si.is_valid(), departures)
        lit = np.array(direct.active) & mine & (np.array(direct.light) == np.array(emitted.light))
        assert lit.sum() > 1000
        ratio = np.array(direct.light_ratio * direct.pdf)
        np.testing.assert_allclose(ratio[lit], np.array(emitted.emission_density)[lit], rtol=5e-3)


# ------------------------------------------------------------------------------------------------------ pictures


@pytest.mark.parametrize("spectral", [False, True])
def test_illuminance_of_a_plane(spectral, folder):
    """E = I cos / d^2 [CIE 171, case 5.2] in the pixels of a map of the floor, whose luminance is E / (2 pi)."""
    web = read_photometry(folder / "lopsided.ies")
    side, fine = 8, 32
    view = scenes.transform().look_at([0, 1.0, 0], [0, 0, 0], [0, 0, 1])
    sensor = scenes.camera(sensor="orthographic", size=(side, side)) | {"to_world": view}
    floor = {"type": "rectangle", "bsdf": scenes.diffuse(0.5, 0.5, 0.5)}
    floor["to_world"] = scenes.transform().rotate([1, 0, 0], -90).scale(3.0)
    described = {"type": "scene", "sensor": sensor, "light": lamp(folder), "floor": floor}

    def images() -> np.ndarray:
        problem = load(described)
        u = (np.arange(side * fine) + 0.5) / fine
        x, y = np.meshgrid(u, u)
        film = mi.Point2f(x.ravel().astype(np.float32) / side, y.ravel().astype(np.float32) / side)
        ray, _ = problem.sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
        nonlocal points
        points = np.array(problem.scene.ray_intersect(mi.Ray3f(ray)).p, np.float64).T
        return run(problem, "path", 8, 64, max_depth=2).images if not spectral else replicas(problem, "path", 8, 16, 8)

    points = np.zeros(0)
    if spectral:
        with spectral_variant():
            found = images()
    else:
        found = images()
    offset = points - PLACE
    distance = np.linalg.norm(offset, axis=1)
    illuminance = web.intensity(to_local(offset)) * -offset[:, 1] / distance**3
    expected = illuminance.reshape(side, fine, side, fine).mean((1, 3)) * 0.5 / np.pi
    luminance = found @ [0.2126, 0.7152, 0.0722] * EFFICACY
    error = luminance.std(0, ddof=1) / np.sqrt(len(found))
    # Spectral: white is white within a quadrature of 64 wavelengths and the tables of the eye's sensitivity.
    assert (np.abs(luminance.mean(0) - expected) <= 5.5 * error + (5e-3 if spectral else 2e-4) * expected).all()
    assert expected.max() > 3 * expected.min()


#: Methods whose passes depend on each other, or learn: (camera paths of a pass and pixel, settings).
REPLICAS: dict[str, tuple[int, dict[str, Any]]] = {
    "bpt": (64, {}),
    "bpt learned": (64, {"guide_emission": "on"}),
    "vcm": (64, {"radius": 0.02}),
    "guided": (64, {"cell_samples": 500}),
    "auto": (64, {"radius": 0.01}),
    "sppm": (64, {"radius": 0.01, "light_paths": 16.0}),
    "pssmlt": (128, {"bootstrap": 1 << 14}),
    "mmlt": (64, {"bootstrap": 1 << 12}),
}


@pytest.mark.parametrize(
    ("method", "name"),
    thinned(
        [
            ("light", "lopsided"),
            ("bpt", "narrow"),
            ("bpt learned", "lopsided"),
            ("vcm", "lopsided"),
            ("guided", "lopsided"),
            ("auto", "narrow"),
            ("sppm", "lopsided"),
            ("pssmlt", "narrow"),
            ("mmlt", "lopsided"),
            ("mitsuba", "narrow"),
        ],
        [("light", "lopsided"), ("vcm", "lopsided"), ("mitsuba", "narrow")],
    ),
)
def test_methods_agree(method, name, folder):
    """Light paths, connections, merges, photons, guides, chains and learned directions against ``path``, beside another
    lamp."""
    other = scenes.EMITTERS["spot"]()["light"] | {"intensity": 0.3}
    problem = load(stage(lamp(folder, name), ball=scenes.thing("phong", (-0.5, 0.302, 0.3)), other=other))
    reference = run(problem, "path", 8, 256, max_depth=4).images
    if method == "mitsuba":
        images = mitsuba_path(problem, 8, 256, max_depth=4)
    elif method == "light":
        images = run(problem, method, 8, 256, max_depth=4).images
    else:
        samples, settings = REPLICAS[method]
        images = replicas(problem, method.split()[0], 6, 2, samples, max_depth=4, **settings)
    assert_agree(images, reference, (method, name), precision=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["bpt", "light"])
def test_spectral_methods_agree(method, folder):
    color = {"type": "blackbody", "temperature": 2700.0}
    with spectral_variant():
        problem = load(stage(lamp(folder, color=color)))
        reference = replicas(problem, "path", 6, 8, 16, max_depth=3)
        assert_agree(replicas(problem, method, 6, 8, 16, max_depth=3), reference, method, precision=0.03)


# ------------------------------------------------------------------------------------------------------ parameters


def test_parameters_can_be_changed(folder):
    problem = load(stage(lamp(folder)), change=name_elements)
    editor = SceneEditor(problem.scene)
    mine = {p.label: p for p in editor.list() if p.plugin == "luminaire"}
    assert set(mine) == {"to_world", "flux", "dimming", "color"}
    before = fingerprint(problem.scene, None)
    editor.set({"light.dimming": 0.5, "light.flux": 1366.0})
    light = problem.scene.emitters()[0]
    weight = np.array(light.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.4))[1])
    np.testing.assert_allclose(weight, 1.0, rtol=1e-5)
    assert fingerprint(problem.scene, None) != before
    editor.set({"light.to_world": [1, 0, 0, 2, 0, 1, 0, 3, 0, 0, 1, 4, 0, 0, 0, 1]})
    ray, _ = light.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.4))
    np.testing.assert_allclose(np.array(ray.o).ravel(), [2, 3, 4])
    for key, value, text in (("dimming", -1.0, "at least 0"), ("flux", 0.0, "above 0")):
        with pytest.raises(OptionError, match=text):
            editor.set({f"light.{key}": value})


def test_tilt_factors(folder):
    """They follow the position of the luminaire and the vertical of the scene, in rays and in next event."""
    text = ies(lopsided, np.arange(0.0, 361.0, 15.0), tilt="TILT=INCLUDE\n1\n3\n0 45 90\n1 .5 .2\n")
    (folder / "tilting.ies").write_text(text)

    def described(up: list[float], degrees: float) -> Any:
        to_world = scenes.transform().translate(PLACE).rotate([1, 0, 0], degrees)
        return lamp(folder, "tilting", up=mi.ScalarVector3f(up), to_world=to_world)

    def flux(problem: Any) -> float:
        light = problem.scene.emitters()[0]
        _, weight = light.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.4))
        it = dr.zeros(mi.Interaction3f)
        it.p = mi.Point3f(PLACE) - mi.Vector3f(0.0, 3.0, 1.0)
        ds, direct = light.sample_direction(it, mi.Point2f(0.5))
        own = light.ray_pdf(-ds.d) / dr.square(ds.dist)
        np.testing.assert_allclose(np.array(direct / own), np.array(weight), rtol=1e-5)
        return float(np.array(weight).ravel()[0]) * EFFICACY

    whole = read_photometry(folder / "tilting.ies").flux
    prints = set()
    for up, degrees, factor in (([0, 0, 1], 0.0, 1.0), ([0, 2, 0], -90.0, 1.0), ([0, 0, 1], 45.0, 0.5)):
        problem = load(stage(described(up, degrees)), change=name_elements)
        assert flux(problem) == pytest.approx(factor * whole, rel=1e-5)
        prints.add(problem.fingerprint)
    assert len(prints) == 3
    SceneEditor(problem.scene).set({"light.to_world": [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1]})
    assert flux(problem) == pytest.approx(0.2 * whole, rel=1e-5)
    with pytest.raises(SceneError, match=r"tilting\.ies has factors for a tilted luminaire; give 'up'"):
        load(stage(lamp(folder, "tilting")))
    with pytest.raises(SceneError, match="'up' is a vector of three numbers"):
        load(stage(lamp(folder, "tilting", up=mi.ScalarVector3f(0.0))))


def test_sets_of_lamps(folder):
    """The set of lamps of an EULUMDAT file is a parameter."""
    (folder / "sets.ies").write_text(eulumdat(lambertian, lamps=[(1, 3000.0, 30.0), (1, 1000.0, 12.0)]))
    lights = [mi.load_dict(lamp(folder, "sets", lamp_set=k)).photometry.lamp_flux for k in (0, 1, 2)]
    assert lights == [4000.0, 3000.0, 1000.0]
    with pytest.raises(Exception, match="no set of lamps 3 among 2"):
        mi.load_dict(lamp(folder, "sets", lamp_set=3))


def test_a_dimmed_lamp_is_off(folder):
    lights = LightTable(load(stage(lamp(folder, dimming=0.0), other=scenes._point()["light"])).scene)
    assert sorted(lights.probabilities) == [0.0, 1.0]


def test_the_fingerprint_is_that_of_the_web(folder):
    one, same, other = (load(stage(lamp(folder, name))) for name in ("lopsided", "lopsided", "narrow"))
    assert fingerprint(one.scene, None) == fingerprint(same.scene, None) != fingerprint(other.scene, None)


def test_the_file_is_sent_to_workers(folder, tmp_path):
    scene = stage(lamp(folder))
    scene["light"]["to_world"] = mi.ScalarTransform4f(scene["light"]["to_world"].matrix)
    sent = portable(scene)
    (place,) = sent.files
    copy = tmp_path / "elsewhere" / place
    copy.parent.mkdir(parents=True)
    copy.write_bytes((folder / "lopsided.ies").read_bytes())
    before = load(scene)
    (folder / "lopsided.ies").unlink()
    source, _ = restored(sent, tmp_path / "elsewhere")
    assert fingerprint(load(source).scene, None) == fingerprint(before.scene, None)


def test_a_file_beside_the_scene(folder):
    """A relative name is looked for beside the scene."""
    text = """<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"/></sensor><shape type="sphere"/>
    <emitter type="luminaire" id="lamp"><string name="filename" value="narrow.ies"/>
    <float name="dimming" value="0.5"/><transform name="to_world"><translate y="3"/></transform>
    <rgb name="color" value="1, 0.8, 0.6"/></emitter></scene>"""
    (folder / "scene.xml").write_text(text)
    (light,) = load(folder / "scene.xml").scene.emitters()
    assert light.photometry.flux == read_photometry(folder / "narrow.ies").flux


def test_scenes_of_every_size(folder):
    """A tenth of a millimetre large, far from the origin: the same picture, brighter by the square."""

    def picture(size: float, away: float) -> np.ndarray:
        move = mi.ScalarTransform4d().translate([away, 0, 0])
        grow = move @ mi.ScalarTransform4d().scale(size)
        place = np.array(turned().matrix, np.float64).reshape(4, 4)
        place[:3, 3] = size * place[:3, 3] + [away, 0, 0]
        look = mi.ScalarTransform4d().look_at([away, 1.6 * size, 4.2 * size], [away, 0.4 * size, 0], [0, 1, 0])
        floor = {"type": "rectangle", "to_world": grow @ mi.ScalarTransform4d().rotate([1, 0, 0], -90).scale(2)}
        light = lamp(folder) | {"to_world": mi.ScalarTransform4d(place)}
        sensor = scenes.camera() | {"to_world": look, "near_clip": 0.01 * size, "far_clip": 1e4 * size}
        return run(load({"type": "scene", "sensor": sensor, "floor": floor, "light": light}), "path", 2, 64).mean

    near = picture(1.0, 0.0)
    np.testing.assert_allclose(picture(1e-4, 3.0) * 1e-8, near, rtol=2e-2, atol=1e-3 * near.max())


@pytest.mark.parametrize(
    ("extra", "text"),
    [
        ({"filename": "none.ies"}, "none.ies cannot be read"),
        ({"filename": 3}, "needs a 'filename'"),
        ({"dimming": -1.0}, "'dimming' is .*-1.* at least 0"),
        ({"flux": 0.0}, "'flux' is .*0.* above 0"),
        ({"color": {"type": "checkerboard"}}, "'color' is a texture that varies"),
        ({"color": {"type": "rgb", "value": [0, 0, 0]}}, "'color' has a luminance of 0"),
        ({"intensity": 3.0}, "intensity"),
    ],
)
def test_bad_parameters(extra, text, folder):
    with pytest.raises(Exception, match=text):
        mi.load_dict(lamp(folder) | extra)


def test_a_scale_is_refused(folder):
    stretched = turned() @ scenes.transform().scale([1.0, 2.0, 1.0])
    with pytest.raises(Exception, match="scales or shears, which has no meaning for this emitter"):
        load(stage(lamp(folder, to_world=stretched)))


def test_a_bad_file_is_named_in_one_line(folder):
    (folder / "bad.ies").write_text("IESNA91\nTILT=NONE\n1 1000\n")
    with pytest.raises(Exception, match=r"bad\.ies: lamp data: there are 2 of 3 numbers"):
        load(stage(lamp(folder, "bad")))


def test_no_light_is_an_error():
    with pytest.raises(LightingError, match="all intensities are 0"):
        PhotometricWeb([0, 360], [0, 90], np.zeros((2, 2)))
