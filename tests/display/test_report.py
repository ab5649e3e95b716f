"""A page holds everything it needs, well formed, and asks nobody else for anything."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest

from etendue.core import OptionError, OutputError
from etendue.display import Command, Entry, Failure, render_report, write_report
from etendue.display.report import Layer, number_text, shared_exponent, time_text, value_text
from etendue.film import ALBEDO, NORMAL, SHAPE, relative_mse

VOID = {"meta", "img", "input", "br", "link", "hr"}


class Checker(HTMLParser):
    """Nesting, identifiers, and every attribute that could load something."""

    def __init__(self, text):
        super().__init__()
        self.stack, self.ids, self.tags, self.loads, self.texts = [], [], [], [], []
        self.feed(text)
        self.close()
        assert not self.stack, f"never closed: {self.stack}"

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append((tag, attrs))
        if "id" in attrs:
            self.ids.append(attrs["id"])
        self.loads += [attrs[k] for k in ("src", "href", "srcset", "data", "action", "poster") if k in attrs]
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.stack and self.stack.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data):
        if not self.stack or self.stack[-1] not in ("script", "style"):
            self.texts.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())


@pytest.fixture
def comparison():
    rng = np.random.default_rng(11)
    reference = rng.gamma(0.5, 2.0, (24, 32, 3)).astype(np.float32)
    entries = []
    for name, noise in (("path", 0.5), ("vcm", 0.1)):
        image = (reference * (1 + noise * rng.standard_normal(reference.shape))).clip(0).astype(np.float32)
        entries.append(
            Entry(
                name=name,
                image=image,
                metadata={
                    "method": name,
                    "seed": 4,
                    "seconds": 45.2,
                    "passes": 31,
                    "rays": 123456789,
                    "scene": "a</script><b>.xml",
                    "settings": {"max_depth": 10, "samples_per_pass": 1 if name == "path" else 2},
                    "versions": {"mitsuba": "3.9.1", "llvm": "19.1.7"},
                },
                error_history=[(1.0, 4 * noise), (10.0, noise)],
                layers={"image": image, "emission": image * 0.5, "depth": image[:, :, :1], "normal": image - 1},
                defaults={"max_depth": -1, "samples_per_pass": 1},
                command=f"etendue render 'a b.xml' -m {name}",
            )
        )
    entries[0].image[3, 4] = np.nan
    return entries, reference


def test_page_is_well_formed_and_complete(comparison):
    entries, reference = comparison
    page = render_report(entries, reference, title="A & <B>", subtitle="45 s each", reference_note="path, 9 h & more")
    checker = Checker(page)
    assert len(set(checker.ids)) == len(checker.ids)
    text = checker.text
    for words in (
        "A & <B>",
        "45 s each",
        "path, 9 h & more",
        "45 s · 31 passes · 1 pixel not finite",
        "a</script><b>.xml",
    ):
        assert words in text
    for heading in ("Side by side", "Error against the reference", "Error over time", "Layers", "Settings", "Versions"):
        assert heading in text
    for entry in entries:
        assert number_text(relative_mse(entry.image, reference)) in text
        assert number_text(relative_mse(entry.image, reference, trim=0.001)) in text
    assert "vcm has the smallest error" in text
    # Settings that have their defaults are in the folded table only.
    changed, every = re.findall(r"<h2>Settings</h2>(.*?)<details[^>]*>(.*?)</details>", page, re.DOTALL)[0]
    assert "10 (default -1)" in changed and "2 (default 1)" in changed and "max depth" in every
    rows = re.findall(r'<tr class="differs">.*?</tr>', changed)
    assert len(rows) == 1 and "samples per pass" in rows[0]
    assert "etendue render 'a b.xml' -m vcm" in text and "processor" in text
    # At the end vcm has a fifth of the error of path, which it reaches in a tenth of the time or less.
    assert "after 10 s" in text and "to 0.500" in text and "under 1.0 s (×10)" in text


def test_a_method_that_failed_is_told_in_its_place(comparison):
    entries, reference = comparison
    failures = [Failure("ppm", "out of <memory>")]
    page = render_report(entries, reference, failures=failures, repeat=[Command("etendue compare <x>", "again")])
    text = Checker(page).text
    assert text.count("ppm failed: out of <memory>") == 2 and "etendue compare <x>" in text  # above, and in its place
    assert "<memory>" not in page and "<x>" not in page


@pytest.mark.slow
def test_all_data_of_a_page_stay_below_six_megabytes():
    """Noisy pictures with layers and a pyramid: pixels of layers become blocks, figures smaller."""
    rng = np.random.default_rng(3)
    base = rng.gamma(0.3, 1.0, (360, 480, 3)).astype(np.float32)
    layers = {name: base for name in ("emission", "direct", "indirect", "caustic")}
    layers |= {"depth": base[:, :, :1]} | {f"s{s}_t{t}": base[:240, :240] for s in range(3) for t in range(1, 4)}
    entries = [Entry(name, base, layers=layers) for name in "abc"]
    page = render_report(entries, exposure=0.0)
    assert 2_000_000 < len(page) < 6_000_000
    data = script_data(page)
    blocks = [{layer["block"] for layer in picture["layers"][1:]} for picture in data["pictures"]]
    assert blocks == [blocks[0]] * 3 and min(blocks[0]) > data["pictures"][0]["layers"][0]["block"]
    assert len(data["pictures"][2]["layers"]) == 6 and not data["missing"]


def test_text_from_outside_is_never_markup(comparison):
    """Wherever a page shows it: names, titles, notes, layers, settings, facts, the plot and what the script reads."""
    entries, reference = comparison
    evil = "<b id='x' onload=\"go()\">&amp;</script>"
    for entry in entries:
        entry.name = f"{entry.name} {evil}"
        entry.metadata["settings"] |= {evil: evil}
        entry.metadata |= {evil: [evil]}
        entry.layers[evil] = entry.image
    page = render_report(entries, reference, title=evil, subtitle=evil, reference_note=evil)
    checker = Checker(page)
    assert not any(tag == "b" or "onload" in attrs for tag, attrs in checker.tags)
    assert checker.text.count(evil) > 20 and "&amp;amp;" in page
    assert [p["name"] for p in script_data(page)["pictures"]] == [f"path {evil}", f"vcm {evil}", "reference"]


def test_page_loads_nothing(comparison):
    entries, reference = comparison
    page = render_report(entries, reference)
    checker = Checker(page)
    assert checker.loads and all(value.startswith("data:") for value in checker.loads)
    assert not re.search(r"https?://|url\(|@import|//[a-z0-9.-]+\.[a-z]{2,}/|fetch\(|XMLHttpRequest|import\(", page)
    assert "default-src 'none'" in page


def test_everything_to_see_or_touch_has_a_name(comparison):
    entries, reference = comparison
    page = render_report(entries, reference)
    checker = Checker(page)
    assert all(attrs.get("alt") for tag, attrs in checker.tags if tag == "img")
    assert all(attrs.get("aria-label") for tag, attrs in checker.tags if tag == "svg")
    for tag, attrs in checker.tags:
        if tag in ("input", "select"):
            labelled = re.search(rf'<label[^>]*>(?:(?!</label>).)*data-part="{attrs["data-part"]}"', page, re.DOTALL)
            assert labelled or attrs.get("aria-label"), attrs
    assert ("html", {"lang": "en"}) in checker.tags


def script_data(page):
    return json.loads(re.search(r'id="pictures">(.*?)</script>', page, re.DOTALL).group(1))


def unpacked(layer):
    planes = np.frombuffer(zlib.decompress(base64.b64decode(layer["planes"])), np.uint8)
    planes = planes.reshape(layer["channels"] + 1, layer["height"], layer["width"])
    return np.moveaxis(planes[:-1] * 2.0 ** (planes[-1].astype(float) - 136), 0, 2)


def test_script_data_is_the_radiance(comparison):
    entries, reference = comparison
    data = script_data(render_report(entries, reference, exposure=1.5, curve="filmic"))
    assert [p["name"] for p in data["pictures"]] == ["path", "vcm", "reference"]
    assert (data["width"], data["height"], data["reference"]) == (32, 24, 2)
    assert data["exposure"] == 1.5 and data["curve"] == "filmic"
    error = np.abs(unpacked(data["pictures"][2]["layers"][0]) - reference).max(axis=2)
    assert (error <= reference.max(axis=2) / 255).all()
    layers = {layer["name"]: layer for layer in data["pictures"][1]["layers"]}
    kinds = {name: layer["kind"] for name, layer in layers.items()}
    assert kinds == {"image": "radiance", "emission": "radiance", "depth": "scalar", "normal": "direction"}
    depth = entries[1].layers["depth"]
    np.testing.assert_allclose(unpacked(layers["depth"]), depth, rtol=1 / 255)
    normal = 2.0 * unpacked(layers["normal"]) - 1.0
    np.testing.assert_allclose(normal, entries[1].layers["normal"], atol=np.abs(normal).max() / 64)


@pytest.mark.parametrize(
    ("names", "channels", "kind"), [(ALBEDO, 3, "albedo"), (NORMAL, 3, "direction"), (SHAPE, 1, "label")]
)
def test_layers_of_first_surfaces_are_known_by_all_usual_names(names, channels, kind):
    layer = np.zeros((2, 3, channels), np.float32)
    assert {Layer.of(name, layer).kind for name in names} == {kind}


def test_labels_keep_their_numbers():
    numbers = np.array([[-1, 0, 255, 256], [65535, 65536, 1_000_000, 16_000_000]], np.float32)
    planes = Layer("patch", "label", numbers).planes(6, 1)
    high, middle, low = (planes[:3] * 2.0 ** (planes[3].astype(float) - 136)).astype(int)
    np.testing.assert_array_equal((high * 256 + middle) * 256 + low - 1, numbers.astype(int))


def test_shared_exponent_at_its_limits():
    values = np.array([[[0, 0, 0], [1e-45, 0, 0], [1, 0.5, 0.25], [255.6, 1, 0], [np.nan, -1, np.inf], [3e38, 1, 1]]])
    planes = shared_exponent(values.astype(np.float32))
    value = np.moveaxis(planes[:3] * 2.0 ** (planes[3].astype(float) - 136), 0, 2)[0]
    assert value[0].tolist() == [0, 0, 0] and value[2].tolist() == [1, 0.5, 0.25]
    np.testing.assert_allclose(value[3, 0], 255.6, rtol=1 / 255)
    assert value[4, 0] == value[4, 1] == 0 and value[4, 2] > 1e29
    x = np.geomspace(1e-3, 1e3, 4000).reshape(40, 100, 1)
    for bits in (6, 7, 8):
        planes = shared_exponent(x, bits)
        np.testing.assert_allclose(planes[0] * 2.0 ** (planes[1].astype(float) - 136), x[:, :, 0], rtol=2.0**-bits)
        assert not (planes[0] % 2 ** (8 - bits)).any()


def test_one_picture_without_a_reference(comparison):
    entries, _ = comparison
    text = Checker(render_report(entries[1:])).text
    assert "Error against" not in text and "smallest error" not in text and "Side by side" not in text


def test_wrong_input_is_one_line(comparison, tmp_path):
    entries, reference = comparison
    with pytest.raises(OptionError, match="at least one"):
        render_report([])
    with pytest.raises(OptionError, match="different names"):
        render_report([entries[0], entries[0]])
    with pytest.raises(OptionError, match="reference is 12 x 32 x 3"):
        render_report(entries, reference[:12])
    with pytest.raises(OutputError, match="no folder"):
        write_report(tmp_path / "no" / "page.html", entries, reference)


def test_numbers_for_people():
    assert [number_text(v) for v in (0.00123456, 45.6789, 1234.5, 0.0, float("nan"), 1e-9)] == [
        "0.00123",
        "45.7",
        "1234",
        "0",
        "–",
        "1.00e-09",
    ]
    times = [time_text(v) for v in (0.0, 0.0123, 0.456, 4.24, 45.2, 200, 7500)]
    assert times == ["0.0 s", "12 ms", "0.46 s", "4.2 s", "45 s", "3 min 20 s", "2 h 5 min"]
    assert [value_text(v) for v in (True, None, 12, 1234567, 0.003, [1, 2], 2e6)] == [
        "yes",
        "–",
        "12",
        "1\u202f234\u202f567",
        "0.003",
        "1, 2",
        "2\u202f000\u202f000",
    ]


def test_script_runs_in_a_browser(comparison, tmp_path):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium on this machine")
    entries, reference = comparison
    entries[0].layers["albedo"] = (reference / reference.max()).astype(np.float32)
    write_report(tmp_path / "page.html", entries, reference)
    # The page's own controls, moved as a user would, before the document is printed.
    act = """<script type="module">
    const body = document.body, part = (name) => document.querySelector(`[data-part="${name}"]`);
    const wait = (ms) => new Promise((done) => setTimeout(done, ms));
    const change = (name, value, type = "change") => {
      part(name).value = value;
      part(name).dispatchEvent(new Event(type));
    };
    const press = (key, target = body) => target.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
    const pixel = (canvas) => canvas.getContext("2d").getImageData(9, 7, 1, 1).data.join(" ");
    while (document.documentElement.dataset.ready !== "true") await wait(20);
    change("position", 20, "input");
    change("exposure", 2, "input");
    await wait(50);
    for (const name of ["srgb", "exponential", "agx"]) {
      change("curve", name);
      await wait(50);
      body.dataset[name] = pixel(document.querySelector("figure canvas"));
    }
    body.dataset.clip = part("stage").querySelector("canvas:nth-of-type(2)").style.clipPath;
    for (const name of ["albedo", "normal", "error"]) {
      change("layer", name);
      await wait(50);
      body.dataset[name] = pixel(part("stage").querySelector("canvas:nth-of-type(2)"));
    }
    change("layer", "image");
    press("f");
    press("+");
    await wait(50);
    body.dataset.flipped = part("left-tag").textContent;
    body.dataset.width = part("stage").style.width;
    press("ArrowRight", part("stage"));
    await wait(50);
    body.dataset.values = part("values").textContent;
    document.getElementById("theme").click();
    document.getElementById("theme").click();
    body.dataset.done = "true";
    </script></body>"""
    page = (tmp_path / "page.html").read_text().replace("</body>", act)
    (tmp_path / "page.html").write_text(page)
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    command = [browser, *flags.split(), "--disable-component-update", "--disable-sync", "--virtual-time-budget=9000"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", (tmp_path / "page.html").as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=120).stdout
    known = dict(re.findall(r'data-([a-z]+)="([^"]*)"', dom[dom.rindex("<body") :].split(">")[0]))
    assert 'data-ready="true"' in dom and known["done"] == "true" and 'data-theme="dark"' in dom
    assert re.fullmatch(r"inset\(0(px)? 80% 0(px)? 0(px)?\)", known["clip"])
    from etendue.display import auto_exposure, false_colour, tonemap
    from etendue.film import relative_squared_error

    def shown(name):
        red, green, blue, alpha = (int(v) for v in known[name].split())
        assert alpha == 255
        return np.array([red, green, blue])

    for curve in ("srgb", "exponential", "agx"):
        expected = tonemap(entries[0].image, auto_exposure(reference) + 2.0, curve)[7, 9].astype(int)
        assert np.abs(shown(curve) - expected).max() <= 3
    assert np.abs(shown("albedo") - tonemap(entries[0].layers["albedo"])[7, 9]).max() <= 3
    assert np.abs(shown("normal") - 127.5 * (entries[0].layers["normal"][7, 9].clip(-1, 1) + 1)).max() <= 3
    error = false_colour(relative_squared_error(entries[0].image, reference), 1e-4, 1e2)[7, 9].astype(int)
    assert np.abs(shown("error") - error).max() <= 12  # of values with 8 bits
    assert known["flipped"] == "vcm" and known["width"] == "32px"
    red = float(entries[1].image[12, 17, 0])
    found = re.match(r"pixel 17, 12 +· +vcm: ([\d.e-]+)", known["values"])
    assert found and float(found[1]) == pytest.approx(red, rel=0.02)


def test_a_pyramid_is_a_triangle_of_its_own(comparison):
    entries, reference = comparison
    level = np.float32(0.25)
    names = ("s0_t2", "s0_t3", "s1_t2", "s2_t1", "m2_t2")
    for name in (*names, *(f"{name}_unweighted" for name in names), "longer"):
        entries[1].layers[name] = np.full((24, 32, 3), level)
    entries[1].image[:] = 4 * level
    page = render_report(entries, reference)
    checker = Checker(page)
    assert "Technique pyramid" in checker.text
    tables = re.findall(r'<table class="pyramid">.*?</table>', page, re.DOTALL)
    assert len(tables) == 4  # joined and merged, weighted and unweighted
    for joined, merged in (tables[:2], tables[2:]):
        rows = re.findall(r'<tr><th scope="row">(.*?)</th>(.*?)</tr>', joined, re.DOTALL)
        cells = [re.findall(r"t = (\d+)</strong> · 25 %|<td></td>", row) for _, row in rows]
        assert [name for name, _ in rows] == ["1 edge", "2 edges"]
        assert cells == [["2", "", ""], ["3", "2", "1"]]
        assert re.findall(r"t = (\d+)</strong>|<td></td>", merged[merged.index("<tbody>") :]) == ["", "", "2"]
    layers = page[page.index("<h2>Layers</h2>") :]
    assert "emission" in layers and "s1_t2" not in layers and "longer" not in layers
    assert "Technique pyramid" not in render_report(entries[:1], reference)
