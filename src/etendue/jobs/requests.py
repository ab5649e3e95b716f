"""Requests for form factors and solutions. Making a request checks all that can be checked before files are read."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from etendue.core import (
    CheckpointError,
    OptionError,
    SceneError,
    describe,
    is_whole,
    logger,
    suggest,
)
from etendue.engine import Checkpoint
from etendue.radiosity import (
    AMBIENT_TERMS,
    ESTIMATORS,
    FORM_FACTOR_FILES,
    SOLVERS,
    Patches,
    check_direct,
    check_file,
    check_text_size,
)
from etendue.scene import Problem, load, locate

from .hierarchies import HIERARCHY_OPTIONS, HierarchyOptions
from .linesrequest import NOTE, LinesRequest
from .results import DEFAULT_POINTS
from .solutions import SolutionOutputs

#: The solver that needs neither stored segments nor a matrix.
MULTIPATH = "multipath"
#: Solvers that work on segments; the others, except multipath, need the matrix.
ON_SEGMENTS = ("jacobi", "conjugate-gradient")


@dataclass(frozen=True, kw_only=True)
class FormFactorRequest(HierarchyOptions, LinesRequest):
    """Form factors of patches."""

    #: ``None`` for F1, or F4 with a hierarchy.
    estimator: str | None = None
    outputs: tuple[Path, ...] = ()

    work: ClassVar[str] = "form-factors"

    @property
    def chosen_estimator(self) -> str:
        """The requested estimator, or the default."""
        return self.estimator or ("F1" if self.hierarchy is None else "F4")

    def _check_options(self) -> None:
        super()._check_options()
        self._check_hierarchy(self.wording, self.is_mesh)
        if self.names_an_array:
            object.__setattr__(self, "mesh", {**self.mesh, "objects": self.hierarchy})

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`LinesRequest`."""
        return self.outputs

    @property
    def needs_matrix(self) -> bool:
        """See :class:`LinesRequest`."""
        return True

    def _check_outputs(self) -> None:
        _check_name("estimator", self.chosen_estimator, ESTIMATORS)
        for path in self.outputs:
            check_file(path, FORM_FACTOR_FILES)

    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """See :class:`LinesRequest`."""
        for path in self.outputs:
            if path.suffix.lower() == ".vf":
                check_text_size(path, len(patches), 0)

    def _noted(self) -> tuple[str, ...]:
        own = ("estimator", "hierarchy", *HIERARCHY_OPTIONS)
        return (*super()._noted(), *(name for name in own if getattr(self, name) is not None))

    def _noted_outputs(self) -> dict[str, Any]:
        return {"outputs": [str(path.absolute()) for path in self.outputs]}


@dataclass(frozen=True, kw_only=True)
class RadiosityRequest(LinesRequest):
    """A solution, and the files made from it. ``points`` limits multipath as ``bundles`` limits other solvers."""

    solver: str = "conjugate-gradient"
    points: int | None = None
    shot: bool = True  #: send the light of small emitters by local rays first
    #: Ambient term for all light, without lines; or for what is left after so many ``bounces`` (iterations).
    ambient: str | None = None
    bounces: int | None = None
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
        self._check_ambient()
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

    @property
    def is_instant(self) -> bool:
        """Whether all light is ambient, so that no lines are cast."""
        return self.ambient is not None and self.bounces is None

    def _check_ambient(self) -> None:
        option = self.wording.option
        if self.solver == MULTIPATH and (self.ambient, self.bounces) != (None, None):
            given = option("bounces" if self.ambient is None else "ambient")
            raise OptionError(f"multipath makes no iterations and leaves little light: leave out {given}")
        if self.bounces is not None:
            if not is_whole(self.bounces) or self.bounces < 1:
                raise OptionError(f"{option('bounces')} is a whole number of at least 1, not {self.bounces!r}")
            if self.ambient is None:
                raise OptionError(f"{option('bounces')} leaves light over: say by {option('ambient')} how to spread it")
        if self.ambient is not None:
            _check_name("ambient term", self.ambient, AMBIENT_TERMS)
        if not self.is_instant:
            return
        asked: dict[str, Any] = {
            name: getattr(self, name) for name in ("seconds", "bundles", "points", "error", "checkpoint")
        }
        asked |= {name: None if getattr(self, name) else False for name in ("shot", "local_rays")}
        asked["solver"] = None if self.solver == RadiosityRequest.solver else self.solver
        for name in (name for name, value in asked.items() if value is not None):
            raise OptionError(
                f"an ambient solution needs no lines: leave out {option(name)}, or give {option('bounces')} for a "
                "solution by lines that ends in an ambient term"
            )
        self.outputs.check_errors(None, self.wording)

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
        return (*super()._noted(), "solver", "shot", "ambient", "bounces")

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
        known = dict(saved.notes[NOTE])
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
