"""What a run leaves behind: the picture in memory, and the files that it writes, whatever happens."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, OutputError, Result, describe
from etendue.engine import Checkpoint, Job, RunResult, check_period
from etendue.film import check_writable, replacing

PathLike = str | os.PathLike[str]
Image = NDArray[np.float32]


@dataclass(repr=False)
class Rendering:
    """A picture, what it is made of, and how it was made.

    ``layers`` are float32 arrays (height, width, channels), linear RGB: ``image``; with the setting ``split_layers``
    the technique families that it is the sum of; with ``pyramid`` the techniques (``film.Technique`` reads their
    names); with ``aovs`` first-hit layers. ``metadata`` has method, settings,
    seed, versions, passes, samples, seconds, rays and more.
    """

    layers: dict[str, Image]
    metadata: dict[str, Any]
    _checkpoint: Callable[[], Checkpoint]

    @property
    def image(self) -> Image:
        """The picture, (height, width, 3), linear RGB radiance."""
        return self.layers["image"]

    def save(self, path: PathLike) -> None:
        """Write ``.exr`` (every layer and the metadata) or ``.png`` (tone-mapped), by the suffix.

        Raises :class:`OptionError` for another suffix, :class:`OutputError` if the file cannot be written.
        """
        save_result(path, Result(self.layers, self.metadata))

    def save_checkpoint(self, path: PathLike) -> None:
        """Write all that :func:`resume` needs. Raises :class:`OutputError` if it cannot be written."""
        self._checkpoint().write(Path(path))

    def __repr__(self) -> str:
        m, (height, width) = self.metadata, self.image.shape[:2]
        return f"<etendue.Rendering {m['method']} {width}x{height}, {m['samples']} spp, {m['seconds']:.1f} s>"


class Writer(Protocol):
    """What keeps a run: told how often and, at the end, that it is to write. :class:`Outputs` is one."""

    @property
    def files(self) -> Sequence[Path]:
        """What is written, or has been."""
        ...

    def saving(self, job: Job) -> dict[str, Any]:
        """Options of a :class:`Runner` of ``job`` that write from time to time."""
        ...

    def write(self, job: Job, run: RunResult) -> Rendering:
        """Write the outcome of a run."""
        ...


@dataclass(frozen=True)
class Outputs:
    """Files that a run writes. Construction by :meth:`of` checks that they can be written."""

    pictures: tuple[Path, ...] = ()
    checkpoint: Path | None = None
    save_every: float | None = None  #: seconds between intermediate saves, ``None`` for none
    separate: bool = False  #: each layer of an ``.exr`` in a file of its own

    @classmethod
    def of(
        cls,
        pictures: PathLike | Sequence[PathLike],
        checkpoint: PathLike | None = None,
        save_every: float | None = None,
        separate: bool = False,
    ) -> Outputs:
        """Raises :class:`OptionError` for an unknown suffix, a file that is named twice or a time that is not above 0,
        :class:`OutputError` for a place that is not writable."""
        listed = [pictures] if isinstance(pictures, (str, os.PathLike)) else list(pictures)
        check_period(save_every)
        outputs = cls(
            tuple(map(Path, listed)), Path(checkpoint) if checkpoint is not None else None, save_every, separate
        )
        for path in outputs.pictures:
            _check_suffix(path)
        places = [path.resolve() for path in outputs.files]
        for path in outputs.files:
            if places.count(path.resolve()) > 1:
                raise OptionError(f"'{path}' is named for two outputs; give each a name of its own")
            check_writable(path)
        return outputs

    @property
    def files(self) -> tuple[Path, ...]:
        """Pictures, then the checkpoint."""
        return self.pictures if self.checkpoint is None else (*self.pictures, self.checkpoint)

    def saving(self, job: Job) -> dict[str, Any]:
        """Options of a :class:`Runner` of ``job`` that write the files from time to time."""
        if self.save_every is None or not self.files:
            return {}
        return {"on_save": lambda run: self.write(job, run), "save_every": self.save_every}

    def write(self, job: Job, run: RunResult) -> Rendering:
        """Write the checkpoint, develop ``run`` and write every picture. One that fails does not keep the others from
        being written, whatever the reason.

        Raises :class:`OutputError` with every failure when all have been tried. At the end of a run what has failed is
        then in the system's folder for temporary files, if that takes it: a picture, as arrays (``.npz``) if it is the
        writing that fails; the checkpoint; and a checkpoint, asked for or not, if the picture cannot be developed.
        """
        ending = run.stopped_by != "running"
        failures: list[str] = []

        def attempt(path: Path, what: str, write: _Write, plainly: _Write | None = None) -> None:
            try:
                write(path)
            except Exception as error:
                failure = str(error) if isinstance(error, OutputError) else f"cannot write '{path}': {describe(error)}"
                failures.append(failure + (_rescue(path.name, what, write, plainly) if ending else ""))

        def write_checkpoint(path: Path) -> None:
            job.checkpoint(run).write(path)

        if self.checkpoint is not None:  # first, as it holds all that was measured
            attempt(self.checkpoint, "checkpoint", write_checkpoint)
        try:
            result = job.result(run)
        except Exception as error:
            failures.append(f"cannot develop the picture: {describe(error)}")
            if ending and self.checkpoint is None:
                failures[-1] += _rescue("render.checkpoint", "checkpoint", write_checkpoint)
            raise OutputError("; ".join(failures)) from error
        for picture in self.pictures:
            attempt(
                picture,
                "picture",
                lambda path: save_result(path, result, self.separate),
                lambda path: _write_arrays(path, result.layers),
            )
        if failures:
            raise OutputError("; ".join(failures))
        return Rendering(result.layers, result.metadata, lambda: job.checkpoint(run))


_Write = Callable[[Path], None]


def _rescue(name: str, what: str, write: _Write, plainly: _Write | None = None) -> str:
    """Write to the folder for temporary files, ``plainly`` if need be; in words where it is, "" if all has failed."""
    with contextlib.suppress(OSError):
        folder = Path(tempfile.mkdtemp(prefix="etendue-"))
        for suffix, way in (("", write), (".npz", plainly)):
            with contextlib.suppress(Exception):
                if way is not None:
                    way(place := folder / (name + suffix))
                    return f"; the {what} is in '{place}' instead"
        folder.rmdir()
    return ""


def _write_arrays(path: Path, layers: Mapping[str, Image]) -> None:
    with replacing(path) as part, part.open("wb") as file:
        np.savez(file, **layers)  # type: ignore[arg-type]


def save_result(path: PathLike, result: Result, separate: bool = False) -> None:
    """Write a result as ``.exr`` (layers and metadata; ``separate``: a file each) or ``.png`` (tone-mapped)."""
    from etendue import display, film

    path = Path(path)
    if _check_suffix(path) == ".exr" and separate:
        film.write_layers(path, result)
    elif path.suffix.lower() == ".exr":
        film.write_exr(path, result)
    else:
        display.write_png(path, display.tonemap(result.image, "auto"))


def _check_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".exr", ".png"):
        raise OptionError(f"a picture is written as .exr or .png, not as '{path.name}'; change the name")
    return suffix
