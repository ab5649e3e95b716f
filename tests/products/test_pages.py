"""The page of a solution, and what results show in a notebook: well formed, with their pictures and their numbers."""

from __future__ import annotations

import base64
import io
import math
import re
import sys
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

import etendue
from etendue.conformance import Finding, Report
from etendue.core import InNotebooks, Progress, Result
from etendue.particles import Particles
from etendue.products import FormFactorResult, RadiosityResult, Rendering
from etendue.products.pages.notebook import LiveProgress
from etendue.products.particles import ParticleResult
from etendue.products.patches.page import Making, render_solution_page
from etendue.radiosity import FormFactors, Patches, Solution, box

sparse = pytest.importorskip("scipy.sparse")


@pytest.fixture
def solution() -> Solution:
    """A room with a lamp, solved by its exact form factors for a sphere: F_ij = A_j / A of them all."""
    vertices, faces = box([0, 0, 0], [2, 3, 2.5], 3, inward=True)
    emission = np.zeros((len(faces), 3))
    emission[-5] = 5.0, 4.0, 3.0
    patches = Patches(vertices, faces, reflectance=np.tile([0.7, 0.5, 0.3], (len(faces), 1)), emission=emission)
    patches.shapes, patches.shape_names = np.zeros(len(patches), dtype=np.int64), ("<b>walls</b>",)
    share = patches.areas / patches.areas.sum()
    irradiance = np.tile((share @ emission) / (1.0 - share @ patches.reflectance), (len(patches), 1))
    radiosity = emission + patches.reflectance * irradiance
    radiosity[17] += 0.25  # a residual
    return Solution(patches, radiosity, irradiance, np.zeros(len(patches)), (0.5, 0.05, 0.002))


def pictures(html: str) -> list[np.ndarray]:
    data = re.findall(r'src="data:image/webp;base64,([^"]+)"', html)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB")) for text in data]


def tree(html: str) -> ElementTree.Element:
    """The elements of a card; a tag that is not closed, or a text that is not escaped, is an error."""
    closed = re.sub(r"<(img)([^>]*[^/])>", r"<\1\2/>", html)
    return ElementTree.fromstring(f"<div>{closed}</div>")


def test_the_page_of_a_solution(solution):
    error = 0.01 * solution.irradiance
    error[4] *= 30.0
    history = [(float(2**k), 0.1 / 2 ** (k / 2)) for k in range(6)]
    making = Making({"solver": "jacobi <x>"}, history, "bundles", "etendue radiosity 'a <b>.xml'")
    page = render_solution_page(solution, error, {"source": "a <b>.xml", "bundles": 32}, None, making)
    for words in (
        "Radiosity of a &lt;b&gt;.xml",
        "54 patches of 54 faces",
        "residual over iterations",
        "standard error of irradiance over bundles",
        "jacobi &lt;x&gt;",
        "&lt;b&gt;walls&lt;/b&gt;",
        "etendue radiosity &#39;a &lt;b&gt;.xml&#39;",
    ):
        assert words in page, words
    assert "<b>" not in page and len(page) < 6_000_000
    worst = re.findall(r'<caption>(.*?)</caption>.*?<tbody>\s*<tr><th scope="row">(\d+)</th>', page, re.DOTALL)
    assert worst == [("Largest residuals", "17"), ("Largest standard errors", "4")]
    come = (solution.patches.areas[:, None] * solution.patches.emission).sum(axis=0)
    balance = re.search(r'<th scope="row">emitted</th>(.*?)</tr>', page)
    assert balance and [float(x) for x in re.findall(r">([\d.]+)</td>", balance[1])] == pytest.approx(come, rel=1e-3)
    assert "+100.00 %" in balance[1]
    for picture in pictures(page):
        assert picture.shape == (480, 640, 3) and picture.std() > 10  # walls in the light, black around


def test_a_solution_of_one_band_without_errors_has_a_page(solution):
    p = solution.patches
    one = p.with_properties(reflectance=p.reflectance[:, :1], emission=p.emission[:, :1], sky=0.5)
    grey = Solution(one, solution.radiosity[:, :1], solution.irradiance[:, :1], solution.sky_share + 0.1, ())
    page = render_solution_page(grey, None, {"source": "<patches>"}, None, Making())
    assert "from the sky" in page and "standard error" not in page and "Convergence" not in page


def rendering(**metadata) -> Rendering:
    image = np.linspace(0.0, 1.0, 24 * 32 * 3).reshape(24, 32, 3).astype(np.float32)
    known = {"method": "vcm", "scene": "a <b>.xml", "passes": 3, "samples": 6, "seconds": 1.5, "rays": 3e6, **metadata}
    return Rendering({"image": image, "depth": image[:, :, :1]}, known, lambda: None)


def factors(count: int) -> FormFactors:
    matrix = sparse.csr_array(np.full((count, count), 1.0 / count))
    return FormFactors(matrix, 0.1 * matrix, np.zeros(count), np.ones(count), np.full(count, 9))


def particles() -> Particles:
    rng = np.random.default_rng(2)
    n, zeros = 500, np.zeros(500)
    position, power = rng.uniform([0, 0, 0], [2, 1, 0.1], (n, 3)), np.ones((n, 3))
    return Particles(position, power, power, zeros, zeros, np.zeros((n, 2)), zeros, zeros + 2)


def test_results_show_themselves(solution):
    result = rendering()
    common = {"patches": solution.patches, "stopped_by": "samples", "elapsed": 2.0}
    solved = RadiosityResult(**common, solution=solution, irradiance_error=0.1 * solution.irradiance, bundles=64)
    in_boxes = RadiosityResult(**common, solution=solution, passes=16)
    parts = SimpleNamespace(tree=SimpleNamespace(total=123))
    of_copies = RadiosityResult(patches=None, solution=None, stopped_by="error", elapsed=2.0, passes=3, parts=parts)
    shown: list[tuple[InNotebooks, int, list[str]]] = [
        (result, 1, ["vcm, 32 × 24", "a <b>.xml", "2 Mrays/s", "depth"]),
        (Result(result.layers, {}), 1, ["picture, 32 × 24"]),
        (Result({}, {}), 0, ["Result"]),
        (solution, 2, ["54", "0.002", "imbalance of power"]),
        (solved, 2, ["64", "10 %", "number of bundles"]),
        (in_boxes, 2, ["16", "number of passes"]),
        (of_copies, 0, ["123", "3", "error"]),
        (solution.patches, 2, ["54", "emitters"]),
        (factors(54), 1, ["2916", "1 to 1"]),
        (FormFactorResult(**common, factors=factors(54), bundles=64), 1, ["64"]),
        (particles(), 1, ["500", "up to 2"]),
        (Particles.empty(), 0, ["0"]),
    ]
    for thing, count, words in shown:
        html = thing._repr_html_()
        text = " ".join(tree(html).itertext())
        assert all(word in text for word in words), (words, text)
        found = pictures(html)
        assert len(found) == count and len(html) < 400_000
        assert all(np.ptp(picture) > 30 for picture in found)
        assert "<script" not in html and "http" not in html


def test_the_title_of_a_card_comes_first_and_its_pictures_stay_beside_each_other(solution):
    card = tree(solution._repr_html_())[0]
    first, rest = card[0], card[1]
    assert first.findtext("strong") == "Radiosity" and len(list(card.iter("img"))) == 2
    pictures, table = rest
    assert [child.tag for child in pictures] == ["figure", "figure"] and "wrap" not in pictures.get("style")
    assert table.tag == "table"


def test_what_a_tracing_has_counted_is_there_once():
    counters = {"paths": 200.0, "particles": 500.0, "rays": 3e6, "nonfinite": 0.0, "seconds": 0.903135}
    result = ParticleResult(particles(), None, counters, 2, "samples", 0.95)
    rows = [tuple(row.itertext()) for row in tree(result._repr_html_()).iter("tr")]
    facts = {name: text for name, text in rows}
    assert len(facts) == len(rows) and facts["time"] == "0.95 s" and facts["speed"] == "3.32 Mrays/s"
    assert (facts["particles"], facts["light paths"]) == ("500", "200")
    assert not {"seconds", "rays", "nonfinite", "paths", "contributions not finite"} & set(facts)
    counters["nonfinite"] = 3.0
    assert "contributions not finite" in result._repr_html_()


@pytest.mark.parametrize("error", [0.00131, 0.00043, 1.9e-4, 2.5e-5, 0.25])
def test_an_error_is_written_the_same_in_progress_and_results(error):
    (text,) = [part for part in Progress(error=error).pace if part.startswith("error ")]
    cells = [cell.text for cell in tree(rendering(error=error)._repr_html_()).iter("td")]
    assert text.removeprefix("error ") in cells and "e" not in text.removeprefix("error ")


def test_a_check_shows_what_failed_and_how_much_passed():
    rows = [
        Finding("material '<b>_wall' of type 'x_y'", "energy", "fail", 1.25, 1.0, "reflects more <than> it gets"),
        Finding("material '<b>_wall' of type 'x_y'", "range", "pass", 0.0, 0.0, "fine"),
        Finding("sensor", "sampler", "warn", math.nan, 0.0, "known"),
        *(Finding("scene", f"test {k}", "pass", 0.0, 0.0, "fine") for k in range(3)),
    ]
    html = Report("a <b>.xml", tuple(rows), 1.5)._repr_html_()
    texts = [" ".join(row.itertext()).split("\n")[0] for row in tree(html).iter("tr")]
    assert texts == [
        "failed: material '<b>_wall' of type 'x_y', energy reflects more <than> it gets (1.25)",
        "warning: sensor, sampler known",
        "material '<b>_wall' of type 'x_y' 1 of 2 passed",
        "sensor 0 of 1 passed",
        "scene 3 of 3 passed",
    ]
    text = " ".join(tree(html).itertext())
    assert "Check of a <b>.xml" in text and "4 tests passed, 1 warn, 1 failed, in 1.5 s" in text


def test_a_session_shows_how_far_it_is(monkeypatch):
    session = object.__new__(etendue.Session)
    monkeypatch.setattr(etendue.Session, "prepared", True)
    monkeypatch.setattr(etendue.Session, "running", True)
    monkeypatch.setattr(etendue.Session, "image", None)
    monkeypatch.setattr(etendue.Session, "progress", Progress())
    assert "first pass" in session._repr_html_()
    monkeypatch.setattr(etendue.Session, "image", rendering().image)
    monkeypatch.setattr(etendue.Session, "progress", Progress(passes=4, samples=8, elapsed=2.0, fraction=0.25))
    html = session._repr_html_()
    assert "pass 4, 8 spp" in html and tree(html).find(".//progress").get("value") == "0.2500"
    assert len(pictures(html)) == 1
    monkeypatch.setattr(etendue.Session, "running", False)
    monkeypatch.setattr(etendue.Session, "result", rendering())
    assert "vcm, 32 × 24" in session._repr_html_()

    def fails(self):
        raise etendue.SceneError("no <lamp>")

    monkeypatch.setattr(etendue.Session, "result", property(fails))
    assert "failed: no &lt;lamp&gt;" in session._repr_html_()


class Handle:
    def __init__(self, shown: list[str]) -> None:
        self.shown = shown

    def update(self, html: str) -> None:
        self.shown.append(html)


@pytest.fixture
def notebook(monkeypatch) -> list[str]:
    """As much of IPython as a run needs to know that it is in a notebook; returns what is shown."""
    shown: list[str] = []

    def display(html: str, display_id: bool) -> Handle:
        assert display_id
        shown.append(html)
        return Handle(shown)

    python, inner = ModuleType("IPython"), ModuleType("IPython.display")
    python.get_ipython = lambda: SimpleNamespace(kernel=object())
    inner.display, inner.HTML = display, str
    monkeypatch.setitem(sys.modules, "IPython", python)
    monkeypatch.setitem(sys.modules, "IPython.display", inner)
    return shown


def test_a_run_in_a_notebook_shows_its_progress(notebook):
    seen = []
    options = {"spp": 3, "samples_per_pass": 1, "size": (8, 8), "max_depth": 2}
    etendue.render("cornell-box", "path", callback=lambda update: seen.append(update.progress.passes), **options)
    assert seen == [1, 2, 3]
    assert "starting" in notebook[0] and "pass 1, 1 spp" in notebook[1]
    assert tree(notebook[1]).find(".//progress").get("value") == "0.3333" and "ETA" in notebook[1]
    assert "finishing: pass 3, 3 spp" in notebook[-2] and "done: pass 3, 3 spp" in notebook[-1]
    assert all("ETA" not in html and "<progress" not in html for html in notebook[-2:])


@pytest.mark.parametrize(
    ("error", "kind", "how"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt, "interrupted"),
        (ValueError("no"), etendue.engine.RunError, "failed"),
    ],
)
def test_a_run_that_does_not_reach_its_end_says_so(notebook, error, kind, how):
    def stop(update):
        if update.progress.passes == 2:
            raise error

    options = {"spp": 300, "samples_per_pass": 1, "size": (8, 8), "max_depth": 2}
    with pytest.raises(kind) as caught:
        etendue.render("cornell-box", "path", callback=stop, **options)
    if how == "interrupted":  # a notebook prints the frames of the library only, not those of the pass
        assert caught.traceback[-1].name == "run_job" and "wait=False" in caught.value.__notes__[0]
    assert f"{how}: pass 2, 2 spp" in notebook[-1]
    assert "ETA" not in notebook[-1] and "<progress" not in notebook[-1]


def test_a_run_without_a_pass_says_so(notebook, monkeypatch):
    def fails(*_, **__):
        raise etendue.OptionError("no")

    monkeypatch.setattr(etendue.engine.Runner, "run", fails)
    with pytest.raises(etendue.OptionError):
        etendue.render("cornell-box", "path", spp=1, size=(8, 8))
    assert "failed before the first pass was done" in notebook[-1]


def test_progress_is_in_the_words_of_the_work(notebook, solution):
    result = etendue.trace_particles("cornell-box", paths=2000)
    assert "2000 paths, " in notebook[-1] and "spp" not in notebook[-1] and "pass " not in notebook[-1]
    assert "number of paths" in result._repr_html_()
    result = etendue.compute_form_factors(solution.patches, bundles=16)
    assert "16 bundles, " in notebook[-1] and "segments/s" in notebook[-1] and "spp" not in notebook[-1]
    assert "number of bundles" in result._repr_html_()


def test_elsewhere_nothing_is_shown(notebook, monkeypatch):
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: SimpleNamespace())  # IPython in a terminal
    assert LiveProgress.in_notebook("a") is None
    monkeypatch.delitem(sys.modules, "IPython")
    assert LiveProgress.in_notebook("a") is None and notebook == []
