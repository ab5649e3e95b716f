"""Denoisers keep constants and edges, read layers by their names, and change nothing else; errors are one line."""

import re

import numpy as np
import pytest
from support.denoisers import needs

from etendue import render
from etendue.cli.main import main
from etendue.core import BackendError, OptionError, Result
from etendue.display import auto_exposure, develop, tonemap, write_png
from etendue.display.denoising import component_names, find_features
from etendue.display.denoising.pictures import colours
from etendue.film import COMPONENTS, read_exr, read_image, variance_of, write_exr

FILTERS = ("gaussian", "bilateral", "guided", "nlm")
WIDTH, HEIGHT = 37, 29


def constant(*values):
    return np.tile(np.array(values, dtype=np.float32), (HEIGHT, WIDTH, 1))


def edge(low, high):
    """A vertical step in the middle."""
    x = np.full((HEIGHT, WIDTH, 3), low, dtype=np.float32)
    x[:, WIDTH // 2 :] = high
    return x


def noisy(picture, deviation, seed=4):
    noise = np.random.default_rng(seed).standard_normal(picture.shape) * deviation
    return (picture * (1.0 + noise)).astype(np.float32), np.square(picture * deviation).astype(np.float32)


def rms(difference):
    return float(np.sqrt(np.mean(np.square(difference))))


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("guides", [False, True])
def test_constant_pictures_stay(name, guides):
    layers = {"image": constant(0.2, 3.0, 0.7), "variance": constant(0.1, 0.1, 0.1)}
    if guides:
        layers |= {"albedo": edge(0.1, 0.9), "normal": edge(-1.0, 1.0)}
    np.testing.assert_allclose(develop(layers, name), layers["image"], rtol=2e-5)


@pytest.mark.parametrize("name", FILTERS)
def test_noise_becomes_less_and_an_edge_stays(name):
    truth = edge(0.2, 2.0)
    image, variance = noisy(truth, 0.2)
    layers = {"image": image, "variance": variance, "albedo": edge(0.1, 0.8), "normal": constant(0.0, 0.0, 1.0)}
    out = develop(layers, name)
    inside = np.s_[:, : WIDTH // 2 - 6]
    assert np.std(out[inside] - truth[inside]) < 0.45 * np.std(image[inside] - truth[inside])
    at = WIDTH // 2
    step = (out[:, at] - out[:, at - 1]).mean() / 1.8
    assert step < 0.3 if name == "gaussian" else step > 0.8


@pytest.mark.parametrize("name", ["bilateral", "guided", "nlm"])
def test_an_edge_of_light_stays_without_features(name):
    truth = edge(0.2, 2.0)
    image, variance = noisy(truth, 0.1)
    out = develop({"image": image, "variance": variance}, name)
    at = WIDTH // 2
    assert (out[:, at] - out[:, at - 1]).mean() > 0.8 * 1.8
    assert np.std(out[:, :12] - 0.2) < 0.5 * np.std(image[:, :12] - 0.2)


def test_guided_filter_reproduces_a_picture_that_is_linear_in_its_guide():
    rng = np.random.default_rng(1)
    albedo, normal = rng.random((2, HEIGHT, WIDTH, 3)).astype(np.float32)
    image = 0.3 + 2.0 * albedo @ rng.random((3, 3)) + normal @ rng.random((3, 3))
    layers = {"image": image.astype(np.float32), "albedo": albedo, "normal": normal}
    assert np.abs(develop(layers, "guided") - image).max() < 0.05 * np.std(image)
    assert np.abs(develop(layers, "gaussian") - image).max() > np.std(image)


def test_gaussian_against_a_convolution():
    image = np.random.default_rng(2).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    x = np.arange(-4, 5)
    weights = np.exp(-0.5 * (x / 2.0) ** 2)

    def along(values):
        total = np.apply_along_axis(lambda line: np.convolve(line, weights, "same"), 1, values)
        return total / np.convolve(np.ones(values.shape[1]), weights, "same")[None, :, None]

    expected = along(along(image).transpose(1, 0, 2)).transpose(1, 0, 2)
    np.testing.assert_allclose(develop({"image": image}, "gaussian", radius=4), expected, rtol=1e-5)


def test_bilateral_against_its_definition():
    """With the noise that two pixels have at least, and features that a pixel on an edge shares with no other."""
    rng = np.random.default_rng(3)
    image, albedo, normal, variance = (rng.random((9, 7, 3)).astype(np.float32) for _ in range(4))
    layers = {"image": image, "albedo": albedo, "normal": normal}
    light = image @ np.array([0.2126, 0.7152, 0.0722])
    guide = np.log1p(image / light.mean()) / 0.6
    feature = np.concatenate([albedo / 0.1, normal / 0.2], axis=2)
    steps = [np.square(np.diff(feature, axis=axis)).sum(axis=2) for axis in (0, 1)]
    sides = [
        (np.pad(d, [(a == 0, 0), (a == 1, 0)]), np.pad(d, [(0, a == 0), (0, a == 1)])) for a, d in enumerate(steps)
    ]
    mixture = np.maximum(*(np.minimum(before, after) for before, after in sides))

    def mean_around(values, y, x):
        return values[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].mean()

    def noise(y, x):
        return 9.0 / 0.36 * mean_around(variance.mean(axis=2), y, x) / (light.mean() + mean_around(light, y, x)) ** 2

    for known in (False, True):
        # Pixels whose variance explains all differences have no fireflies.
        out = develop(layers | ({"variance": variance} if known else {}), "bilateral", radius=2)
        for y, x in ((0, 0), (4, 3), (8, 6), (5, 1)):
            total = weight = 0.0
            for v in range(max(y - 2, 0), min(y + 3, 9)):
                for u in range(max(x - 2, 0), min(x + 3, 7)):
                    near = ((v - y) ** 2 + (u - x) ** 2) / (2.0 * (0.5 * 2) ** 2)
                    accepted = 1.0 + (2.0 * min(noise(v, u), noise(y, x)) if known else 0.0)
                    far = np.square(guide[v, u] - guide[y, x]).sum() / accepted
                    far += np.square(feature[v, u] - feature[y, x]).sum() / (1.0 + mixture[y, x])
                    w = np.exp(-near - 0.5 * far)
                    total, weight = total + w * image[v, u], weight + w
            np.testing.assert_allclose(out[y, x], total / weight, rtol=1e-4)


@pytest.mark.parametrize("name", ["bilateral", "guided"])
@pytest.mark.parametrize("seed", range(2))
def test_strong_noise_is_no_detail_if_the_variance_is_known(name, seed):
    """Noise as large as the light, which without the variance looks like details."""
    truth = edge(0.2, 3.0)
    noise = np.random.default_rng(seed).gamma(1.0, 1.0, truth.shape[:2])[:, :, None]
    layers = {"image": (truth * noise).astype(np.float32), "albedo": edge(0.1, 0.8), "normal": constant(0.0, 0.0, 1.0)}
    blind, out = (develop(layers | more, name) for more in ({}, {"variance": np.square(truth)}))
    assert rms(out / truth - 1.0) < 0.55 * rms(blind / truth - 1.0)  # 0.28 to 0.47 for six seeds


def test_pixels_on_an_edge_of_the_features_do_not_keep_their_noise():
    image, variance = noisy(constant(1.0, 1.0, 1.0), 0.3)
    albedo = edge(0.1, 0.9)
    at = WIDTH // 2
    albedo[:, at] = 0.5
    out = develop(
        {"image": image, "variance": variance, "albedo": albedo, "normal": constant(0.0, 0.0, 1.0)}, "bilateral"
    )
    assert rms(out[:, at] - 1.0) < 0.4 * rms(image[:, at] - 1.0)
    assert np.abs(develop({"image": albedo, "albedo": albedo}, "bilateral")[:, at + 1 :] - 0.9).max() < 1e-3


@pytest.mark.parametrize("name", ["bilateral", "guided", "oidn"])
def test_what_a_mirror_shows_stays(name):
    """Stripes of small contrast in a mirror, which has no features of its own."""
    needs(name)
    stripes = constant(0.5, 0.5, 0.5)
    stripes[:, ::4] = stripes[:, 1::4] = 0.7
    image, variance = noisy(np.tile(stripes, (3, 3, 1)), 0.3)
    mirror, seen = np.tile(constant(0.0, 0.0, 0.0), (3, 3, 1)), np.tile(stripes, (3, 3, 1))
    layers = {"image": image, "variance": variance, "albedo": mirror, "normal": mirror}
    wiped = develop(layers, name)
    kept = develop(layers | {"seen_albedo": seen, "seen_normal": mirror}, name)
    assert rms(kept - seen) < 0.45 * rms(wiped - seen)  # 0.22 to 0.35 for four seeds
    assert rms(kept - seen) < 0.25 * rms(image - seen)  # 0.10 to 0.18


@pytest.mark.parametrize("name", FILTERS)
def test_fireflies_do_not_become_blotches(name):
    image, variance = noisy(constant(1.0, 1.0, 1.0), 0.1)
    image[14, 9], variance[14, 9] = 100.0, 1e4
    layers = {"image": image, "variance": variance, "albedo": constant(0.5, 0.5, 0.5), "normal": constant(0, 0, 1)}
    assert np.abs(develop(layers, name) - 1.0).max() < 0.2  # 0.04 to 0.10 for four seeds


def test_components_are_the_layers_whose_sum_is_the_picture():
    rng = np.random.default_rng(5)
    emission, merge = rng.random((2, HEIGHT, WIDTH, 3)).astype(np.float32)
    layers = {"image": emission + merge, "emission": emission, "merge": merge, "albedo": emission}
    layers["emitted"] = emission  # of first surfaces
    assert component_names(layers) == ("emission", "merge")
    assert component_names(layers | {"other": merge}) == ("image",)
    assert component_names(layers, ["merge"]) == ("merge",)
    apart = develop(layers, "bilateral")
    parts = sum(develop({"image": layers[n], "albedo": layers["albedo"]}, "bilateral") for n in ("emission", "merge"))
    np.testing.assert_allclose(apart, parts, rtol=1e-5)
    np.testing.assert_array_equal(develop(layers, components=["merge"]), merge)


def components(seed=6, deviation=0.3):
    """Layers of a picture by component, with the variance of each."""
    rng = np.random.default_rng(seed)
    parts, layers = {}, {}
    for name in COMPONENTS:
        parts[name], layers[variance_of(name)] = noisy(rng.random((HEIGHT, WIDTH, 3)).astype(np.float32), deviation)
    whole = {"image": sum(parts.values()), "variance": sum(layers.values())}
    return {**parts, **layers, **whole, "albedo": edge(0.1, 0.8), "normal": constant(0, 0, 1)}


@pytest.mark.parametrize(
    "denoise",
    [
        "indirect=gaussian:radius=9:strength=0.5,direct=none",
        {"indirect": "gaussian:radius=9:strength=0.5", "direct": "none"},
        "none,indirect=gaussian:radius=9:strength=0.5",
        " indirect = gaussian : radius = 9 : strength = 0.5 ",
    ],
)
def test_a_filter_for_one_component(denoise):
    """The picture is the sum of what is filtered and of what is not."""
    layers = components()
    smooth = develop({"image": layers["indirect"]}, "gaussian", radius=9, strength=0.5)
    expected = sum(layers[name] for name in ("emission", "direct", "caustic")) + smooth
    np.testing.assert_allclose(develop(layers, denoise), expected, rtol=1e-5)
    np.testing.assert_allclose(develop(layers, denoise, radius=3, strength=2.0), expected, rtol=1e-5)


def test_filters_of_all_kinds_for_components():
    """Those without options of their own have those of all; the variance is that of the component."""
    layers = components()
    guides = {name: layers[name] for name in ("albedo", "normal")}
    alone = {
        name: develop(guides | {"image": layers[part], "variance": layers[variance_of(part)]}, name, radius=3)
        for name, part in (("nlm", "direct"), ("bilateral", "caustic"), ("guided", "indirect"))
    }
    out = develop(layers, "bilateral,direct=nlm,indirect=guided,emission=none", radius=3)
    np.testing.assert_allclose(out, layers["emission"] + sum(alone.values()), rtol=1e-4)
    assert np.abs(out - develop(layers, "bilateral", radius=3)).max() > 0.05


def test_lamps_and_direct_light_are_left_by_filters_that_would_spread_them():
    layers = components()
    only = {name: np.zeros_like(layers["image"]) if name in ("image", *COMPONENTS) else layers[name] for name in layers}
    for name, left in (("gaussian", ("emission", "direct", "caustic")), ("guided", ("emission",)), ("bilateral", ())):
        for part in COMPONENTS:
            shown = only | {part: layers[part], "image": layers[part]}
            changed = np.abs(develop(shown, name) - layers[part]).max() > 1e-6
            assert changed == (part not in left), (name, part)
    # Asked for, they are filtered; and a layer of the same name may be one of another set.
    lamp = only | {"emission": layers["emission"], "image": layers["emission"]}
    assert np.abs(develop(lamp, "emission=gaussian") - layers["emission"]).max() > 0.1
    split = {"image": 2.0 * layers["emission"], "emission": layers["emission"], "merge": layers["emission"]}
    np.testing.assert_allclose(develop(split, "gaussian"), develop({"image": split["image"]}, "gaussian"), rtol=1e-5)


def test_fireflies_stay_in_what_is_not_filtered():
    """Unless a filter for all has left it."""
    layers = components(deviation=0.05)
    layers["direct"][9, 9] += 100.0
    layers["image"][9, 9] += 100.0
    for name in ("variance", "variance.direct"):
        layers[name][9, 9] = 1e4
    assert develop(layers, "direct=none,indirect=gaussian")[9, 9].min() > 90.0
    assert develop(layers, "gaussian,direct=none")[9, 9].min() > 90.0
    assert develop(layers, "gaussian")[9, 9].max() < 10.0


def test_non_local_means_of_components_without_their_variance():
    """They are denoised together, by the variance of the picture; one of them cannot be."""
    layers = {name: layer for name, layer in components().items() if not name.startswith("variance.")}
    whole = {name: layers[name] for name in ("image", "variance")}
    np.testing.assert_allclose(develop(layers, "nlm"), develop(whole, "nlm"), rtol=1e-4)
    with pytest.raises(OptionError, match=r"nlm needs the variance of 'direct'.*--for-denoising"):
        develop(layers, "direct=nlm")


@pytest.mark.parametrize(
    ("denoise", "message"),
    [
        ("indrect=gaussian", "no component 'indrect'; it has: emission, direct, caustic, indirect"),
        ("indirect=gausian", "no denoiser 'gausian'; did you mean 'gaussian'"),
        ("indirect=gaussian:radus=3", "no option 'radus'; did you mean 'radius'"),
        ("indirect=gaussian:radius", "the radius of a filter is a number, not ''"),
        ("indirect=gaussian:radius=wide", "the radius of a filter is a number, not 'wide'"),
        ("indirect=gaussian:radius=2.5", "the radius of a filter is a number, not '2.5'"),
        ("indirect=gaussian:radius=99", "from 1 to 64"),
        ("indirect=gaussian:strength=nan", "above 0"),
        ("indirect=gaussian,indirect=none", "gives 'indirect' two filters"),
        ("gaussian,bilateral", "gives all other components two filters"),
        ("indirect=", "no denoiser ''"),
        ("indirect=gaussian,", "no denoiser ''"),
        ("", "no denoiser ''"),
    ],
)
def test_filters_that_cannot_be(denoise, message):
    with pytest.raises(OptionError, match=re.escape(message)):
        develop(components(), denoise)


def test_a_picture_without_components_says_so():
    with pytest.raises(OptionError, match=r"no component 'indirect'; it has none.*--for-denoising"):
        develop({"image": constant(1, 1, 1)}, "indirect=gaussian")


def test_features_by_usual_and_by_given_names():
    layers = {"image": constant(1, 1, 1), "nn": constant(0, 0, 1), "my": constant(0.5, 0.5, 0.5), "depth": edge(1, 2)}
    assert find_features(layers).names == ("normal",)
    assert find_features(layers, albedo="my").names == ("albedo", "normal")
    with pytest.raises(OptionError, match="no layer 'colour' for --albedo"):
        find_features(layers, albedo="colour")
    layers["one"] = constant(1)
    with pytest.raises(OptionError, match="1 channels, not 3"):
        find_features(layers, normal="one")


def test_pixels_that_are_not_finite_do_not_spread():
    image = constant(0.5, 0.5, 0.5)
    image[3, 4] = np.nan
    image[10, 0, 1] = np.inf
    kept = image.copy()
    np.testing.assert_allclose(develop({"image": image}, "gaussian"), 0.5, rtol=1e-5)
    np.testing.assert_array_equal(image, kept)
    np.testing.assert_array_equal(colours(np.full((2, 2, 3), np.nan, np.float32)), 0.0)


def test_what_cannot_be_done_is_one_error():
    layers = {"image": constant(1, 1, 1)}
    for arguments, message in (
        ({"denoise": "bilatral"}, "did you mean 'bilateral'"),
        ({"denoise": "nlm"}, "needs the variance of 'image'.*--for-denoising"),
        ({"denoise": "gaussian", "radius": 0}, "from 1 to 64"),
        ({"denoise": "gaussian", "radius": 2.5}, "from 1 to 64"),
        ({"denoise": "gaussian", "strength": 0.0}, "above 0"),
        ({"components": ["direct"]}, "no colour layer 'direct'"),
    ):
        with pytest.raises(OptionError, match=message):
            develop(layers, **arguments)
    with pytest.raises(OptionError, match="name some by --layers"):
        develop({"direct": constant(1, 1, 1)}, "gaussian")


def test_open_image_denoise():
    truth = edge(0.2, 2.0)
    image, _ = noisy(np.tile(truth, (3, 3, 1)), 0.3)
    try:
        out = develop({"image": image, "albedo": np.clip(np.tile(truth, (3, 3, 1)), 0, 1)}, "oidn")
    except BackendError as error:
        assert "pip install 'etendue[denoise]'" in str(error)
        pytest.skip("mitsuba-oidn is not installed")
    assert np.std(out[:, :12] - 0.2) < 0.3 * np.std(image[:, :12] - 0.2)


def test_command(tmp_path, capsys):
    image, variance = noisy(edge(0.2, 0.8), 0.3)
    layers = {"image": image, "albedo": edge(0.2, 0.8), "normal": constant(0, 0, 1), "variance": variance}
    source = tmp_path / "a.exr"
    write_exr(source, Result(layers, {"method": "path"}))
    before = source.read_bytes()
    assert main(["develop", str(source)]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "a.png")]
    out = [str(tmp_path / name) for name in ("b.png", "b.exr")]
    assert main(["develop", str(source), "--denoise", "guided", "--tone", "agx", "-o", out[0], "-o", out[1]]) == 0
    smooth = read_exr(out[1])
    assert smooth.metadata["method"] == "path" and smooth.metadata["developed"]["denoise"] == "guided"
    np.testing.assert_array_equal(smooth.layers["image"], develop(layers, "guided"))
    assert read_image(out[0]).std() < read_image(tmp_path / "a.png").std()
    assert source.read_bytes() == before


def test_command_with_a_filter_for_each_component(tmp_path):
    layers = components()
    write_exr(tmp_path / "a.exr", Result(layers, {"method": "path"}))
    asked = "indirect=gaussian:radius=9,direct=none"
    assert main(["develop", str(tmp_path / "a.exr"), "--denoise", asked, "-o", str(tmp_path / "b.exr")]) == 0
    made = read_exr(tmp_path / "b.exr")
    np.testing.assert_allclose(made.image, develop(layers, asked), rtol=1e-6)
    assert made.metadata["developed"]["denoise"] == asked


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({"merge_radius": {"pixels": 1.5}}, True),
        ({"merge_radius": {"pixels": 1.5}, "chosen": "vcm with 1 light paths, 1 connections"}, True),
        ({"merge_radius": {"pixels": 1.5}, "chosen": "bpt with 0.5 light paths, 2 connections"}, False),
        ({}, False),
    ],
)
def test_what_does_not_suit_the_network_is_told(metadata, said, tmp_path, capsys):
    needs("oidn")
    write_exr(tmp_path / "a.exr", Result({"image": constant(1, 1, 1)}, metadata))
    for denoise, told in (("oidn", said), ("image=oidn", said), ("bilateral", False)):
        assert main(["develop", str(tmp_path / "a.exr"), "--denoise", denoise]) == 0
        assert ("blotches of merged photons" in capsys.readouterr().err) == told


def test_a_denoiser_does_not_change_the_exposure(tmp_path):
    """A dark picture with bright noise, which a filter spreads over all pixels."""
    r = np.random.default_rng(1)
    image = np.repeat(np.where(r.random((40, 40, 1)) < 0.1, 4.0, 0.02), 3, axis=2).astype(np.float32)
    write_exr(tmp_path / "a.exr", Result({"image": image}, {}))
    words = ["--denoise", "gaussian", "--radius", "12"]
    assert main(["develop", str(tmp_path / "a.exr"), *words, "-o", str(tmp_path / "b.png")]) == 0
    smooth = develop({"image": image}, "gaussian", radius=12)
    expected = read_back(tmp_path, tonemap(smooth, auto_exposure(image)))
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), expected)
    assert abs(auto_exposure(smooth) - auto_exposure(image)) > 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("a.exr -o a.exr", "is the input"),
        ("a.exr --exposure 1e9", "number of stops from -300 to 300"),
        ("a.exr --exposure nan", "number of stops from -300 to 300"),
        ("a.exr --denoise guided --strength nan", "strength of a denoiser"),
        ("a.exr --tone agz", "did you mean 'agx'"),
        ("a.exr --exposure bright", "number of stops or 'auto'"),
        ("a.exr --denoise nlm", "needs the variance of 'image'"),
        ("a.exr --denoise indirect=gaussian,direct=none", "no component 'indirect'"),
        ("a.exr --denoise image=gaussian:radius=0", "from 1 to 64"),
        ("a.exr --denoise guided --albedo base", "no layer 'base'"),
        ("a.exr --layers direct,indirect", "no colour layer 'direct'"),
        ("a.exr -o a.jpg", "not as 'a.jpg'"),
        ("missing.exr", "there is no picture"),
        ("text.exr", "is not an OpenEXR file"),
    ],
)
def test_command_errors(words, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_exr("a.exr", Result({"image": constant(1, 1, 1)}, {}))
    (tmp_path / "text.exr").write_text("no picture")
    assert main(["develop", *words.split()]) != 0
    text = capsys.readouterr().err.strip()
    assert message in text and len(text.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "text.exr"]


def test_pictures_of_a_run_take_a_tone_and_an_exposure(tmp_path):
    made = render("cornell-box", "path", size=(8, 6), spp=2)
    made.save(tmp_path / "a.png", tone="agx", exposure=1.0)
    expected = read_back(tmp_path, tonemap(made.image, 1.0, "agx"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected)


def read_back(folder, pixels):
    write_png(folder / "expected.png", pixels)
    return read_image(folder / "expected.png")
