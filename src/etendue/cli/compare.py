"""Several methods on one scene for the same budget: pictures, and one page that compares them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from etendue import display, film, methods
from etendue.api import Outputs, Update, start_job
from etendue.core import OptionError, OutputError
from etendue.engine import Budget, Job, Task, check_writable
from etendue.scene import bundled

from .console import note, say
from .rendering import follow, summary

Image = NDArray[np.float32]

#: Ratio of the times of two points of the error plot.
_HISTORY_RATIO = 1.25
_PAGE = "index.html"


@dataclass
class Comparison:
    """What to compare, and where the outcome goes. :meth:`check` finds what is wrong before anything is rendered."""

    scene: str
    methods: list[str]
    output: Path
    budget: Budget
    settings: Mapping[str, str] = field(default_factory=dict)
    reference: Path | None = None
    reference_note: str = ""
    title: str = ""
    subtitle: str = ""
    seed: int = 0
    size: tuple[int, int] | None = None
    sensor: int = 0
    parameters: Mapping[str, str] | None = None
    memory: int | None = None
    _tasks: list[Task] = field(default_factory=list, init=False)
    _reference: Image | None = field(default=None, init=False)

    def check(self) -> None:
        """Raise the errors of options, reference and output folder; makes the folder."""
        if len(set(self.methods)) < len(self.methods):
            raise OptionError(f"each method once, not {', '.join(self.methods)}")
        settings = self._settings_by_method()
        self._tasks = [
            Task(
                scene=self.scene,
                method=methods.get(name),
                settings=settings[name],
                seed=self.seed,
                budget=self.budget,
                size=self.size,
                sensor=self.sensor,
                parameters=self.parameters,
                memory=self.memory,
            )
            for name in self.methods
        ]
        if self.reference is not None:
            self._reference = film.read_image(self.reference)
        try:
            self.output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"cannot make the folder '{self.output}': {error.strerror}; choose another place"
            ) from error
        check_writable(self.output / _PAGE)

    def run(self, console: Console) -> int:
        """Render one after the other, write the page and print its path. Returns the exit status."""
        entries: list[display.Entry] = []
        exit_code = 0
        for task in self._tasks:
            outputs = Outputs.of([self.output / f"{task.method.name}.exr"])
            history = _History()

            def open_job(task: Task = task) -> Job:
                job = Job.open(task)
                self._check_size(job.problem.size)
                return job

            watch = history.record if self._reference is not None else None
            outcome = follow(
                lambda open_job=open_job, outputs=outputs, watch=watch: start_job(open_job, outputs, watch=watch),  # type: ignore[misc]
                console,
                task.method.name,
            )
            exit_code = outcome.exit_code
            if outcome.rendering is not None:
                note(console, summary(outcome.rendering))
                entries.append(
                    display.Entry(
                        task.method.name,
                        outcome.rendering.image,
                        outcome.rendering.metadata,
                        history.errors(self._reference),
                        {k: v for k, v in outcome.rendering.layers.items() if k != "image"},
                    )
                )
            if exit_code:
                break
        if entries:
            self._write(entries)
        return exit_code

    def _write(self, entries: list[display.Entry]) -> None:
        """Pictures at one exposure, so that they can be compared, and the page."""
        exposure = display.auto_exposure(self._reference if self._reference is not None else entries[0].image)
        for entry in entries:
            display.write_png(self.output / f"{entry.name}.png", display.tonemap(entry.image, exposure))
        page = self.output / _PAGE
        display.write_report(
            page,
            entries,
            self._reference,
            title=self.title or f"{Path(self.scene).name}: {', '.join(e.name for e in entries)}",
            subtitle=self.subtitle,
            reference_note=self.reference_note or (str(self.reference) if self.reference else ""),
            exposure=exposure,
        )
        say(str(page))

    def _check_size(self, size: tuple[int, int]) -> None:
        """Before the first pass: a reference of another size would only be noticed at the end."""
        if self._reference is not None:
            height, width = self._reference.shape[:2]
            if size != (width, height):
                raise OptionError(
                    f"the reference is {width}x{height}, the picture {size[0]}x{size[1]}; use --size {width}x{height}"
                )

    def _settings_by_method(self) -> dict[str, dict[str, Any]]:
        """``name`` goes to every method that has it, ``method.name`` to one."""
        result: dict[str, dict[str, Any]] = {name: {} for name in self.methods}
        known = {name: {row[0] for row in methods.get(name).Settings.describe()} for name in self.methods}
        for key, value in self.settings.items():
            owner, dot, setting = key.rpartition(".")
            if dot and owner not in result:
                raise OptionError(f"-D {key}: '{owner}' is not compared here; there are: {', '.join(result)}")
            takers = [owner] if dot else [name for name in self.methods if key in known[name]]
            # A name that nobody has goes to the first, whose settings then say what is meant.
            for name in takers or self.methods[:1]:
                result[name][setting if dot else key] = value
        return result


class _History:
    """Pictures at times that grow by a ratio; they are compared with the reference when the clock has stopped."""

    def __init__(self) -> None:
        self._pictures: list[tuple[float, Image]] = []

    def record(self, update: Update) -> None:
        elapsed = update.progress.elapsed
        if not self._pictures or elapsed >= self._pictures[-1][0] * _HISTORY_RATIO:
            self._pictures.append((elapsed, update.image))

    def errors(self, reference: Image | None) -> list[tuple[float, float]]:
        if reference is None:
            return []
        return [(elapsed, film.relative_mse(picture, reference)) for elapsed, picture in self._pictures]


def demonstration(output: Path, seconds: float, size: tuple[int, int] | None) -> Comparison:
    """The bundled scene for demonstration, by ``path`` and ``vcm``. Its reference fits its own size only."""
    scene = next(iter(bundled().values()))
    reference = getattr(scene, "reference", None) if size is None else None
    return Comparison(
        scene=scene.name,
        methods=["path", "vcm"],
        output=output,
        budget=Budget(seconds=seconds),
        reference=reference,
        reference_note=getattr(scene, "reference_note", ""),
        title=f"étendue: {scene.name}",
        subtitle=scene.description,
        size=size,
    )
