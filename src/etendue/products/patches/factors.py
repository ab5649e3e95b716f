"""Form factors of patches, and their files."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from etendue.core import Array, OptionError, Settings, seed_key, suggest
from etendue.engine import Budget, Job, RunResult, Task, silent
from etendue.lighting import SkyPatches, compass
from etendue.points import OwenSobol
from etendue.radiosity import (
    ESTIMATORS,
    EXACT_TOLERANCE,
    Correction,
    FormFactors,
    HierarchicalCasting,
    LineCasting,
    PartialSegments,
    PatchProblem,
    PatchSource,
    between_groups,
    check_factors,
    check_threshold,
    corrected,
    entry_bytes,
    exact_form_factors,
    factor_format,
    form_factors,
    group_index,
    joined_rows,
    joined_zones,
    local_form_factors,
    no_factors,
    partial_form_factors,
    read_form_factors,
    read_notes,
    save_form_factors,
    sky_parts,
    split_for,
)
from etendue.surfaces import Patches, RayScene, zone_names, zone_parts

from ..files import Writing, about
from ..results import FormFactorResult
from .base import PatchProduct

#: Name of the digest of patches in the metadata of rows.
_PATCHES = "patches"
#: Metadata that each zone of a building has of its own.
_OF_ZONE = ("estimator", "seed", "bundles", "rays")
#: Formats that say which rows are known.
_OF_ROWS = (".npz", ".nc")
#: Bundles for each patch of the sky, at least, unless a budget is given; rounded up to a power of two.
_BUNDLES_PER_PATCH = 16


@dataclass(kw_only=True)
class FormFactorProduct(PatchProduct[FormFactorResult]):
    """Form factors by an ``estimator``, see :func:`etendue.radiosity.estimate`, and their ``outputs``; ``row_sums``,
    ``reciprocal`` and ``threshold`` are corrections, see :func:`etendue.radiosity.corrected`. ``groups``: files have
    the factors between groups, see :func:`etendue.radiosity.between_groups`. ``up``: the axis that is up; the ground is
    then apart from the sky, in ``sky_patches`` = m times 144 m + 1 patches if these are asked for, see
    :func:`etendue.radiosity.sky_parts`."""

    kind: ClassVar[str] = "form factors"
    goal: ClassVar[Literal["rows", "irradiance"]] = "rows"

    estimator: str = "F1"
    row_sums: bool = False
    reciprocal: bool = False
    threshold: float = 0.0
    groups: bool = False
    up: str | None = None
    north: float = 0.0
    sky_patches: int | None = None
    outputs: tuple[Path, ...] = ()
    tolerance: float | None = None  #: of form factors by integrals
    rays: int | None = None  #: of each patch, for form factors by rays
    rows: tuple[str, ...] = ()  #: files whose patches alone send rays
    seed: int = 0  #: of rays
    tell: Callable[[str], object] = silent  #: receives what is chosen
    #: Computes those of a zone, if there are several; surfaces of different zones see nothing of each other.
    of_zone: Callable[[Patches], FormFactorResult] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.estimator not in ESTIMATORS:
            raise OptionError(f"there is no estimator '{self.estimator}'; {suggest(self.estimator, ESTIMATORS)}")
        check_threshold(self.threshold)
        if self.sky_patches is not None:
            self.up = self.up or "z"
            self._sky = SkyPatches(self.sky_patches)
        elif self.north:
            raise OptionError("north has an effect on patches of the sky only: give sky_patches, or leave it out")
        if self.up is not None:
            compass(self.up, self.north)
        for path in self.outputs:
            if self.rows and factor_format(path).name not in _OF_ROWS:
                raise OptionError(
                    f"'{path}' has no place for rows that are not known: write {' or '.join(_OF_ROWS)} for each tile, "
                    "and join them (etendue join-factors)"
                )
            factor_format(path)
        if self.rows and (self.row_sums or self.reciprocal or self.groups):
            raise OptionError("groups and corrections but the threshold need all rows: etendue join-factors has them")

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`Product`."""
        return self.outputs

    @property
    def entry_bytes(self) -> float:
        """See :class:`PatchProduct`."""
        return entry_bytes(self.estimator)

    def check(self, problem: PatchProblem) -> None:
        """See :class:`Product`."""
        rows = no_factors(problem.patches)
        for path in self.outputs:
            check_factors(path, between_groups(rows) if self.groups else rows)

    def notes(self) -> dict[str, Any]:
        """See :class:`Product`."""
        known = {
            "estimator": self.estimator,
            **self._asked,
            "groups": self.groups,
            **self._outside,
            "outputs": [str(path.absolute()) for path in self.outputs],
        }
        return {"product": {"kind": self.kind, **known}}

    @property
    def _asked(self) -> dict[str, Any]:
        """The corrections that are asked for."""
        named = {name: getattr(self, name) for name in ("row_sums", "reciprocal", "threshold")}
        return {name: value for name, value in named.items() if value}

    @property
    def _outside(self) -> dict[str, Any]:
        """What is asked for of the outside of the scene."""
        named = {"up": self.up, "north": self.north or None, "sky_patches": self.sky_patches}
        return {name: value for name, value in named.items() if value is not None}

    def default_budget(self, task: Task, problem: PatchProblem) -> Budget:
        """See :class:`PatchProduct`; with patches of the sky, some bundles for each."""
        usual = super().default_budget(task, problem)
        return usual if self.sky_patches is None else with_sky_patches(usual, self._sky)

    def _to_error(self, error: float, problem: PatchProblem, given: dict[str, Any]) -> dict[str, Any]:
        """See :class:`PatchProduct`: the error of rows is known from the number of lines, which are split well instead.
        Patches of the sky need directions, and replicates are short."""
        if self.sky_patches is not None or {"lines", "directions", "replicates"} & given.keys():
            return {}
        if (split := split_for(problem.patches, error)) is None:
            return {}
        self.tell(f"error {error:g}: {split}")
        return {"lines": split.lines, "directions": split.bundles}

    def _corrected(self, factors: FormFactors) -> tuple[FormFactors, Correction | None]:
        if not self._asked:
            return factors, None
        made = corrected(factors, **self._asked)
        return made.factors, made

    def _casting(self, task: Task, kind: Any, settings: Settings, problem: PatchProblem, **own: Any) -> LineCasting:
        if issubclass(kind, HierarchicalCasting):
            source: Any = task.source
            return HierarchicalCasting(source.objects_of(problem.patches), settings, **own)  # type: ignore[arg-type]
        return super()._casting(task, kind, settings, problem, **own, directed=self.up is not None)

    def _make(self, job: Job, run: RunResult, writing: Writing, tell: Callable[[str], object]) -> FormFactorResult:
        bundles, segments = self._counted(job, run, tell)
        make: Any = partial_form_factors if isinstance(segments, PartialSegments) else form_factors
        found = make(segments, self.estimator)
        if self.up is not None:
            found = sky_parts(found, segments, self.up, self.north, self.sky_patches)
        factors, correction = self._corrected(found)
        known = self._metadata(job, bundles=bundles, estimator=self.estimator, **self._asked, **self._outside)
        patches = job.problem.patches
        groups = self._write(writing, 1 - patches.reflectance[:, 0], factors, known)
        return FormFactorResult(
            patches=patches,
            factors=factors,
            correction=correction,
            groups=groups,
            segments=segments,
            bundles=bundles,
            metadata=known,
            stopped_by=str(run.stopped_by),
            elapsed=run.elapsed,
        )

    def at_once(
        self, source: PatchSource, tell: Callable[[str], object] = silent, on_patches: Callable[[Any], object] = silent
    ) -> FormFactorResult:
        """Form factors by integrals, or by rays from patches, instead of lines; or of several zones."""
        problem = source.open(tell)
        self.check(problem)
        on_patches(problem.patches)
        if self.of_zone is not None:
            return self._zones(problem, self.of_zone, tell)
        begin, how = time.perf_counter(), "exact" if self.rays is None else "rays"
        factors, correction = self._corrected(self._computed(problem.patches, tell))
        elapsed, writing = time.perf_counter() - begin, Writing()
        known = about(problem.source, estimator=how, **self._asked)
        if self.rays is not None:
            known |= {"rays": self.rays, "seed": self.seed, _PATCHES: problem.fingerprint}
        groups = self._write(writing, 1 - problem.patches.reflectance[:, 0], factors, known)
        writing.finish()
        return FormFactorResult(
            patches=problem.patches,
            factors=factors,
            correction=correction,
            groups=groups,
            metadata=known,
            stopped_by=how,
            elapsed=elapsed,
        )

    def _zones(
        self, problem: PatchProblem, of_zone: Callable[[Patches], FormFactorResult], tell: Callable[[str], object]
    ) -> FormFactorResult:
        """Form factors of each zone in turn, as one matrix."""
        begin, writing, patches = time.perf_counter(), Writing(), problem.patches
        names, found, parts = zone_names(patches), {}, []
        for name, part, ours in zone_parts(patches):
            tell(f"zone {names.index(name) + 1} of {len(names)}, '{name}'")
            found[name] = of_zone(part)
            parts.append((found[name].factors, ours))
        factors = joined_zones(patches, parts)
        how = {name: {k: v for k, v in made.metadata.items() if k in _OF_ZONE} for name, made in found.items()}
        known = about(problem.source, zones=how, **self._asked, **self._outside)
        groups = self._write(writing, 1 - patches.reflectance[:, 0], factors, known)
        writing.finish()
        return FormFactorResult(
            patches=patches,
            factors=factors,
            groups=groups,
            zones=found,
            metadata=known,
            bundles=max(made.bundles for made in found.values()),
            stopped_by=next((made.stopped_by for made in found.values() if made.stopped_by != "exact"), "exact"),
            elapsed=time.perf_counter() - begin,
        )

    def _computed(self, patches: Patches, tell: Callable[[str], object]) -> FormFactors:
        if self.rays is None:
            return exact_form_factors(patches, self.tolerance or EXACT_TOLERANCE, tell)
        rows = np.flatnonzero(patches.of_files(self.rows)) if self.rows else None
        points = OwenSobol(4, seed=seed_key(self.seed, "local rays", 0)[0])
        return local_form_factors(RayScene(patches), self.rays, rows=rows, points=points, tell=tell)

    def joined(self, paths: Sequence[Path]) -> tuple[FormFactors, Correction | None]:
        """The form factors of all patches from files of the rows of some, see :func:`etendue.radiosity.joined_rows`,
        corrected, and written to the files of this product."""
        whole = joined_rows([read_form_factors(path) for path in paths], list(map(str, paths)))
        notes = [read_notes(path) for path in paths]
        for path, (_, known) in zip(paths, notes, strict=True):
            if known.get(_PATCHES) != notes[0][1].get(_PATCHES):
                raise OptionError(
                    f"'{path}' and '{paths[0]}' are of other patches: name the same files in the same order in each run"
                )
        for path in self.outputs:
            check_factors(path, between_groups(whole) if self.groups else whole)
        factors, correction = self._corrected(whole)
        writing = Writing()
        self._write(writing, notes[0][0], factors, about(", ".join(map(str, paths)), **self._asked))
        writing.finish()
        return factors, correction

    def _write(
        self, writing: Writing, emissivity: Array, factors: FormFactors, known: dict[str, Any]
    ) -> FormFactors | None:
        """Write the files; returns the factors between groups, if these are asked for."""
        groups = None
        if self.groups:
            groups, (names, group) = between_groups(factors), group_index(factors)
            emitted = np.bincount(group, factors.areas * emissivity, len(names))
            emissivity = emitted / np.where(groups.areas > 0, groups.areas, 1.0)
        for path in self.outputs:
            with writing.attempt(f"write '{path}'"):
                save_form_factors(path, groups or factors, emissivity=emissivity, metadata=known)
        return groups


def with_sky_patches(usual: Budget, sky: SkyPatches) -> Budget:
    """A budget of bundles with some for each patch of the sky."""
    least = 1 << (_BUNDLES_PER_PATCH * sky.count - 1).bit_length()
    return Budget(samples=max(usual.samples or 0, least))
