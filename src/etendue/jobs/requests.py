"""Requests for form factors and solutions. Making a request checks all that can be checked before files are read."""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from etendue.core import (
    BackendError,
    CheckpointError,
    OptionError,
    SceneError,
    describe,
    is_number,
    is_whole,
    logger,
    suggest,
)
from etendue.engine import Budget, Checkpoint, check_period, check_records, remaining
from etendue.radiosity import (
    ESTIMATORS,
    FORM_FACTOR_FILES,
    SOLVERS,
    CastingSettings,
    Patches,
    check_direct,
    check_file,
    check_text_size,
    read_patches,
    scene_patches,
)
from etendue.scene import Problem, load, locate

from .files import check_files
from .results import DEFAULT_BUNDLES, DEFAULT_POINTS
from .solutions import SolutionOutputs
from .wording import PYTHON, Wording

#: The solver that needs neither stored segments nor a matrix.
MULTIPATH = "multipath"
#: Solvers that work on segments; the others, except multipath, need the matrix.
ON_SEGMENTS = ("jacobi", "conjugate-gradient")
#: Libraries of the extra `radiosity`.
_LIBRARIES = ("numba", "scipy", "meshio", "trimesh")
#: Suffixes of scenes; all other files are meshes.
_SCENES = (".xml", "")
#: Key of the request in the notes of a checkpoint.
_NOTE = "lines"


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
    #: Whether the source may be a scene.
    takes_scenes: ClassVar[bool] = False

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
    def needs_matrix(self) -> bool:
        """Whether form factors are computed from the lines, which takes memory."""

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
        whole = is_number(value) and float(value).is_integer()
        if value is not None and not (whole and value >= 1):
            limit = self.wording.limit(name)
            raise OptionError(f"a budget in {limit} must be a whole number of at least 1, not {value!r}")

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
        elif not self.takes_scenes:
            raise OptionError("form factors need a mesh: give a mesh file, or patches")
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
        return not self.takes_scenes or not (path.suffix.lower() in _SCENES or path.is_dir())

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
        if isinstance(self.source, Patches):
            patches = self.source
        elif problem is not None:
            patches = scene_patches(problem, max_area=self.max_area)
        else:
            patches = read_patches(self.source, **{k: v for k, v in self.mesh.items() if v is not None})
            patches = patches if self.max_area is None else patches.subdivided(self.max_area)
        self.check_patches(patches, problem)
        return problem, patches

    def problem(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """The scene; ``None`` if the source is not a scene."""
        return None

    def notes(self) -> dict[str, Any]:
        """The request as plain values for a checkpoint, with absolute paths; empty if the source is in memory, so that
        it could not be loaded again."""
        if not isinstance(self.source, (str, os.PathLike)):
            return {}
        place: Any = Path(self.source) if self.is_mesh else locate(self.source, logger.debug)
        plain = {name: getattr(self, name) for name in self._noted()}
        plain |= {"seed": int(self.seed), "source": str(place.absolute()) if isinstance(place, Path) else place.name}
        return {_NOTE: _plain({"work": self.work, **plain, **self._noted_outputs()})}

    def _noted(self) -> tuple[str, ...]:
        return ("lines", "local_rays", "max_area", "mesh")

    @abstractmethod
    def _noted_outputs(self) -> dict[str, Any]: ...


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """The same values with NumPy's numbers as Python's, for JSON."""
    plain: dict[str, Any] = json.loads(json.dumps(values, default=lambda value: value.item()))
    return plain


@dataclass(frozen=True, kw_only=True)
class FormFactorRequest(LinesRequest):
    """Form factors of patches."""

    estimator: str = "F1"
    outputs: tuple[Path, ...] = ()

    work: ClassVar[str] = "form-factors"

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`LinesRequest`."""
        return self.outputs

    @property
    def needs_matrix(self) -> bool:
        """See :class:`LinesRequest`."""
        return True

    def _check_outputs(self) -> None:
        _check_name("estimator", self.estimator, ESTIMATORS)
        for path in self.outputs:
            check_file(path, FORM_FACTOR_FILES)

    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """See :class:`LinesRequest`."""
        for path in self.outputs:
            if path.suffix.lower() == ".vf":
                check_text_size(path, len(patches), 0)

    def _noted(self) -> tuple[str, ...]:
        return (*super()._noted(), "estimator")

    def _noted_outputs(self) -> dict[str, Any]:
        return {"outputs": [str(path.absolute()) for path in self.outputs]}


@dataclass(frozen=True, kw_only=True)
class RadiosityRequest(LinesRequest):
    """A solution, and the files made from it. ``points`` limits multipath as ``bundles`` limits other solvers."""

    solver: str = "conjugate-gradient"
    points: int | None = None
    shot: bool = True  #: send the light of small emitters by local rays first
    outputs: SolutionOutputs = field(default_factory=SolutionOutputs)

    work: ClassVar[str] = "radiosity"
    takes_scenes: ClassVar[bool] = True

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`LinesRequest`."""
        return self.outputs.written

    @property
    def needs_matrix(self) -> bool:
        """See :class:`LinesRequest`."""
        return self.solver not in (*ON_SEGMENTS, MULTIPATH)

    @property
    def stores_lines(self) -> bool:
        """See :class:`LinesRequest`."""
        return self.solver != MULTIPATH

    def _check_numbers(self) -> None:
        super()._check_numbers()
        self._check_count("points", self.points)

    def _samples(self) -> tuple[str, int | None, int]:
        return ("points", self.points, DEFAULT_POINTS) if self.solver == MULTIPATH else super()._samples()

    def _check_outputs(self) -> None:
        _check_name("solver", self.solver, (*SOLVERS, MULTIPATH))
        self._check_limits()
        self.outputs.check(self.wording)
        if 1 in (self.bundles, self.points):
            self.outputs.check_errors(None, self.wording)

    def _check_limits(self) -> None:
        """Refuse options that the solver does not have."""
        option = self.wording.option
        if self.solver != MULTIPATH:
            if self.points is not None:
                raise OptionError(f"{option('points')} is for multipath; limit {self.solver} by {option('bundles')}")
            return
        if self.bundles is not None:
            raise OptionError(f"multipath casts single lines, not bundles: give {option('points')}")
        if self.lines:
            raise OptionError(f"multipath casts single lines: leave out {option('lines')}, the lines of a bundle")
        if not self.local_rays:
            raise OptionError(f"multipath casts no local rays: leave out {option('local_rays')}")

    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """See :class:`LinesRequest`; raises :class:`SceneError` if there is no light."""
        if not (patches.emission.any() or patches.sky.any()):
            raise SceneError(self._without_light(problem))
        if self.solver == "direct":
            check_direct(len(patches))
        self.outputs.check_source(patches, problem, self.wording)

    def problem(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """See :class:`LinesRequest`; loaded with the sensor and the size of the pictures."""
        if isinstance(self.source, Patches) or self.is_mesh:
            return None
        found = locate(self.source, tell) if isinstance(self.source, (str, os.PathLike)) else self.source
        return load(found, parameters=self.parameters, size=self.outputs.size, sensor=self.outputs.sensor)

    def _without_light(self, problem: Problem | None) -> str:
        if problem is not None:
            return f"'{self.name}' has no light for radiosity; give it an emitter of type 'area' or 'constant'"
        how = self.wording.mesh_light if self.is_mesh else "give them emission or a sky"
        return f"'{self.name}' has no light; {how}"

    def _noted(self) -> tuple[str, ...]:
        return (*super()._noted(), "solver", "shot")

    def _noted_outputs(self) -> dict[str, Any]:
        given = None if self.parameters is None else {name: str(value) for name, value in self.parameters.items()}
        return {"parameters": given, "outputs": self.outputs.to_dict()}


def asked_before(
    saved: Checkpoint,
    *,
    source: Any = None,
    output: Path | None = None,
    kinds: Sequence[type[LinesRequest]] = (),
    **changes: Any,
) -> LinesRequest:
    """The request of a checkpoint of lines, with another ``source`` and ``output`` where they are given.

    Raises :class:`CheckpointError` if the checkpoint has no request, and the errors of a request.
    """
    known_kinds: dict[str, Any] = {kind.work: kind for kind in kinds or (FormFactorRequest, RadiosityRequest)}
    try:
        known = dict(saved.notes[_NOTE])
        kind = known_kinds[known.pop("work")]
        if kind is FormFactorRequest:
            known["outputs"] = tuple(map(Path, known["outputs"])) if output is None else (output,)
        else:
            outputs = SolutionOutputs.from_dict(known["outputs"])
            known["outputs"] = outputs if output is None else outputs.renamed(output)
        if source is not None:
            known["source"] = source
        return kind(**known, **changes)
    except (KeyError, TypeError) as error:
        raise CheckpointError(
            f"the checkpoint does not contain its request ({describe(error)}); cast the lines again"
        ) from None


def _check_name(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise OptionError(f"there is no {what} '{name}'; {suggest(name, known)}")
