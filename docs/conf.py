"""Sphinx's settings of the manual: Markdown pages by MyST, the reference from the docstrings.

``make docs`` builds it, strictly: a link that leads nowhere, a citation without an entry in the bibliography, a table
that is older than its record and a docstring that does not parse end the build.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT / "tools"))

import manual_tables  # noqa: E402
import reference_pages  # noqa: E402

import etendue  # noqa: E402
from etendue.core import bibliography  # noqa: E402

logger = logging.getLogger(__name__)

project = "étendue"
author = "the developers of étendue"
release = etendue.__version__
copyright = author

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton"]
exclude_patterns = ["_build"]
root_doc = "index"
nitpicky = False

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
#: The shell's examples are indented blocks.
highlight_language = "default"
suppress_warnings = ["misc.highlighting_failure"]

add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike")}
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100

html_theme = "furo"
html_title = "étendue"
html_static_path: list[str] = []
html_theme_options = {"source_repository": "", "navigation_with_keys": True}
html_show_sphinx = False
html_copy_source = False

#: The pages that a reader chooses first; what they link to, in this order, is the contents of the manual.
DOORS = ("rendering", "heat", "lighting", "research", "reference", "evidence")
#: Pages from other folders of the repository, and their names in the manual.
MOUNTED = {"CONTRIBUTING.md": "project/contributing", "CHANGELOG.md": "project/changelog"} | {
    str(path.relative_to(ROOT)): f"project/{'-'.join(path.relative_to(ROOT).with_suffix('').parts).lower()}"
    for path in sorted((ROOT / "benchmarks").rglob("*.md"))
}
#: What the reference is made from, which a reader of the repository sees in its place.
REFERENCE = {f"src/{room.replace('.', '/')}/__init__.py": name for room, name in reference_pages.PAGES.items()} | {
    "src/etendue/__init__.py": "python",
    "src/etendue/cli/main.py": "commands",
}
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s:#]+)(#[^)\s]*)?\)")
#: [Georgiev 2012, eq. 31] or [Georgiev2012] stands for the key Georgiev2012; several take a ";".
_CITATION = re.compile(r"(?<!\])\[([A-Z]\w+ ?(?:19|20)\d\d\w*(?:[,;][^\]\n]*)?)\](?![(\[])")
_KEY = re.compile(r"\s*([A-Z]\w+?) ?((?:19|20)\d\d\w*)")


def mounted(file: Path) -> Path | None:
    """Where the manual has a file of the repository; ``None`` if it has not."""
    if file == ROOT / "README.md":
        return DOCS / "index.md"
    name = str(file.relative_to(ROOT)) if file.is_relative_to(ROOT) else ""
    if name in REFERENCE:
        return DOCS / "reference" / f"{REFERENCE[name]}.rst"
    return DOCS / f"{MOUNTED[name]}.md" if name in MOUNTED else file if file.is_relative_to(DOCS) else None


def rebased(text: str, source: Path, page: Path) -> str:
    """``text`` of the file ``source`` as that of ``page``: links lead to pages of the manual, or are plain text."""

    def link(match: re.Match[str]) -> str:
        image, words, path, anchor = match.groups()
        there = mounted((source.parent / path).resolve())
        if there is None:
            return words
        return f"{image}[{words}]({os.path.relpath(there, page.parent)}{anchor or ''})"

    return _LINK.sub(link, text)


def contents() -> dict[str, list[str]]:
    """The pages that each door links to and no door before it; the reference comes first, for it has all methods."""
    claimed, found = {"index", *DOORS, *(f"reference/{name}" for name in reference_pages.PAGES.values())}, {}
    for door in sorted(DOORS, key=lambda door: door != "reference"):
        text = (DOCS / f"{door}.md").read_text("utf-8")
        linked = [mounted((DOCS / match[3]).resolve()) for match in _LINK.finditer(text)]
        pages = [page.relative_to(DOCS) for page in linked if page and page.suffix in (".md", ".rst")]
        found[door] = [name for page in dict.fromkeys(pages) if (name := str(page.with_suffix(""))) not in claimed]
        claimed.update(found[door])
    return found


def cited(text: str, up: str) -> str:
    """``text`` with its citations as links to the bibliography; warns of unknown keys."""
    known = set(bibliography())

    def link(match: re.Match[str]) -> str:
        keys = [f"{m[1]}{m[2]}" for part in match[1].split(";") if (m := _KEY.match(part))]
        if unknown := [key for key in keys if key not in known]:
            logger.warning("the bibliography has no %s", ", ".join(unknown))
        return f"[\\[{match[1]}\\]]({up}bibliography.md#{keys[0].lower()})"

    return _CITATION.sub(link, text)


def write_pages(app: Sphinx) -> None:
    """Write what is made from the code and from other folders; warns of generated parts that are not current."""
    for page in manual_tables.stale():
        logger.warning("%s: run python tools/manual_tables.py", page.relative_to(ROOT))
    reference_pages.write_reference(DOCS / "reference")
    for source, name in MOUNTED.items():
        page = DOCS / f"{name}.md"
        page.parent.mkdir(exist_ok=True)
        reference_pages.write(page, rebased((ROOT / source).read_text("utf-8"), ROOT / source, page))


def read_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Finish the text of a page: links that leave the folder, citations, and the contents of a door."""
    path = Path(app.env.doc2path(name))
    if path.suffix != ".md":
        return
    text = rebased(source[0], path, path)
    if name == "bibliography":
        text = re.sub(r"^- (.*`(\w+)`)$", r"(\2)=\n- \1", text, flags=re.MULTILINE).replace("`\n(", "`\n\n(")
        text = re.sub(r"^\((\w+)\)=$", lambda m: f"({m[1].lower()})=", text, flags=re.MULTILINE)
    else:
        text = cited(text, "../" * name.count("/"))
    below = list(DOORS) if name == "index" else CONTENTS.get(name, [])
    if below:
        text += "\n\n" + "\n".join(["```{toctree}", ":hidden:", "", *(f"/{page}" for page in below), "```"]) + "\n"
    source[0] = text


#: A line of a list of arguments or attributes in a docstring, ``name: text``, and a literal.
_ENTRY = re.compile(r"(?:``[^`]+``(?:, )?)+: \S|[^.:]{1,70}: \S")
_LITERAL = re.compile(r"(``.+?``|:\w+:`[^`]+`)")


def read_docstring(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Finish a docstring: citations, bars and stars that are no markup, and lists of arguments."""
    first, *others = map(escaped, "\n".join(lines).split("\n\n"))
    lines[:] = "\n\n".join([first, *map(listed, others)]).split("\n")


def escaped(text: str) -> str:
    """``text`` without markup but literals and roles; citations are links."""

    def link(match: re.Match[str]) -> str:
        key = _KEY.match(match[1])
        assert key is not None
        return f":ref:`[{match[1]}] <{(key[1] + key[2]).lower()}>`"

    parts = _LITERAL.split(text)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"([|]|\*\*)", r"\\\1", _CITATION.sub(link, parts[k]))
    return "".join(parts)


def listed(text: str) -> str:
    """A paragraph of lines ``name: text``, with what continues them indented, as a list; a heading may precede it."""
    rows, head = text.split("\n"), []
    if len(rows) > 2 and re.fullmatch("-{3,}", rows[1]):
        head, rows = [f".. rubric:: {rows[0]}", ""], rows[2:]
    starts = [row for row in rows if row and not row.startswith(" ")]
    if rows[0] in starts and all(map(_ENTRY.match, starts)):
        rows = [f"- {row}" if row in starts else f"  {row.strip()}".rstrip() for row in rows]
    return "\n".join([*head, *rows])


CONTENTS = contents()


#: What the theme and Sphinx write that readers of screens and keyboards stumble over, and what is written instead.
_ACCESSIBLE = (
    (re.compile(r"<pre>"), '<pre tabindex="0">'),
    (re.compile(r"<pre (?=id=)"), '<pre tabindex="0" '),
    (re.compile(r'<div (?=class="table-wrapper)'), '<div tabindex="0" '),
    (re.compile(r'<aside class="sidebar-drawer">'), '<aside class="sidebar-drawer" aria-label="Pages">'),
    (re.compile(r'<aside class="toc-drawer'), '<aside aria-label="On this page" class="toc-drawer'),
    (re.compile(r'<th class="head"><p></p></th>'), '<td class="head"></td>'),
    (re.compile(r'(?s)(<title>Search - .*?<article role="main"[^>]*>)(?!\s*<h1>)'), r"\1<h1>Search</h1>"),
    (re.compile(r"<dl>\n((?:<dd>.*</dd>\n)+)</dl>"), r"<div>\n\1</div>"),
)


def accessible(html: str) -> str:
    """A page without what axe-core finds: regions that scroll without a focus, landmarks of one name, empty heads of
    columns, and parameters as definitions of nothing."""
    for pattern, text in _ACCESSIBLE:
        html = pattern.sub(text, html)
    lone = re.compile(r"(?<=\n)<dd>(<em class=\"sig-param\">.*)</dd>(?=\n)")
    return lone.sub(r'<div style="margin-left: 2rem">\1</div>', html)


def finish_pages(app: Sphinx, error: Exception | None) -> None:
    """Rewrite the pages that were built."""
    if error is None and app.builder.name == "html":
        for page in Path(app.outdir).rglob("*.html"):
            text = page.read_text("utf-8")
            if (mended := accessible(text)) != text:
                page.write_text(mended, "utf-8")


def setup(app: Sphinx) -> None:
    """Register what finishes the pages."""
    app.connect("builder-inited", write_pages)
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", read_docstring)
    app.connect("build-finished", finish_pages)
