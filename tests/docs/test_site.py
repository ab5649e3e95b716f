"""The manual as a site: every page is behind a door, the reference has all public names, and the build is strict."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def conf():
    pytest.importorskip("sphinx")
    pytest.importorskip("myst_parser")
    paths = [str(DOCS), str(ROOT / "tools")]
    sys.path[:0] = paths
    try:
        yield importlib.import_module("conf")
    finally:
        sys.modules.pop("conf", None)
        for path in paths:
            sys.path.remove(path)


def test_every_page_is_behind_one_door(conf):
    found = [page for pages in conf.contents().values() for page in pages]
    assert len(found) == len(set(found))
    pages = {str(path.relative_to(DOCS).with_suffix("")) for path in DOCS.rglob("*.md")}
    pages = {page for page in pages if not page.startswith(("project/", "reference/"))}
    assert pages - set(found) == {"index", *conf.DOORS}


def test_citations_lead_to_the_bibliography(conf, caplog):
    text = "as in [Georgiev 2012, eq. 31; Veach1997] and [a page](x.md)"
    assert conf.cited(text, "../") == (
        r"as in [\[Georgiev 2012, eq. 31; Veach1997\]](../bibliography.md#georgiev2012) and [a page](x.md)"
    )
    for path in DOCS.rglob("*.md"):
        conf.cited(path.read_text("utf-8"), "")
    assert not caplog.records
    conf.cited("[Nobody 1999]", "")
    assert "Nobody1999" in caplog.text


def test_lists_of_arguments_and_citations_of_docstrings(conf):
    lines = ["A sum: of two [Veach 1997].", "", "a: |cos|, and", "    more", "``b``: 2 **named", ""]
    conf.read_docstring(None, "function", "f", None, None, lines)
    assert lines == [
        "A sum: of two :ref:`[Veach 1997] <veach1997>`.",
        *("", r"- a: \|cos\|, and", "  more", r"- ``b``: 2 \**named", ""),
    ]


def test_the_reference_has_the_names_and_commands(conf, tmp_path):
    conf.reference_pages.write_reference(tmp_path)
    assert ".. autoclass:: etendue.transport.Mis\n" in (tmp_path / "python-transport.rst").read_text()
    text = (tmp_path / "python-etendue.rst").read_text()
    assert ".. autofunction:: etendue.render\n" in text and "autoclass:: etendue.core" not in text
    commands = (tmp_path / "commands.rst").read_text()
    assert "\netendue particles trace\n" in commands and "``-o, --output FILE``\n" in commands
    # A constant has its comment, a class that several rooms export one entry.
    assert "683" in (tmp_path / "python-lighting.rst").read_text()
    pages = "".join(path.read_text() for path in tmp_path.glob("python-*.rst"))
    assert pages.count("autoclass:: etendue.surfaces.Patches\n") == 1
    assert "autoclass:: etendue.radiosity.Patches\n" not in pages


def test_tables_older_than_their_records_end_the_build(conf, caplog, monkeypatch):
    monkeypatch.setattr(conf.manual_tables, "stale", lambda: {DOCS / "speed.md": ""})
    monkeypatch.setattr(conf.reference_pages, "write_reference", lambda folder: None)
    monkeypatch.setattr(conf, "MOUNTED", {})
    conf.write_pages(None)
    assert "docs/speed.md: run python tools/manual_tables.py" in caplog.text


@pytest.mark.slow
def test_the_build_is_strict(tmp_path):
    pytest.importorskip("furo")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    assert (tmp_path / "searchindex.js").stat().st_size > 100_000


def test_pages_for_screen_readers(conf):
    table = '<th class="head"><p></p></th><th class="head"><p>lines</p></th>'
    assert conf.accessible(table) == '<td class="head"></td><th class="head"><p>lines</p></th>'
    assert conf.accessible('<pre id="a">x</pre><pre>y</pre>').count('tabindex="0"') == 2
    assert conf.accessible('<div class="table-wrapper a">') == '<div tabindex="0" class="table-wrapper a">'
    signature = '<dl>\n<dd><em class="sig-param">scene</em>,</dd>\n</dl>\n<dl>\n<dt>a</dt>\n<dd>b</dd>\n</dl>'
    found = conf.accessible(signature)
    assert "<dl>\n<dt>a</dt>\n<dd>b</dd>\n</dl>" in found and found.count("<dd>") == 1 and "scene</em>,</div>" in found
    found = '<title>Search - x</title><article role="main" id="a">\n<noscript>'
    assert '<article role="main" id="a"><h1>Search</h1>' in conf.accessible(found)
