"""HTML pages from templates in ``assets``. Values are escaped; style and script are part of the page.

A page needs no server: its modules are data of an import map, under the names by which they import each other, such as
``etendue/tone.js``. A server gives the same names to the files.
"""

from __future__ import annotations

import base64
import json
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


def page(template: str, **values: Any) -> str:
    """The text of a page.

    In templates, ``asset(name)`` is the unescaped text of a file in ``assets``, ``modules(names)`` an import map that
    contains these modules.
    """
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("etendue.display", "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"asset": _asset, "modules": _modules}
    return environment


def asset_text(name: str) -> str:
    """The text of a file in ``assets``."""
    return files(__package__).joinpath("assets", name).read_text(encoding="utf-8")


def _asset(name: str) -> Markup:
    return Markup(asset_text(name))


def _modules(*names: str) -> Markup:
    imports = {
        f"etendue/{name}": "data:text/javascript;base64," + base64.b64encode(asset_text(name).encode()).decode()
        for name in names
    }
    return Markup(json.dumps({"imports": imports}))
