"""Write the settings and papers of each method into its page of the manual, from the declarations in the code.

python tools/method_tables.py            rewrite docs/methods/*.md between the markers
python tools/method_tables.py --check    exit with 1 if a page is not current
"""

from __future__ import annotations

import re
import sys
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

from etendue import methods
from etendue.core import bibliography

PAGES = Path(__file__).resolve().parent.parent / "docs" / "methods"
#: An accent of BibTeX on a letter, in the forms ``\\v{r}``, ``{\\'a}`` and the like.
_ACCENT = re.compile(r"\\([`'^\"~vc])\s*\{?(\w)\}?")
_COMBINING = {"`": "\u0300", "'": "\u0301", "^": "\u0302", "~": "\u0303", '"': "\u0308", "v": "\u030c", "c": "\u0327"}
_FIELD = re.compile(r"^\s*(\w+)\s*=\s*[{\"](.+?)[}\"],?\s*$", re.MULTILINE)


def settings_table(method: type[Any]) -> str:
    """The settings of a method as a Markdown table."""
    rows = ["| setting | type | default | meaning |", "|---|---|---|---|"]
    for name, kind, default, text in method.Settings.describe():
        shown = str(default).lower() if isinstance(default, bool) else f"{default}"
        cells = (f"`{name}`", kind.replace("|", ", "), f"`{shown}`", text)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def plain(text: str) -> str:
    """BibTeX text without its accents' commands and braces."""
    text = _ACCENT.sub(lambda m: unicodedata.normalize("NFC", m[2] + _COMBINING[m[1]]), text)
    return " ".join(re.sub(r"[{}]", "", text).replace("--", "–").split())


def papers(method: type[Any]) -> str:
    """The papers of a method as a Markdown list."""
    rows = []
    for key in method.citations:
        found = {name: plain(value) for name, value in _FIELD.findall(bibliography()[key])}
        title, authors = found["title"], found["author"].replace(" and ", ", ")
        link = f"[{title}](https://doi.org/{found['doi']})" if "doi" in found else title
        rows.append(f"- {authors}. {link}. {found['year']}. `{key}`")
    return "\n".join(rows)


#: What is written between ``<!-- NAME -->`` and ``<!-- /NAME -->``.
_PARTS: dict[str, Callable[[type[Any]], str]] = {"settings": settings_table, "papers": papers}


def current(text: str, method: type[Any]) -> str:
    """``text`` of a page with its generated parts as they should be. Raises ``ValueError`` if a marker is missing."""
    for name, write in _PARTS.items():
        head, start, rest = text.partition(f"<!-- {name} -->\n")
        _, end, tail = rest.partition(f"<!-- /{name} -->")
        if not start or not end:
            raise ValueError(f"the page of '{method.name}' has no marker for its {name}")
        text = f"{head}{start}{write(method)}\n{end}{tail}"
    return text


def main(arguments: list[str]) -> int:
    """Rewrite or check every page; the exit status."""
    stale = []
    for name, method in methods.table().items():
        page = PAGES / f"{name}.md"
        text = page.read_text("utf-8")
        wanted = current(text, method)
        if wanted != text:
            stale.append(page.name)
            if "--check" not in arguments:
                page.write_text(wanted, "utf-8")
    if stale:
        print(f"{'not current' if '--check' in arguments else 'rewritten'}: {', '.join(stale)}")
    return int(bool(stale) and "--check" in arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
