"""What the rendering commands share: the session with its progress bar, and the outcome in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from etendue.api import Outputs, Rendering, start_job
from etendue.core import format_rate, format_seconds, set_threads, use_variant
from etendue.engine import Cancelled, Job, RunError, Session

from .console import ProgressView, error_console, note, say
from .interrupts import Interrupts


@dataclass
class Outcome:
    """A rendering, and the exit status if a signal ended it early."""

    rendering: Rendering | None
    exit_code: int


def choose_device(variant: str | None, threads: int | None) -> None:
    """Set the Mitsuba variant and the number of threads."""
    set_threads(threads)
    use_variant(variant)


def follow(open_session: Callable[[], Session[Rendering]], console: Console, label: str) -> Outcome:
    """Start a session and show its progress until it is over. Raises what the session raises."""
    with ProgressView(console, label) as view:
        session = open_session()
        announced = False

        def announce() -> None:
            # Not from the signal handler, which may have interrupted a write to the same stream.
            nonlocal announced
            if interrupts.received is not None and not announced:
                announced = True
                note(console, "stopping after this pass; again to abort at once", "yellow")

        def abort() -> None:
            view.close()
            note(console, "aborted", "red")

        with Interrupts(session.request_stop, abort) as interrupts:
            try:
                while not session.wait(0.1):
                    announce()
                    view.update(session.progress, session.prepared)
                announce()
            except Cancelled:
                if interrupts.received is None:
                    raise
                note(console, "stopped before the first pass was done; nothing was written", "yellow")
                return Outcome(None, interrupts.exit_code)
    return Outcome(session.result, interrupts.exit_code)


def render_to_files(open_job: Callable[[], Job], outputs: Outputs, label: str) -> int:
    """Render, write ``outputs`` and name them on standard output, one a line. Returns the exit status."""
    console = error_console()
    files = "\n".join(map(str, outputs.files))
    try:
        outcome = follow(lambda: start_job(open_job, outputs), console, label)
    except RunError:
        say(files)  # the passes before the failure are in them
        raise
    if outcome.rendering is not None:
        note(console, summary(outcome.rendering))
        say(files)
    return outcome.exit_code


def summary(rendering: Rendering) -> str:
    """``vcm: 120 passes, 120 spp, 59.8s, 9.2 Mrays/s, noise 0.012``."""
    m = rendering.metadata
    passes = f"{m['passes']} pass{'' if m['passes'] == 1 else 'es'}"
    parts = [passes, f"{m['samples']} spp", format_seconds(m["seconds"])]
    if m["rays"] and m["seconds"]:
        parts.append(format_rate(m["rays"] / m["seconds"]))
    if m["relative_error"] is not None:
        parts.append(f"noise {m['relative_error']:.2g}")
    return f"{m['method']}: {', '.join(parts)}"


def default_name(scene: str) -> str:
    """A name for outputs: that of the scene file, or of its folder if the file is called as all of them are."""
    path = Path(scene)
    stem = path.absolute().parent.name if path.stem == "scene" else path.stem
    return stem or "render"
