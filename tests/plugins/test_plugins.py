"""Our methods as Mitsuba integrators: from dictionaries, from XML, in either order of import."""

import os
import re
import subprocess
import sys
import threading

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import passes
from support.media import FLAKES
from support.tables import thinned

from etendue import plugins
from etendue.core import UnsupportedError
from etendue.film import read_exr
from etendue.scene import load

NAMES = [
    "auto",
    "guided",
    "vegas",
    "stratified_path",
    "light",
    "pm",
    "ppm",
    "sppm",
    "bpt",
    "bpm",
    "vcm",
    "pssmlt",
    "mmlt",
]


@pytest.fixture(autouse=True, scope="module")
def registered(variant):
    plugins.register()


def box(integrator, size=24, **film):
    scene = mi.cornell_box()
    scene["integrator"] = {"type": integrator} if isinstance(integrator, str) else integrator
    scene["sensor"]["film"] |= {"width": size, "height": size} | film
    return scene


@pytest.fixture(scope="module")
def reference(registered):
    scene = mi.load_dict(box({"type": "path", "max_depth": 4}))
    return np.array(mi.render(scene, spp=2048))


@pytest.mark.parametrize("name", thinned(NAMES, [name for name in NAMES if name not in ("pssmlt", "mmlt")]))
def test_a_plugin_renders_what_mitsuba_does(name, reference):
    points = {"samples_per_pass": 128} if name == "ppm" else {}  # it keeps the lamp's edge as its points saw it
    scene = mi.load_dict(box({"type": name, "max_depth": 4} | points))
    picture = mi.render(scene, spp=128, seed=7)
    assert isinstance(picture, mi.TensorXf) and picture.shape == reference.shape
    mine, theirs = np.array(picture), reference
    if name == "light":  # light tracing leaves noise where it matters little: compare the walls, not the lamp
        theirs = np.minimum(theirs, 1.0)
        mine = np.minimum(mine, 1.0)
    assert mine.mean() == pytest.approx(theirs.mean(), rel=0.03)
    blocks = (slice(None), slice(None))
    a = mine[blocks].reshape(4, 6, 4, 6, 3).mean((1, 3))
    b = theirs[blocks].reshape(4, 6, 4, 6, 3).mean((1, 3))
    np.testing.assert_allclose(a, b, rtol=0.25, atol=0.03)


@pytest.mark.usefixtures("mitsuba_files")
def test_the_film_holds_the_picture(tmp_path):
    scene = mi.load_dict(box({"type": "bpt", "max_depth": 3}))
    picture = np.array(mi.render(scene, spp=4, seed=1))
    film = scene.sensors()[0].film()
    np.testing.assert_allclose(np.array(film.develop()), picture, rtol=1e-5)
    film.write(str(tmp_path / "film.exr"))
    np.testing.assert_allclose(np.array(mi.Bitmap(str(tmp_path / "film.exr"))), picture, rtol=1e-5)


def test_the_seed_decides():
    scene = mi.load_dict(box({"type": "bpt", "max_depth": 3}))
    first, again, other = (np.array(mi.render(scene, spp=2, seed=s)) for s in (1, 1, 2))
    np.testing.assert_allclose(first, again, rtol=1e-4, atol=1e-6)
    assert np.abs(first - other).mean() > 1e-3


def test_without_spp_the_scenes_own_count_is_used(monkeypatch):
    counted = count_samples(monkeypatch, "bpt")
    scene = box({"type": "bpt", "max_depth": 2})
    scene["sensor"]["sampler"]["sample_count"] = 12
    mi.render(mi.load_dict(scene))
    assert sum(counted) == 12


def test_a_line_says_that_rays_start_too_far_off(caplog):
    scene = box({"type": "bpt", "max_depth": 2}, size=4)
    for part in scene.values():
        if isinstance(part, dict) and "to_world" in part:
            part["to_world"] = mi.ScalarTransform4f().translate([3000, 0, 0]) @ part["to_world"]
    loaded = mi.load_dict(scene)
    for _ in range(2):
        mi.render(loaded, spp=1)
    assert caplog.text.count("the scene: rays start up to 0.27 off surfaces") == 1


def count_samples(monkeypatch, name):
    """Camera paths per pixel of every pass that runs from now on."""
    counted = []
    passes.watch(monkeypatch, name, lambda method, iteration: counted.append(method.samples_per_iteration))
    return counted


def test_contributions_that_are_not_finite_are_reported(monkeypatch, caplog):
    passes.taint(monkeypatch, "bpt", 2.0)
    mi.render(mi.load_dict(box({"type": "bpt", "max_depth": 2, "samples_per_pass": 1}, size=8)), spp=3)
    assert "6 contributions were not finite" in caplog.text


def test_given_samples_per_pass_are_kept(monkeypatch):
    counted = count_samples(monkeypatch, "vcm")
    mi.render(mi.load_dict(box({"type": "vcm", "max_depth": 2, "samples_per_pass": 3})), spp=6)
    assert counted == [3, 3]


def test_pixel_formats_and_crop_windows():
    crop = {"crop_offset_x": 4, "crop_offset_y": 6, "crop_width": 10, "crop_height": 8}
    for pixel_format in ("rgb", "rgba", "luminance", "luminance_alpha", "xyz"):
        scene = mi.load_dict(box({"type": "bpt", "max_depth": 2}, pixel_format=pixel_format, **crop))
        theirs = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 2}), spp=256))
        ours = np.array(mi.render(scene, spp=64))
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours.mean((0, 1)), theirs.mean((0, 1)), rtol=0.05)


def test_alpha_is_coverage():
    scene = box({"type": "light", "max_depth": 2}, pixel_format="rgba", rfilter={"type": "box"})
    del scene["back"], scene["large-box"]
    scene = mi.load_dict(scene)
    ours = np.array(mi.render(scene, spp=1))[..., 3]
    theirs = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 1}), spp=512))[..., 3]
    np.testing.assert_allclose(ours, theirs, atol=0.12)
    assert 0.1 < theirs.mean() < 0.9
    assert ours.mean() == pytest.approx(theirs.mean(), abs=0.01)


def test_first_hit_channels():
    integrator = mi.load_dict({"type": "bpt", "max_depth": 2, "aovs": True})
    picture = np.array(mi.render(mi.load_dict(box("path")), integrator=integrator, spp=8))
    names = integrator.aov_names()
    assert picture.shape == (24, 24, 3 + len(names))
    depth = picture[..., 3 + names.index("depth.T")]
    assert 2.5 < np.median(depth) < 5.0
    assert np.linalg.norm(picture[..., 6:9], axis=-1).max() == pytest.approx(1.0, abs=1e-4)


@pytest.mark.usefixtures("mitsuba_files")
@pytest.mark.parametrize(
    ("settings", "parts"),
    [
        ({"split_layers": True}, r"emission|next_event|connection|splat|merge"),
        ({"components": True}, r"emission|direct|caustic|indirect"),
        ({"pyramid": True, "pyramid_depth": 3, "aovs": True}, r"[sm]\d_t\d|longer"),
    ],
    ids=["split_layers", "components", "pyramid"],
)
def test_layers_are_channels_of_the_film(settings, parts, tmp_path):
    scene = mi.load_dict(box({"type": "vcm", "max_depth": 4} | settings, component_format="float32"))
    integrator, film = scene.integrator(), scene.sensors()[0].film()
    before = integrator.aov_names()
    assert len(before) == (11 if "aovs" in settings else 12 if "components" in settings else 0)
    picture = np.array(mi.render(scene, spp=4, seed=1))
    names = integrator.aov_names()
    assert names[: len(before)] == before
    assert picture.shape[2] == 3 + len(names)
    film.write(str(tmp_path / "film.exr"))
    layers = read_exr(tmp_path / "film.exr").layers
    np.testing.assert_array_equal(layers["image"], picture[..., :3])
    summed = [name for name in layers if re.fullmatch(parts, name)]
    assert len(summed) >= 4
    np.testing.assert_allclose(sum(layers[name] for name in summed), layers["image"], rtol=1e-4, atol=1e-6)
    for name in summed:
        first = 3 + names.index(f"{name}.R")
        np.testing.assert_array_equal(layers[name], picture[..., first : first + 3])
    assert {name for name in layers if name.endswith("_unweighted")} == (
        {f"{name}_unweighted" for name in summed if name != "longer"} if "pyramid" in settings else set()
    )


@pytest.mark.usefixtures("mitsuba_files")
def test_further_radii_are_channels_of_the_film(tmp_path):
    scene = mi.load_dict(box({"type": "vcm", "max_depth": 3, "radii": "0.5,2"}, size=8))
    assert mi.render(scene, spp=1).shape == (8, 8, 9)
    scene.sensors()[0].film().write(str(tmp_path / "film.exr"))
    assert set(read_exr(tmp_path / "film.exr").layers) == {"image", "radius_0.5", "radius_2"}


def test_layers_that_were_not_asked_for_are_not_in_the_film():
    """``light`` keeps its two families apart anyway."""
    assert mi.render(mi.load_dict(box({"type": "light", "max_depth": 2}, size=8)), spp=1).shape == (8, 8, 3)


XML = """<scene version="3.0.0">
<integrator type="vcm"><integer name="max_depth" value="3"/><string name="heuristic" value="power"/>
<float name="radius" value="0.01"/><boolean name="merge_first" value="false"/></integrator>
<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>
<integer name="height" value="6"/></film></sensor><emitter type="constant"/><shape type="sphere"/></scene>"""


def test_xml(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(XML)
    scene = mi.load_file(str(path))
    settings = scene.integrator().settings
    assert (settings.max_depth, settings.heuristic, settings.radius, settings.merge_first) == (3, "power", 0.01, False)
    assert mi.render(scene, spp=1).shape == (6, 8, 3)
    for problem in (load(path), load(scene)):  # the loader reads the same from the file and from the built integrator
        assert (problem.integrator, problem.max_depth) == ("vcm", 3)
        assert problem.integrator_options["heuristic"] == "power"


def test_under_any_key_of_a_dictionary():
    scene = box("path")
    del scene["integrator"]
    problem = load(scene | {"renderer": {"type": "bpt", "max_depth": 5}})
    assert (problem.integrator, problem.max_depth) == ("bpt", 5)


@pytest.mark.parametrize("name", NAMES)
def test_printing(name):
    assert str(mi.load_dict({"type": name, "max_depth": 9})).startswith(f"{name}[\n  max_depth = 9,")


@pytest.mark.parametrize(("name", "own"), [("path", "PathIntegrator"), ("stratified", "StratifiedSampler")])
def test_mitsubas_own_plugins_stay(name, own):
    assert mi.load_dict({"type": name}).class_name() == own


@pytest.mark.parametrize(("wrong", "text"), [
    ({"max_dept": 3}, '"max_dept"'),
    ({"max_depth": -5}, "option 'max_depth' must be at least -1"),
    ({"heuristic": "best"}, "option 'heuristic' must be one of balance, power"),
])  # fmt: skip
def test_wrong_parameters(wrong, text):
    with pytest.raises(RuntimeError, match=text):
        mi.load_dict({"type": "vcm"} | wrong)


def test_unsupported_elements_keep_their_text():
    scene = box("vcm") | {"fog": {"type": "sphere", "interior": FLAKES, "bsdf": {"type": "null"}}}
    loaded = mi.load_dict(scene)
    with pytest.raises(RuntimeError) as caught:
        mi.render(loaded, spp=1)
    assert "a phase function of microflakes" in str(caught.value.__cause__)
    with pytest.raises(UnsupportedError, match="a phase function of microflakes"):
        loaded.integrator().render(loaded, spp=1)


def test_nested_in_another_integrator():
    nested = mi.load_dict({"type": "aov", "aovs": "d:depth", "inner": {"type": "bpt"}})
    with pytest.raises(Exception) as caught:
        mi.render(mi.load_dict(box("path")), integrator=nested, spp=1)
    assert "cannot be nested" in f"{caught.value} {caught.value.__cause__}"


@pytest.mark.parametrize("direction", ["backward", "forward"])
def test_gradients_get_one_clear_error(direction):
    scene = mi.load_dict(box({"type": "vcm", "max_depth": 2}, size=4))
    params = mi.traverse(scene)
    key = "light.emitter.radiance.value"
    dr.enable_grad(params[key])
    params.update()
    picture = mi.render(scene, params=params, spp=1)
    with pytest.raises(UnsupportedError, match=r"'vcm' computes pictures, not gradients.*'prb'"):
        if direction == "backward":
            dr.backward(dr.mean(picture, axis=None))
        else:
            dr.forward(params[key])


def test_cancel_stops_after_the_pass(monkeypatch):
    integrator = mi.load_dict({"type": "bpt", "max_depth": 2, "samples_per_pass": 1})
    scene = mi.load_dict(box("path", size=8))
    done = []

    def interrupt(method, iteration):
        done.append(iteration)
        if iteration == 2:
            thread = threading.Thread(target=integrator.cancel)
            thread.start()
            thread.join()

    passes.watch(monkeypatch, "bpt", interrupt)
    assert mi.render(scene, integrator=integrator, spp=1000).shape == (8, 8, 3)
    assert done == [0, 1, 2] and integrator.should_stop()
    done.clear()
    mi.render(scene, integrator=integrator, spp=2)  # the flag does not stick
    assert done == [0, 1]


def test_timeout(monkeypatch):
    done = []
    passes.watch(monkeypatch, "bpt", lambda method, iteration: done.append(iteration))
    integrator = mi.load_dict({"type": "bpt", "max_depth": 2, "samples_per_pass": 1, "timeout": 0.2})
    assert mi.render(mi.load_dict(box("path", size=8)), integrator=integrator, spp=100000).shape == (8, 8, 3)
    assert 0 < len(done) < 100000


RENDER = """
scene = mi.load_file(sys.argv[1])
print(type(scene.integrator()).__name__, mi.render(scene, spp=1).shape)
print(type(mi.load_dict({"type": "path"})).__name__)
"""
BEFORE = "import etendue, mitsuba as mi; mi.set_variant(V)" + RENDER
AFTER = "import mitsuba as mi; mi.set_variant(V); import etendue" + RENDER
CHANGED = "mi.set_variant('scalar_rgb'); mi.set_variant(V)" + RENDER
OTHER = """
import etendue, mitsuba as mi
for other in sys.argv[1:]:
    mi.set_variant(other)
    try:
        mi.load_dict({"type": "vcm"})
    except Exception as error:
        print(str(error).strip().splitlines()[-1])
"""


def python(code, *arguments):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", f"import sys; V = {mi.variant()!r}; {code}", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@pytest.mark.parametrize(("code", "renders"), [(BEFORE + CHANGED, 2), (AFTER, 1)], ids=["before, changed", "after"])
def test_either_order_of_import(code, renders, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(XML)
    done = python(code, path)
    assert done.stdout.splitlines() == ["VcmIntegrator (6, 8, 3)", "MonteCarloIntegrator"] * renders, done.stderr


def test_other_variants_get_one_clear_error():
    others = ("scalar_rgb", "llvm_ad_spectral_polarized")
    told = python(OTHER, *others).stdout.splitlines()
    assert len(told) == len(others)
    for other, line in zip(others, told, strict=True):
        assert f"BackendError: variant '{other}' is not supported" in line
