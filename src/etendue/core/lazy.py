"""Packages whose names are imported when they are first used: most runs need few of them."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def on_use(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package that declares its names by ``from`` imports in a block
    ``if TYPE_CHECKING:``. The block is read from the source, so that type checkers and Python have the same list.

    A name must not be that of another module of the package, since an import of the module binds it.
    """
    module = sys.modules[package]
    source = Path(str(module.__file__)).read_text("utf-8")
    block = next(node for node in ast.parse(source).body if isinstance(node, ast.If))
    #: The module of each name, and what it is called there; "" for a module itself.
    places: dict[str, tuple[str, str]] = {}
    for node in block.body:
        assert isinstance(node, ast.ImportFrom)
        dots = "." * node.level
        for alias in node.names:
            own = (f"{dots}{node.module}", alias.name) if node.module else (f"{dots}{alias.name}", "")
            places[alias.asname or alias.name] = own

    def find(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module '{package}' has no attribute '{name}'", name=name, obj=module)
        place, inner = places[name]
        found = import_module(place, package)
        value = getattr(found, inner) if inner else found
        setattr(module, name, value)
        return value

    return find, lambda: sorted({*vars(module), *places})
