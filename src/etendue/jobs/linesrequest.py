"""Base of the requests for form factors and for solutions."""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from etendue.core import (
    BackendError,
    OptionError,
    is_number,
    is_whole,
    logger,
)
from etendue.engine import Budget, Checkpoint, check_period, check_records, remaining
from etendue.radiosity import (
    CastingSettings,
    Patches,
    instanced_patches,
    read_patches,
)
from etendue.scene import Problem, load, locate

from .files import check_files
from .results import DEFAULT_BUNDLES
from .wording import PYTHON, Wording

#: Libraries of the extra `radiosity`.
_LIBRARIES = ("numba", "scipy", "meshio", "trimesh")
#: Suffixes of scenes; all other files are meshes.
_SCENES = (".xml", "")
#: Key of the request in the notes of a checkpoint.
NOTE = "lines"


@dataclass(frozen=True, kw_only=True)
class LinesRequest(ABC):
    """The inputs of both kinds of work. The first of the limits ``seconds``, ``bundles`` and ``error`` that is reached
    ends the casting."""

    #: :class:`Patches`, the path of a mesh file, or a scene in any form that :func:`etendue.scene.load` takes.
    source: Any
    seconds: float | None = None
    bundles: int | None = None
    error: float | None = None  #: a standard error, see :class:`etendue.radiosity.LineCasting`
    seed: int = 0
    lines: float = 0.0  #: lines of a bundle through the bounding sphere; 0 for a number that suits the patches
    local_rays: bool = True  #: cast local rays from patches that few lines meet
    max_area: float | None = None  #: larger faces are subdivided
    #: For a mesh file: further arguments of :func:`etendue.radiosity.read_patches`.
    mesh: Mapping[str, Any] = field(default_factory=dict)
    #: For a scene in XML: values of its ``$variables``.
    parameters: Mapping[str, Any] | None = None
    checkpoint: Path | None = None
    save_every: float | None = None  #: seconds between checkpoints
    wording: Wording = PYTHON

    work: ClassVar[str]

    def __post_init__(self) -> None:
        missing = [name for name in _LIBRARIES if find_spec(name) is None]
        if missing:
            raise BackendError(f"radiosity needs {', '.join(missing)}, not installed: pip install 'etendue[radiosity]'")
        self._check_numbers()
        self._check_outputs()
        self._check_options()
        check_files(self.files if self.checkpoint is None else (*self.files, self.checkpoint))
        if self.checkpoint is not None and self.stores_lines:
            check_records(self.checkpoint)

    @property
    @abstractmethod
    def files(self) -> tuple[Path, ...]:
        """All output files, without the checkpoint."""

    @property
    @abstractmethod
    def entry_bytes(self) -> float:
        """Bytes of each form factor while it is computed from the lines; 0 if none are."""

    @property
    def keeps_groups(self) -> bool:
        """Whether the parts of subdivided faces stay in the patches of their faces."""
        return False

    @property
    def is_watched(self) -> bool:
        """Whether errors are estimated during the run even if no budget asks for them."""
        return False

    @property
    def stores_lines(self) -> bool:
        """Whether lines are stored, in memory and in the records of a checkpoint."""
        return True

    @abstractmethod
    def _check_outputs(self) -> None:
        """Check the names and files of this kind of work."""

    @abstractmethod
    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """Raise :class:`OptionError` if the outputs cannot be made from these patches; called before lines are cast."""

    def _check_numbers(self) -> None:
        for name, value in (("seconds", self.seconds), ("error", self.error)):
            if value is not None and not (is_number(value) and value > 0):
                raise OptionError(f"a budget in {self.wording.limit(name)} must be a number above 0, not {value!r}")
        self._check_count("bundles", self.bundles)
        if not is_whole(self.seed):
            raise OptionError(f"a seed is a whole number, not {self.seed!r}")
        CastingSettings(lines=self.lines)
        check_period(self.save_every)

    def _check_count(self, name: str, value: Any) -> None:
        self.wording.check_count(name, value)

    def _check_options(self) -> None:
        """Refuse options of another kind of source."""
        option = self.wording.option
        if isinstance(self.source, Patches):
            for name in ("max_area", "parameters"):
                if getattr(self, name) is not None:
                    raise OptionError(f"{option(name)} is for scenes and mesh files, not for patches; leave it out")
        elif self.is_mesh:
            if self.parameters:
                raise OptionError(f"{option('parameters')} is for scenes in XML; a mesh file has no parameters")
        else:
            given = [name for name, value in self.mesh.items() if value is not None and value is not False]
            for name in given:
                why = "in a scene, materials of type 'twosided' make sheets"
                why = why if name == "two_sided" else "a scene has its own materials and lights"
                raise OptionError(f"{option(name)} is for mesh files; {why}")

    @property
    def is_mesh(self) -> bool:
        """Whether the source is a mesh file."""
        if not isinstance(self.source, (str, os.PathLike)):
            return False
        path = Path(self.source)
        return not (path.suffix.lower() in _SCENES or path.is_dir())

    @property
    def name(self) -> str:
        """The source, for messages."""
        if isinstance(self.source, Patches):
            return "<patches>"
        return str(self.source) if isinstance(self.source, (str, os.PathLike)) else "<scene>"

    def budget(self, saved: Checkpoint | None) -> Budget:
        """The limits in the units of the engine: a sample is a bundle, the error is the square of ``error``.

        Without limits, the rest of the budget of the checkpoint ``saved``, or the default. Raises
        :class:`CheckpointError` if the budget of the checkpoint is used up.
        """
        name, count, default = self._samples()
        if (self.seconds, count, self.error) != (None, None, None):
            return Budget(self.seconds, count, None, None if self.error is None else self.error**2)
        if saved is None:
            return Budget(samples=default)
        samples, seconds, error = map(self.wording.option, (name, "seconds", "error"))
        return remaining(saved, f"{samples}, {seconds} or {error}")

    def _samples(self) -> tuple[str, int | None, int]:
        """The limit in samples: its name, its value and the default."""
        return "bundles", self.bundles, DEFAULT_BUNDLES

    def load(self, tell: Callable[[str], object] = logger.info) -> tuple[Problem | None, Patches]:
        """The scene, if the source is one, and the checked patches. ``tell`` receives a line if the scene's name is
        ambiguous."""
        problem = self.problem(tell)
        return problem, self._patches(problem)

    def _patches(self, problem: Problem | None) -> Patches:
        """The checked patches of the source, or of ``problem`` if the source is a scene."""
        patches = self.read(problem)
        self.check_patches(patches, problem)
        return patches

    def read(self, problem: Problem | None) -> Patches:
        """The patches of the source, or of ``problem`` if the source is a scene."""
        if isinstance(self.source, Patches):
            return self.source
        if problem is not None:
            return instanced_patches(problem, max_area=self.max_area)
        patches = read_patches(self.source, **{k: v for k, v in self.mesh.items() if v is not None})
        return patches if self.max_area is None else patches.subdivided(self.max_area, grouped=self.keeps_groups)

    @abstractmethod
    def problem(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """The scene; ``None`` if the source is not a scene."""

    def _loaded(self, tell: Callable[[str], object], **options: Any) -> Problem | None:
        """See :meth:`problem`; ``options`` are further ones of :func:`etendue.scene.load`."""
        if isinstance(self.source, Patches) or self.is_mesh:
            return None
        found = locate(self.source, tell) if isinstance(self.source, (str, os.PathLike)) else self.source
        return load(found, parameters=self.parameters, **options)

    @property
    def _plain_parameters(self) -> dict[str, str] | None:
        """``parameters`` for a checkpoint."""
        return None if self.parameters is None else {name: str(value) for name, value in self.parameters.items()}

    def notes(self) -> dict[str, Any]:
        """The request as plain values for a checkpoint, with absolute paths; empty if the source is in memory, since it
        could not be loaded again."""
        if not isinstance(self.source, (str, os.PathLike)):
            return {}
        place: Any = Path(self.source) if self.is_mesh else locate(self.source, logger.debug)
        plain = {name: getattr(self, name) for name in self._noted()}
        plain |= {"seed": int(self.seed), "source": str(place.absolute()) if isinstance(place, Path) else place.name}
        return {NOTE: _plain({"work": self.work, **plain, **self._noted_outputs()})}

    def _noted(self) -> tuple[str, ...]:
        return ("lines", "local_rays", "max_area", "mesh")

    @abstractmethod
    def _noted_outputs(self) -> dict[str, Any]: ...


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """The same values with NumPy's numbers as Python's, for JSON."""
    plain: dict[str, Any] = json.loads(json.dumps(values, default=lambda value: value.item()))
    return plain
