"""Run files: scene, method, budget and outputs in TOML. The manual is ``docs/run-files.md``.

Every path is relative to the file. Reading checks names, types and ranges; what needs the scene is checked when it is
loaded, before the first pass.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from etendue.core import OptionError, OutputError, SceneError, is_number, is_whole, suggest
from etendue.engine import Budget, Job, Task, check_period, check_save_times
from etendue.film import check_writable
from etendue.products import Picture, choose_method, limits_of, picture_task
from etendue.scene import BundledScene, Camera, SceneSource, bundled_scene

from ..options import parse_memory


@dataclass(frozen=True)
class _Kind:
    """The type of a value: its test, and its name in messages."""

    test: Callable[[Any], bool]
    words: str


def _is_list(value: Any, test: Callable[[Any], bool], length: int | None = None) -> bool:
    return isinstance(value, list) and len(value) == (length or len(value)) and all(map(test, value))


_TEXT = _Kind(lambda v: isinstance(v, str) and bool(v.strip()), "a text in quotes")
_SWITCH = _Kind(lambda v: isinstance(v, bool), "true or false")
_NUMBER = _Kind(is_number, "a number")
_COUNT = _Kind(lambda v: is_whole(v) and v >= 1, "a whole number of at least 1")
_INDEX = _Kind(lambda v: is_whole(v) and v >= 0, "a whole number of at least 0")
_TIME = _Kind(lambda v: is_number(v) and v >= 0, "seconds, a number of at least 0")
_TIMES = _Kind(lambda v: _is_list(v, is_number), "a list of seconds, as [20, 60, 300]")
_POINT = _Kind(lambda v: _is_list(v, is_number, 3), "three numbers, as [0, 1, 4]")
_SIZE = _Kind(lambda v: _is_list(v, _COUNT.test, 2), "width and height in pixels, as [640, 480]")
_MEMORY = _Kind(lambda v: _COUNT.test(v) or isinstance(v, str), 'a size as "512M" or "2G", or a number of bytes')
_SHARE = _Kind(lambda v: is_number(v) and 0 <= v < 1, "a share of the pixels from 0 to below 1")
_LAYERS = _Kind(lambda v: v in ("together", "separate"), '"together" or "separate"')
_PLAIN = _Kind(lambda v: isinstance(v, (str, int, float)), "a text, a number, true or false")
_TABLE = _Kind(lambda v: isinstance(v, dict), "a table")
_OPEN = _Kind(
    lambda v: isinstance(v, dict) and all(map(_PLAIN.test, v.values())), "a table of texts, numbers, true or false"
)

#: Keys of the tables; the keys of "" are at the head of the file.
TABLES: Mapping[str, Mapping[str, _Kind]] = {
    "": {"seed": _INDEX, "variant": _TEXT, "threads": _COUNT, "low_priority": _SWITCH, "memory": _MEMORY},
    "scene": {"file": _TEXT, "bundled": _TEXT, "sensor": _INDEX, "size": _SIZE, "parameters": _OPEN},
    "camera": {"origin": _POINT, "target": _POINT, "up": _POINT, "fov": _NUMBER, "fov_axis": _TEXT},
    "method": {"name": _TEXT, "settings": _OPEN},
    "budget": {"seconds": _NUMBER, "spp": _COUNT, "samples": _COUNT, "error": _NUMBER},
    "autosave": {"times": _TIMES, "exit_after_last": _SWITCH, "every": _TIME},
    "output": {
        "folder": _TEXT,
        "name": _TEXT,
        "layers": _LAYERS,
        "png": _SWITCH,
        "checkpoint": _SWITCH,
        "page": _SWITCH,
    },
    "reference": {"file": _TEXT, "trim": _SHARE},
}


#: A run file with all keys.
EXAMPLE = """\
# Only [scene] is required; paths are relative to this file.
seed = 1
threads = 4
low_priority = false
memory = "2G"              # limit on what the method stores
# variant = "llvm_ad_rgb"

[scene]
bundled = "cornell-glass"  # or file = "scene.xml"
sensor = 0
size = [256, 256]
# parameters = { res = 256 }   the $variables of an XML file

# [camera]                 in place of the scene's
# origin = [0, 1, 4]
# target = [0, 0.4, 0]
# up = [0, 1, 0]
# fov = 45                 along fov_axis = "x" or "y"

[method]
name = "vcm"

[method.settings]
max_depth = 12

[budget]                   # the first limit that is reached ends the run
seconds = 60
# spp = 1000
# error = 0.05             relative standard error of the pixels

[autosave]
times = [5, 20, 60]        # seconds
every = 60                 # seconds between periodic saves, 0 for none
# exit_after_last = true

[output]
folder = "results"
name = "glass"
layers = "together"        # or "separate"
png = true
checkpoint = true
page = true

# [reference]
# file = "reference.exr"
# trim = 0.001
"""


@dataclass(frozen=True)
class RunFile:
    """A run file, read and checked."""

    path: Path
    scene: Path | BundledScene
    sensor: int
    size: tuple[int, int] | None
    parameters: Mapping[str, str]
    camera: Camera | None
    method: str | None
    settings: Mapping[str, Any]
    budget: Budget
    seed: int
    variant: str | None
    threads: int | None
    low_priority: bool
    memory: int | None
    save_at: tuple[float, ...]  #: autosaves: seconds since the scene was loaded
    save_every: float | None
    folder: Path
    name: str
    layers: Literal["together", "separate"]
    png: bool
    checkpoint: bool
    page: bool
    reference: Path | None
    trim: float

    @classmethod
    def read(cls, path: Path) -> RunFile:
        """Read and check a file. Raises :class:`OptionError`, :class:`SceneError` or :class:`OutputError`; each names
        the file, the table and a remedy."""
        tables = _tables(path)
        head, scene, method, budget = (tables[name] for name in ("", "scene", "method", "budget"))
        autosave, output, reference = (tables[name] for name in ("autosave", "output", "reference"))
        with _within(path, "scene"):
            source = _scene(path, scene)
        with _within(path, "camera"):
            camera = Camera(**tables["camera"]) if tables["camera"] else None
        with _within(path, "autosave"):
            save_at, save_every = _autosaves(autosave)
        with _within(path, "budget"):
            limits = _budget(budget, save_at, bool(autosave.get("exit_after_last")))
        with _within(path, "memory"):
            memory = head.get("memory")
            memory = parse_memory(memory) if isinstance(memory, str) else memory
        with _within(path, "output"):
            folder = path.parent / output.get("folder", ".")
            name = _file_name(output.get("name", path.stem))
            _check_folder(folder)
        with _within(path, "reference"):
            picture = _reference(path, reference)
        return cls(
            path=path,
            scene=source,
            sensor=scene.get("sensor", 0),
            size=tuple(scene["size"]) if "size" in scene else None,
            parameters={k: _text(v) for k, v in scene.get("parameters", {}).items()},
            camera=camera,
            method=method.get("name"),
            settings=method.get("settings", {}),
            budget=limits,
            seed=head.get("seed", 0),
            variant=head.get("variant"),
            threads=head.get("threads"),
            low_priority=head.get("low_priority", False),
            memory=memory,
            save_at=save_at,
            save_every=save_every,
            folder=folder,
            name=name,
            layers=output.get("layers", "together"),
            png=output.get("png", False),
            checkpoint=output.get("checkpoint", True),
            page=output.get("page", True),
            reference=picture,
            trim=reference.get("trim", 0.001),
        )

    @property
    def checkpoint_path(self) -> Path:
        """Path of the checkpoint, if the run writes one."""
        return self.folder / f"{self.name}.checkpoint"

    @property
    def page_path(self) -> Path:
        """Path of the page, if the run writes one."""
        return self.folder / f"{self.name}.html"

    def task(self, product: Picture, tell: Callable[[str], object]) -> Task:
        """The task of the engine. A Mitsuba variant must be set. ``tell`` as for :func:`choose_method`."""
        with _within(self.path, "method"):
            chosen = choose_method(self.method, self.scene, self.parameters, tell)
            source = SceneSource(self.scene, self.size, self.sensor, self.parameters, self.memory, self.camera)
            return picture_task(source, chosen, product, self.settings, self.seed, self.budget)

    def describe(self, job: Job) -> str:
        """``vcm on cornell-box, 64x64, seconds 300, saves at 20 60 300 s, into results``."""
        width, height = job.problem.size
        parts = [f"{job.method.name} on {self.scene}", f"{width}x{height}"]
        parts += [f"{name} {limit:g}" for name, limit in limits_of(job.budget).items()]
        if self.save_at:
            parts.append(f"saves at {' '.join(f'{t:g}' for t in self.save_at)} s")
        return ", ".join([*parts, f"into {self.folder}"])


@contextmanager
def _within(path: Path, table: str) -> Iterator[None]:
    """Add file and table to errors."""
    try:
        yield
    except (OptionError, SceneError, OutputError) as error:
        where = f"[{table}]" if table in TABLES else f"'{table}'"
        raise type(error)(f"{path}: {where}: {error}") from error


def _tables(path: Path) -> dict[str, dict[str, Any]]:
    """The tables of a file by name, every one of :data:`TABLES`, with known keys and values of the right kind."""
    try:
        with open(path, "rb") as file:
            values = tomllib.load(file)
    except FileNotFoundError:
        raise OptionError(f"there is no run file '{path}'; check the name") from None
    except OSError as error:
        raise OptionError(f"cannot read the run file '{path}': {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise OptionError(f"{path} is not valid TOML: {error}; correct it there") from error
    head = {key: value for key, value in values.items() if key not in TABLES}
    tables = {"": head} | {name: values.get(name, {}) for name in TABLES if name}
    for name, table in tables.items():
        where = f"{path}: [{name}]" if name else str(path)
        if not _TABLE.test(table):
            raise OptionError(f"{path}: '{name}' is a table: write its keys under [{name}]")
        for key, value in table.items():
            kind = TABLES[name].get(key)
            if kind is None:
                raise OptionError(f"{where} has no key '{key}'; {_nearest(key, name)}")
            if not kind.test(value):
                raise OptionError(f"{where} '{key}' is {kind.words}, not {value!r}")
    return tables


def _nearest(key: str, table: str) -> str:
    """Suggestion for an unknown key."""
    homes = [f"[{name}]" if name else "the head of the file" for name, keys in TABLES.items() if key in keys]
    known = [*TABLES[table], *(name for name in TABLES if name and not table)]
    hint = suggest(key, known, "it has")
    return f"it belongs to {' or '.join(homes)}" if homes and "did you mean" not in hint else hint


def _scene(path: Path, table: Mapping[str, Any]) -> Path | BundledScene:
    if ("file" in table) == ("bundled" in table):
        raise OptionError("name one scene: file, a Mitsuba XML file, or bundled, one of `etendue scenes`")
    if "bundled" in table:
        if "parameters" in table:
            raise OptionError("parameters replace $variables of an XML file; a bundled scene has none")
        return bundled_scene(table["bundled"])
    file = path.parent / table["file"]
    if not file.is_file():
        raise SceneError(f"there is no scene file '{file}'; paths are relative to the run file")
    return file


def _autosaves(table: Mapping[str, Any]) -> tuple[tuple[float, ...], float | None]:
    times = tuple(table.get("times", ()))
    check_save_times(times)
    if table.get("exit_after_last") and not times:
        raise OptionError("exit_after_last needs times; give some, or a [budget] instead")
    every = table.get("every", 60.0) or None
    check_period(every)
    return times, every


def _budget(table: Mapping[str, Any], save_at: tuple[float, ...], exit_after_last: bool) -> Budget:
    seconds, last = table.get("seconds"), save_at[-1] if save_at else 0.0
    if exit_after_last:
        seconds = last if seconds is None else seconds
    error = table.get("error")
    if error is not None and is_number(error) and error > 0:
        error = error**2  # the engine works with variances
    budget = Budget(seconds, table.get("spp", table.get("samples")), None, error)
    if save_at and not budget:
        raise OptionError("autosaves need a budget, or exit_after_last = true in [autosave]")
    if budget.seconds is not None and budget.seconds < last:
        raise OptionError(f"the run ends after {budget.seconds:g} s, before its last autosave at {last:g} s")
    return Budget(last, budget.samples, None, budget.error) if exit_after_last else budget


def _file_name(name: str) -> str:
    if any(c in name for c in '/\\:*?"<>|\0') or name in (".", ".."):
        raise OptionError(f"name is the beginning of file names, not '{name}'; put the path into folder")
    return name


def _check_folder(folder: Path) -> None:
    """Raise :class:`OutputError` if ``folder`` cannot be created or written to; creates nothing."""
    place = folder
    while not place.exists() and place != place.parent:
        place = place.parent
    check_writable(place / "etendue-check")


def _reference(path: Path, table: Mapping[str, Any]) -> Path | None:
    if not table:
        return None
    if "file" not in table:
        raise OptionError("file is missing: the picture to measure the error against")
    file = path.parent / table["file"]
    if not file.is_file():
        raise SceneError(f"there is no picture '{file}'; paths are relative to the run file")
    return file


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
