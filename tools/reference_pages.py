"""Pages of the manual that are made from the code: the Python interface of each room, and the command line.

Called by ``docs/conf.py`` before Sphinx reads its sources.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import typer
from sphinx.errors import PycodeError
from sphinx.pycode import ModuleAnalyzer

#: The rooms whose names are public, in the order of the reference, and what they are for.
ROOMS = {
    "etendue": "render, measure and solve",
    "etendue.radiosity": "form factors, radiosity, heat exchange",
    "etendue.surfaces": "patches, meshes, lightmaps, maps",
    "etendue.lighting": "skies, sun, weather, luminaires, meters, glare",
    "etendue.particles": "hits of light paths in files",
    "etendue.points": "point sets, sequences, random numbers",
    "etendue.integration": "functions and integrators over the hypercube",
    "etendue.density": "density estimation, neighbours, kernels",
    "etendue.methods": "methods of pictures and their settings",
    "etendue.transport": "walks, connections, merging, guiding",
    "etendue.scene": "scenes, materials, lights, sensors",
    "etendue.film": "filters, pictures, EXR, error measures",
    "etendue.display": "tone curves, denoising, pages",
    "etendue.engine": "runs, budgets, checkpoints",
    "etendue.products": "tasks and results",
    "etendue.distributed": "processes and machines",
    "etendue.conformance": "tests of the components of scenes",
    "etendue.formats": "files of other programs",
    "etendue.core": "settings, measurements, errors, variants",
}
#: The pages of rooms in the folder of the reference.
PAGES = {room: f"python-{room.rpartition('.')[2]}" for room in ROOMS}


def write_reference(folder: Path) -> None:
    """Write ``python-*.rst`` and ``commands.rst`` with an index into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    for room, name in PAGES.items():
        write(folder / f"{name}.rst", "\n".join(room_page(importlib.import_module(room))))
    write(folder / "commands.rst", "\n".join(command_page()))
    rows = [f"   {name}" for name in PAGES.values()]
    lines = [*heading("Python interface", "="), "", ".. toctree::", "   :maxdepth: 1", "", *rows, ""]
    write(folder / "python.rst", "\n".join(lines))


def write(path: Path, text: str) -> None:
    """Write a page that has changed, so that Sphinx reads no other one again."""
    if not path.exists() or path.read_text("utf-8") != text:
        path.write_text(text, "utf-8")


def heading(text: str, line: str) -> list[str]:
    """A heading of reStructuredText."""
    return [text, line * len(text)]


def room_page(module: ModuleType) -> list[str]:
    """The reference of a room: its names that no room before it defines."""
    name = module.__name__
    lines = [*heading(f"{name}: {ROOMS[name]}", "="), "", f".. py:module:: {name}", ""]
    lines += [*(inspect.getdoc(module) or "").split("\n"), ""]
    kinds: dict[str, list[str]] = {"Functions": [], "Classes": [], "Errors": [], "Constants": []}
    for public, value, owner in public_names(module):
        if owner != name:
            continue
        if inspect.isclass(value):
            kind = "Errors" if issubclass(value, BaseException) else "Classes"
            kinds[kind] += [f".. autoclass:: {name}.{public}", "   :members:", "   :show-inheritance:", ""]
        elif callable(value):
            kinds["Functions"] += [f".. autofunction:: {name}.{public}", ""]
        else:
            kinds["Constants"] += constant(name, public, value)
    for title, entries in kinds.items():
        if entries:
            lines += [*heading(title, "-"), "", *entries]
    return lines


def public_names(module: ModuleType) -> Iterator[tuple[str, Any, str]]:
    """(name, value, the first room of :data:`ROOMS` that defines it) of what a room exports."""
    for name in sorted(dir(module), key=str.lower):
        value = getattr(module, name)
        if name.startswith("_") or inspect.ismodule(value) or name == "TYPE_CHECKING":
            continue
        origin = getattr(value, "__module__", None) or defined_in(module, name)
        if origin.split(".")[0] == "etendue":
            yield name, value, room_of(origin, module.__name__)


def room_of(origin: str, room: str) -> str:
    """The room of a module; the package itself for the modules directly in it."""
    own = ".".join(origin.split(".")[:2])
    return own if own in ROOMS else "etendue" if room == "etendue" else own


def defined_in(module: ModuleType, name: str) -> str:
    """The module whose ``name`` is a commented constant, of those loaded that have the same value."""
    value = getattr(module, name)
    for other in sorted(m for m in sys.modules if m.startswith(module.__name__ + ".")):
        if vars(sys.modules[other]).get(name) is value and comment(other, name):
            return other
    return module.__name__


def comment(module: str, name: str) -> list[str]:
    """The comment ``#:`` of a constant."""
    try:
        return ModuleAnalyzer.for_module(module).find_attr_docs().get(("", name), [])
    except PycodeError:
        return []


def constant(room: str, name: str, value: Any) -> list[str]:
    """A constant with its comment."""
    text = comment(defined_in(sys.modules[room], name), name)
    shown = repr(value)
    lines = [f".. py:data:: {room}.{name}"]
    lines += [f"   :value: {shown}"] if len(shown) < 60 and " at 0x" not in shown else []
    return [*lines, "", *(f"   {line}" for line in text), ""]


def command_page() -> list[str]:
    """Every command with its arguments and options, from the command line itself."""
    from etendue.cli.main import app

    lines = [*heading("Commands", "="), "", "What ``etendue COMMAND -h`` prints.", ""]
    root = typer.main.get_command(app)
    for name, command in commands(root, "etendue"):
        lines += [*heading(name, "-"), "", *inspect.cleandoc(command.help or "").split("\n"), ""]
        context = click.Context(command, info_name=name)
        usage = " ".join([name, *command.collect_usage_pieces(context)])
        lines += ["::", "", f"    {usage}", ""]
        for parameter in command.params:
            if record := parameter.get_help_record(context):
                lines += [f"``{record[0]}``", f"    {record[1] or ' '}", ""]
    return lines


def commands(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    """(whole name, command) of all commands in a group."""
    for word in group.list_commands(click.Context(group)):
        command = group.get_command(click.Context(group), word)
        if command.hidden:
            continue
        if hasattr(command, "list_commands"):
            yield from commands(command, f"{name} {word}")
        else:
            yield f"{name} {word}", command
