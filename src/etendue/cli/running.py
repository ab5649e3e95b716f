"""Shared by the commands that run: the session with its progress bar, files, and the summary of a picture."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from etendue.core import OptionError, OutputError, format_rate, format_seconds, lower_priority, set_threads, use_variant
from etendue.engine import Cancelled, Job, RunError, Session
from etendue.products import Callback, Picture, Rendering, start_job
from etendue.scene import BundledScene

from .console import ProgressView, error_console, note, say
from .interrupts import Interrupts, saving_on_signal

if TYPE_CHECKING:
    from etendue.distributed import Cluster

T = TypeVar("T")


@dataclass
class Outcome(Generic[T]):
    """The result of a session, and the exit status if a signal ended it early."""

    result: T | None
    exit_code: int


def choose_device(
    variant: str | None, threads: int | None, low_priority: bool = False, scene: Any = None, colours: str = "rgb"
) -> None:
    """Set the Mitsuba variant, the number of threads, and whether other processes come first. Without a variant, one
    with the colours that a ``scene`` needs, or with ``colours``."""
    if low_priority:
        lower_priority()  # before there are threads, which have the priority of their creator
    set_threads(threads)
    if scene is None:
        use_variant(variant, colours)
    else:
        from etendue.scene import use_variant_of

        use_variant_of(scene, variant)


def follow(open_session: Callable[[], Session[T]], console: Console, label: str) -> Outcome[T]:
    """Start a session and show its progress until it ends. Raises the errors of the session."""
    with ProgressView(console, label) as view:
        announced = is_late = False
        sessions: list[Session[T]] = []

        def announce() -> None:
            # Not from the signal handler, which may have interrupted a write to the same stream.
            nonlocal announced
            if interrupts.received is not None and not announced:
                announced = True
                words = "writing the files" if is_late else "stopping after this pass; press again to abort at once"
                note(console, words, "yellow")

        def stop() -> None:
            nonlocal is_late
            for session in sessions:
                is_late = session.finishing
                session.request_stop()

        def abort() -> None:
            if any(session.finishing for session in sessions):
                return  # what was rendered would be lost
            try:
                view.close()
                note(console, "aborted", "red")
            finally:  # the thread of the session is inside compiled code, and cannot be ended otherwise
                os._exit(interrupts.exit_code)

        def save() -> None:
            for session in sessions:
                session.request_save()

        with Interrupts(stop, abort) as interrupts, saving_on_signal(save):
            session = open_session()
            sessions.append(session)
            if interrupts.received is not None:  # before there was a session
                stop()
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


def render_to_files(
    open_job: Callable[[], Job],
    product: Picture,
    label: str,
    cluster: Cluster | None = None,
    callback: Callback | None = None,
) -> int:
    """Render, write the files of ``product`` and print their paths on standard output, one per line; ``cluster`` makes
    the passes, ``callback`` is called after each. Returns the exit status."""
    console = error_console()
    try:
        outcome = follow(lambda: start_job(open_job, callback, cluster), console, label)
    except RunError:
        _name_files(product)  # they contain the passes before the failure
        raise
    if outcome.result is not None:
        note(console, summary(outcome.result))
        _name_files(product)
    return outcome.exit_code


@contextmanager
def shown_in_tev(address: str | None, name: str) -> Iterator[Callback | None]:
    """A callback of runs that shows their layers in tev, if there is an address. Raises :class:`OptionError` for text
    that is no address."""
    if address is None:
        yield None
        return
    from etendue.display import TevDisplay  # imported late: most of the package is for pages and plots

    with TevDisplay(address, name) as display:
        yield lambda update: display.offer(lambda: update.result)


def _name_files(product: Picture) -> None:
    say("\n".join(map(str, product.files)))


def summary(rendering: Rendering) -> str:
    """``vcm: 120 passes, 120 spp, 59.8s, 9.2 Mrays/s, error 0.11``."""
    m = rendering.metadata
    passes = f"{m['passes']} pass{'' if m['passes'] == 1 else 'es'}"
    parts = [passes, f"{m['samples']} spp", format_seconds(m["seconds"])]
    if m["rays"] and m["seconds"]:
        parts.append(format_rate(m["rays"] / m["seconds"]))
    if m["error"] is not None:
        parts.append(f"error {m['error']:.2g}")
    return f"{m['method']}: {', '.join(parts)}"


def make_folder(folder: Path) -> None:
    """Create a folder for outputs if it is missing. Raises :class:`OutputError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = "that is a file" if folder.exists() else error.strerror
        raise OutputError(f"cannot make the folder '{folder}': {reason}; choose another place") from error


def check_reference(reference: NDArray[np.float32] | None, size: tuple[int, int], remedy: str) -> None:
    """Check the size of the reference before the first pass, not only at the end.

    ``remedy`` is the option for a size, with ``{}`` for width and height. Raises :class:`OptionError`.
    """
    if reference is not None and reference.shape[1::-1] != size:
        height, width = reference.shape[:2]
        raise OptionError(
            f"the reference is {width}x{height}, the picture {size[0]}x{size[1]}; use {remedy.format(width, height)}"
        )


def default_name(scene: Path | BundledScene) -> str:
    """A name for outputs: that of the scene file, or of its folder if the file is called ``scene.xml``."""
    path = Path(str(scene))
    stem = path.absolute().parent.name if path.stem == "scene" else path.stem
    return stem or "render"
