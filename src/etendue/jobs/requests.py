"""What is asked of lines through patches: form factors, or a solution. A request that has been made is checked, as far
as that goes before anything is read."""

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
from etendue.engine import Budget, Checkpoint, check_period, remaining
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
from .results import DEFAULT_BUNDLES
from .solutions import SolutionOutputs
from .wording import PYTHON, Wording

#: Solvers that work on segments; the others need the matrix.
ON_SEGMENTS = ("jacobi", "conjugate-gradient")
#: What the extra brings.
_LIBRARIES = ("numba", "scipy", "meshio", "trimesh")
#: Suffixes of scenes; what else is a file is a mesh.
_SCENES = (".xml", "")
#: Of a checkpoint: the request.
_NOTE = "lines"


@dataclass(frozen=True, kw_only=True)
class LinesRequest(ABC):
    """What both kinds of work take. ``seconds``, ``bundles`` and ``error``: the first one reached ends the casting."""

    #: :class:`Patches`, the path of a mesh file, or a scene in any form that :func:`etendue.scene.load` takes.
    source: Any
    seconds: float | None = None
    bundles: int | None = None
    error: float | None = None  #: a standard error, see :class:`etendue.radiosity.LineCasting`
    seed: int = 0
    lines: float = 0.0  #: of a bundle through the bounding sphere; 0 for as many as suit the patches
    local_rays: bool = True
    max_area: float | None = None  #: faces that are larger are cut
    #: Of a mesh file: further arguments of :func:`etendue.radiosity.read_patches`.
    mesh: Mapping[str, Any] = field(default_factory=dict)
    #: Of a scene in XML: values of its ``$variables``.
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

    @property
    @abstractmethod
    def files(self) -> tuple[Path, ...]:
        """All that is written, but for the checkpoint."""

    @property
    @abstractmethod
    def needs_matrix(self) -> bool:
        """Whether form factors are made of the lines, which takes memory."""

    @abstractmethod
    def _check_outputs(self) -> None:
        """What particular work wants to know of names and files."""

    @abstractmethod
    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """Raise :class:`OptionError` if what is asked for cannot be made of these patches; before lines are cast."""

    def _check_numbers(self) -> None:
        for name, value in (("seconds", self.seconds), ("error", self.error)):
            if value is not None and not (is_number(value) and value > 0):
                raise OptionError(f"a budget in {self.wording.limit(name)} must be a number above 0, not {value!r}")
        whole = is_number(self.bundles) and float(self.bundles or 0).is_integer()
        if self.bundles is not None and not (whole and self.bundles >= 1):
            limit = self.wording.limit("bundles")
            raise OptionError(f"a budget in {limit} must be a whole number of at least 1, not {self.bundles!r}")
        if not is_whole(self.seed):
            raise OptionError(f"a seed is a whole number, not {self.seed!r}")
        CastingSettings(lines=self.lines)
        check_period(self.save_every)

    def _check_options(self) -> None:
        """Options that are for another kind of source."""
        option = self.wording.option
        if isinstance(self.source, Patches):
            for name in ("max_area", "parameters"):
                if getattr(self, name) is not None:
                    raise OptionError(f"patches are what they are: leave out {option(name)}, or give a scene")
        elif self.is_mesh:
            if self.parameters:
                raise OptionError(f"{option('parameters')} is for scenes in XML; a mesh file has no parameters")
        elif not self.takes_scenes:
            raise OptionError("form factors are those of a mesh: give its file, or patches")
        else:
            given = [name for name, value in self.mesh.items() if value is not None and value is not False]
            for name in given:
                why = "in a scene, materials of type 'twosided' make sheets"
                why = why if name == "two_sided" else "the materials and lights of a scene say it"
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
        """The source, for people."""
        if isinstance(self.source, Patches):
            return "<patches>"
        return str(self.source) if isinstance(self.source, (str, os.PathLike)) else "<scene>"

    def budget(self, saved: Checkpoint | None) -> Budget:
        """The limits as the engine takes them: a sample is a bundle, and its error the square of ``error``. Where there
        are none, what ``saved`` has left of its own. Raises :class:`CheckpointError` if that is nothing."""
        if (self.seconds, self.bundles, self.error) != (None, None, None):
            return Budget(self.seconds, self.bundles, None, None if self.error is None else self.error**2)
        if saved is None:
            return Budget(samples=DEFAULT_BUNDLES)
        bundles, seconds, error = map(self.wording.option, ("bundles", "seconds", "error"))
        return remaining(saved, f"{bundles}, {seconds} or {error}")

    def load(self, tell: Callable[[str], object] = logger.info) -> tuple[Problem | None, Patches]:
        """The scene, if it is one, and the patches, which may do what is asked for. ``tell`` is given a line where a
        name may mean two scenes."""
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
        """The scene, ``None`` if the source is none."""
        return None

    def notes(self) -> dict[str, Any]:
        """The request as plain values that a checkpoint keeps, files by paths that hold in any folder; nothing if the
        source lies in memory, so that it could not be found again."""
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
    """The same without types of NumPy, which JSON does not know."""
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
    """A solution, and what is to be seen of it."""

    solver: str = "conjugate-gradient"
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
        return self.solver not in ON_SEGMENTS

    def _check_outputs(self) -> None:
        _check_name("solver", self.solver, SOLVERS)
        self.outputs.check(self.wording)
        if self.bundles == 1:
            self.outputs.check_errors(None, self.wording)

    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """See :class:`LinesRequest`; raises :class:`SceneError` if there is no light."""
        if not (patches.emission.any() or patches.sky.any()):
            raise SceneError(self._without_light(problem))
        if self.solver == "direct":
            check_direct(len(patches))
        self.outputs.check_source(patches, problem, self.wording)

    def problem(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """See :class:`LinesRequest`. It is seen by the sensor that pictures are to be of."""
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


def asked_before(saved: Checkpoint, *, source: Any = None, output: Path | None = None, **changes: Any) -> LinesRequest:
    """The request that a checkpoint of lines was made for, with another ``source`` and ``output`` where they are given.

    Raises :class:`CheckpointError` if it does not say, and what making a request raises.
    """
    kinds: dict[str, Any] = {kind.work: kind for kind in (FormFactorRequest, RadiosityRequest)}
    try:
        known = dict(saved.notes[_NOTE])
        kind = kinds[known.pop("work")]
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
            f"the checkpoint does not say what was asked for ({describe(error)}); cast the lines anew"
        ) from None


def _check_name(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise OptionError(f"there is no {what} '{name}'; {suggest(name, known)}")
