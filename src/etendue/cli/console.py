"""Messages and progress in a terminal or a pipe. Paths of written files go to standard output, the rest to standard
error."""

from __future__ import annotations

import logging
import shlex
import sys
import time
from collections.abc import Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console

from etendue.core import Progress

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

#: In a pipe, a line of progress is printed when the time has grown by this factor, and at least this often.
_LINE_RATIO, _LINE_EVERY = 1.5, 60.0


#: The arguments of the command that runs.
_ARGUMENTS: ContextVar[Sequence[str]] = ContextVar("arguments", default=())


def remember_arguments(words: Sequence[str]) -> None:
    """Keep the arguments of the command for :func:`command_line`."""
    _ARGUMENTS.set(tuple(words))


def command_line() -> str:
    """The command that runs, as it could be typed."""
    return shlex.join(["etendue", *_ARGUMENTS.get()])


#: Whether only paths of files, warnings and errors are printed.
_QUIET: ContextVar[bool] = ContextVar("quiet", default=False)


def be_quiet(quiet: bool) -> None:
    """Whether to print only paths of files, warnings and errors from now on."""
    _QUIET.set(quiet)


def error_console() -> Console:
    """The console of progress, warnings and errors: standard error."""
    return Console(stderr=True, highlight=False, quiet=_QUIET.get())


def warning_console() -> Console:
    """The console of warnings and errors, which are always printed."""
    return Console(stderr=True, highlight=False)


class _Output(Console):
    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # by itself the console would end the process, with status 1


def output_console() -> Console:
    """The console of a command's output: standard output."""
    return _Output(highlight=False)


def say(text: str) -> None:
    """Print a line of a command's output on standard output, without wrapping."""
    output_console().print(text, markup=False, soft_wrap=True)


def note(console: Console, text: str, style: str | None = None) -> None:
    """Print a line on standard error, without wrapping."""
    console.print(text, markup=False, soft_wrap=True, style=style)


class ConsoleHandler(logging.Handler):
    """Shows log records above the progress bar: ``warning: ...``."""

    def __init__(self, console: Console, level: int) -> None:
        super().__init__(level)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        """See :class:`logging.Handler`."""
        style = {logging.WARNING: "yellow", logging.ERROR: "red"}.get(record.levelno)
        note(self._console, f"{record.levelname.lower()}: {record.getMessage()}", style)


class ProgressView:
    """A live bar on a terminal, occasional lines elsewhere."""

    def __init__(self, console: Console, label: str) -> None:
        self._console = console
        self._label = label
        self._bar: RichProgress | None = None
        self._next_line, self._next_step, self._step = 1.0, 2.0, ""
        self._began = time.monotonic()

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            from rich.progress import BarColumn, Progress as RichProgress, TextColumn

            self._bar = RichProgress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=None),
                TextColumn("{task.fields[status]}"),
                console=self._console,
                transient=True,
                expand=True,
            )
            self._bar.add_task(self._label, total=None, status="loading the scene")
            self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the bar and show the cursor."""
        if self._bar is not None:
            self._bar.stop()

    def update(self, progress: Progress, prepared: bool) -> None:
        """Show ``progress``; called a few times per second."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], **self._fields(progress, prepared))
            return
        now = time.monotonic() - self._began
        if not progress.passes and now >= self._next_step:
            step = "first pass, compiling" if prepared else "loading the scene"
            if step != self._step:
                self._step = step
                note(self._console, f"{self._label}: {step}")
        if progress.passes and now >= self._next_line:
            self._next_line = min(max(now * _LINE_RATIO, 1.0), now + _LINE_EVERY)
            share = f"{100 * progress.fraction:3.0f} %  " if progress.fraction is not None else ""
            note(self._console, f"{self._label}: {share}{progress}")

    def _fields(self, progress: Progress, prepared: bool) -> dict[str, Any]:
        if not progress.passes:
            return {"total": None, "status": "first pass, compiling" if prepared else "loading the scene"}
        parts = [progress.made or f"pass {progress.passes}", *progress.pace]
        fields: dict[str, Any] = {"status": "  ".join(parts), "total": 1.0 if progress.fraction is not None else None}
        if progress.fraction is not None:
            fields["completed"] = progress.fraction
        return fields


class Steps:
    """The current step of work that is not a run: a live line on a terminal, occasional lines elsewhere."""

    def __init__(self, console: Console, text: str) -> None:
        self._console = console
        self._status = console.status(text)
        self._next_line = time.monotonic() + 1.0
        self._wait = 1.0

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._status.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._status.stop()

    def update(self, text: str) -> None:
        """Begin a step."""
        self._status.update(text)
        if not self._console.is_terminal and time.monotonic() >= self._next_line:
            self._wait = min(self._wait * _LINE_RATIO, _LINE_EVERY)
            self._next_line = time.monotonic() + self._wait
            note(self._console, text)


def print_error(message: str) -> None:
    """Print ``message`` as one line on standard error."""
    sys.stderr.write(f"error: {' '.join(message.split())}\n")
