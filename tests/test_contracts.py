"""The house rules of the source: rooms in order, no type of a variant at import."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import etendue
import etendue.methods
from etendue.core import bibliography

SOURCE = Path(etendue.__file__).parent
ROOMS = (
    *(
        "core",
        "points",
        "integration",
        "density",
        "film",
        "lighting",
        "scene",
        "formats",
        "surfaces",
        "transport",
        "conformance",
    ),
    *("particles", "methods", "radiosity", "engine", "distributed", "display", "products", "viewer", "plugins", "cli"),
)
#: Siblings: one stands after the other in the list, but may not import it.
FORBIDDEN = {
    "radiosity": {"methods"},
    "engine": {"methods", "radiosity"},
    "distributed": {"methods", "radiosity"},
    "display": {"methods", "radiosity", "engine"},
}
#: Packages inside a room whose names are public beside those of the room, so that the room itself stays light.
PUBLIC = ("products.patches", "products.particles", "products.pages")
FILES = sorted(SOURCE.rglob("*.py"))
#: An import by a string: a module, or the name of something in one, as "etendue.scene.source:open_scene".
BY_STRING = re.compile(r"etendue((?:\.\w+)+)(?::([\w.]+))?")
#: A citation in a docstring or comment: [Georgiev 2012, eq. 31] stands for the key Georgiev2012; several take a ";".
CITATION = re.compile(r"\[([A-Z][A-Za-z]+ (?:19|20)\d\d\w*\b[^\]\n]*)\]")


def cited_keys(text: str) -> list[str]:
    """The keys that the citations in ``text`` stand for."""
    parts = [part for found in CITATION.findall(text) for part in found.split(";")]
    return [m[1] + m[2] for part in parts if (m := re.match(r"\s*([A-Z][A-Za-z]+) ((?:19|20)\d\d\w*)", part))]


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(name: str) -> str | None:
    """The room of a module; ``None`` for the package itself and the modules directly in it, the face of the house."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ROOMS else None


@cache
def nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text("utf-8"))))


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and absolute name of everything that a file imports, at any level, also by a string; ``*`` stands for all of
    a module that is imported itself."""
    package = module_name(path) if path.name == "__init__.py" else module_name(path).rpartition(".")[0]
    modules = {id(value) for node in nodes(path) for value in arguments_of_import_module(node)}
    for node in nodes(path):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, whole(alias.name)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = importlib.util.resolve_name("." * node.level + base, package)
            for alias in node.names:
                # `from etendue.core import backend` may name a module or something inside the package.
                yield node.lineno, f"{base}.{alias.name}"
        elif isinstance(node, ast.Constant) and (found := BY_STRING.fullmatch(str(node.value))):
            module = f"etendue{found[1]}"
            if found[2] or id(node) in modules:
                yield node.lineno, f"{module}.{found[2]}" if found[2] else whole(module)


def whole(module: str) -> str:
    return module if module == "etendue" else f"{module}.*"


def arguments_of_import_module(node: ast.AST) -> Iterator[ast.AST]:
    """What a call of ``import_module`` or ``__import__`` is given."""
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in ("import_module", "__import__"):
            yield from node.args


def faults_of_order(path: Path) -> list[str]:
    """What a file imports that its room may not see."""
    faults = []
    own = room_of(module_name(path))
    for line, name in imports(path):
        if name.split(".")[0] != "etendue":
            continue
        other = room_of(name)
        where = f"{path.relative_to(SOURCE)}:{line} imports {name}"
        if own is None or other == own:
            continue  # the face may look into every room
        if other is None:
            if own != "cli" and name not in ("etendue", "etendue.__version__"):
                faults.append(f"{where}, but a room knows nothing of what stands above all rooms")
            continue
        if ROOMS.index(other) > ROOMS.index(own) or other in FORBIDDEN.get(own, ()):
            faults.append(f"{where}, but room {own} may not import room {other}")
        inner = name.split(".")[2:]
        if ".".join(name.split(".")[1:3]) in PUBLIC:
            inner = inner[1:]
        if len(inner) > 1 or (inner and inner[0].startswith("_")):
            faults.append(f"{where}, a private module: import it from etendue.{other}")
    return faults


def test_rooms_import_only_rooms_before_them():
    faults = [fault for path in FILES for fault in faults_of_order(path)]
    assert not faults, "\n".join(faults)


def test_every_package_is_a_room():
    assert {p.parent.name for p in SOURCE.glob("*/__init__.py")} <= set(ROOMS)


@pytest.mark.parametrize(
    ("room", "text", "wrong"),
    [
        ("film", "from etendue.methods import table", "film may not import room methods"),
        ("film", "def f():\n    import etendue.engine", "film may not import room engine"),
        ("methods", "from ..radiosity import solve", "methods may not import room radiosity"),
        ("radiosity", "from etendue import methods", "radiosity may not import room methods"),
        ("products", "from etendue.display import tonemap", None),
        ("cli", "from etendue.products.patches import SolutionRun", None),
        ("cli", "from etendue.products.patches.base import PatchProduct", "private module"),
        ("viewer", "from etendue.products.pictures import Picture", "private module"),
        ("distributed", "from etendue.products import Picture", "distributed may not import room products"),
        ("scene", 'm = import_module("etendue.methods")', "scene may not import room methods"),
        ("scene", 'm = importlib.import_module("etendue.core")', None),
        ("scene", 'm = importlib.import_module("etendue.core.settings")', "private module"),
        ("scene", "import etendue.core.settings", "private module"),
        ("distributed", 'MAKE = "etendue.radiosity:LineCasting"', "distributed may not import room radiosity"),
        ("engine", 'MAKE = "etendue.core.settings:Settings"', "private module"),
        ("engine", 'HINT = "etendue.radiosity"', None),
        ("radiosity", "from etendue import engine", "radiosity may not import room engine"),
        ("engine", "from etendue.methods import get", "engine may not import room methods"),
        ("display", "from ..methods.path import Path", "display may not import room methods"),
        ("scene", "from etendue.core.settings import Settings", "private module"),
        ("scene", "from ..core.settings import Settings", "private module"),
        ("core", "from etendue import render", "above all rooms"),
        ("scene", "from etendue.core import Settings", None),
        ("scene", "from .lights import Table", None),
        ("cli", "from etendue import render", None),
    ],
)
def test_the_check_itself_finds_faults(room, text, wrong, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "SOURCE", tmp_path / "etendue")
    path = tmp_path / "etendue" / room / "example.py"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    found = faults_of_order(path)
    assert (found == []) if wrong is None else (len(found) >= 1 and wrong in found[0])


def run_without_variant(code: str, *arguments: str) -> str:
    """Output of ``code`` in a fresh interpreter, where no variant has been set."""
    run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_calls_visit_one_scene():
    """These visit the objects of all scenes, also emitters whose shape is gone; ``scene.Members`` does not."""
    calls = ("dispatch", "sample_emitter_direction", "pdf_emitter_direction", "eval_emitter_direction")
    attributes = (node for path in FILES for node in nodes(path) if isinstance(node, ast.Attribute))
    assert not [node.attr for node in attributes if node.attr in calls]


def test_every_module_is_imported_without_a_variant():
    """The variant is the user's choice, made late; a type looked up at import would fail here, or set one."""
    names = [module_name(path) for path in FILES if path.name != "__main__.py"]
    code = f"import importlib\nfor n in {names!r}: importlib.import_module(n)\nimport mitsuba\nprint(mitsuba.variant())"
    assert run_without_variant(code).strip() == "None"


def test_names_that_are_imported_when_they_are_used():
    """They are there, and none is that of another module, which an import of the module would put in its place."""
    code = """
import importlib, pkgutil, sys, types
for room in sys.argv[1:]:
    package = importlib.import_module(room)
    modules = {m.name for m in pkgutil.iter_modules(package.__path__)}
    for name in [n for n in dir(package) if not n.startswith("_")]:
        own = isinstance(getattr(package, name), types.ModuleType)
        assert own or name not in modules, f"{room}.{name} is the name of a module"
        assert own or getattr(package, name) is not None, name
    try:
        package.nothing
    except AttributeError as error:
        assert "nothing" in str(error)
    else:
        raise AssertionError(room)
print("all")
"""
    rooms = [module_name(p) for p in FILES if "on_use(__name__)" in p.read_text("utf-8") and p.name == "__init__.py"]
    assert len(rooms) > 10
    assert run_without_variant(code, *rooms).strip() == "all"


def test_the_package_imports_little():
    """``import etendue`` comes before everything that a user does."""
    code = "import sys, etendue\nprint(*(name for name in sys.modules if name.startswith('etendue.')))"
    rooms = {name.split(".")[1] for name in run_without_variant(code).split()}
    assert rooms <= {"core", "plugins", "methods", "scene"}, rooms


def test_llvm_is_looked_for_before_drjit_is_imported():
    """Whichever room a script imports first: each in a process of its own, which ends where drjit is imported."""
    rooms = sorted({p.parent.name for p in SOURCE.glob("*/__init__.py")})
    code = """
import importlib, numpy, os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "drjit":
            backend = sys.modules.get("etendue.core.backend")
            os._exit(0 if getattr(backend, "VARIANTS", None) else 1)
sys.meta_path.insert(0, Watch())
if os.fork() == 0:
    import drjit
    os._exit(2)
assert os.waitstatus_to_exitcode(os.wait()[1]) == 1, "the watch sleeps"
for room in sys.argv[1:]:
    child = os.fork()
    if child == 0:
        importlib.import_module("etendue." + room)
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status == 0, f"{room} imports drjit too early: {status}"
"""
    assert len(rooms) > 10
    run_without_variant(code, *rooms)


def method_table():
    return sorted(etendue.methods.table().items())


def test_every_method_is_documented_and_cites_what_exists():
    known = bibliography()
    for name, method in method_table():
        assert method.name == name
        assert (method.__doc__ or "").strip(), f"method {name} has no manual page"
        assert method.citations, f"method {name} cites nothing"
        assert [key for key in method.citations if key not in known] == []


def test_every_setting_is_documented():
    for name, method in method_table():
        rows = method.Settings.describe()
        assert rows, f"method {name} has no settings"
        for option, _, default, text in rows:
            assert text.strip(), f"{name}: option {option} has no documentation"
            assert getattr(method.Settings(), option) == default, f"{name}: option {option} does not keep its default"


def test_every_citation_in_the_source_is_in_the_bibliography():
    known = bibliography()
    unknown = {
        f"{path.relative_to(SOURCE)}: {key}"
        for path in FILES
        for key in cited_keys(path.read_text("utf-8"))
        if key not in known
    }
    assert not unknown, "not in core/bibliography.bib:\n" + "\n".join(sorted(unknown))


def test_how_citations_are_read():
    text = "[Georgiev 2012TR, eq. 31; Kajiya 1986] and [Veach 1997], not [0, 1), list[int], [Section 2]"
    assert cited_keys(text) == ["Georgiev2012TR", "Kajiya1986", "Veach1997"]
