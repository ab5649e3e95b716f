"""Casting of lines in passes, for what drives methods: budgets, progress, checkpoints, stops."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from etendue.core import (
    Array,
    Carrying,
    CheckpointError,
    Iterations,
    Measurement,
    Result,
    State,
    free_memory,
    logger,
    seed_key,
    setting,
)
from etendue.core import Settings as AnySettings
from etendue.points import OwenSobol
from etendue.surfaces import Patches, RayScene

from .errors import RadiosityError
from .lines.abuffer import LINES_PER_PATCH, ABuffer
from .lines.engine import LineEngine, warn_of_faults
from .lines.local import LocalRays
from .lines.mixing import local_rays, with_local_rays
from .lines.replicates import Replicates
from .lines.segments import Pairs, Segments, scatter
from .lines.spiral import SpiralPoints
from .solvers.shot import FirstShot, Shot, small_emitters
from .solvers.system import solve

#: Rays of a first shot for each segment: they take half as long as casting it, and half the error is left to the lines.
RAYS_PER_SEGMENT = 1 / 4
#: Batches of segments, whose scatter tells errors.
_BATCHES = 16
#: Sequences of lines for runs to an error. With four, runs with few patches end at 1.2 times that error.
REPLICATES = 8
#: Segments up to which an estimate of the error solves the system anew.
_FEW_SEGMENTS = 1 << 20
#: Least points before an error is estimated: two batches would do, but tell little.
_LEAST_PIECES = 16
#: Sums over all segments that count them and find the error of a solution, and the residual of a solution.
_COUNTING, _RESIDUAL = 3, 1e-6
#: Seconds that a local ray takes until it is counted, and that it takes to see whether a segment needs a weight for it.
_RAY_SECONDS, _LOOK_SECONDS = 3e-7, 1e-8
#: Chunks that are summed to see how long that takes.
_TIMED = 64
#: Local rays of a bundle, at least.
_FEWEST_RAYS = 8192
#: "No end" of a stream, and bundles whose pieces are those of a step.
_ENDLESS, _USUAL = 1 << 31, 1024


@dataclass(frozen=True, kw_only=True)
class CastingSettings(AnySettings):
    """What of casting decides the lines."""

    lines: float = setting(0.0, "lines of a bundle through the bounding sphere, 0 for the engine's choice", minimum=0)
    shot: bool = setting(True, "send the light of small emitters by local rays")
    local_rays: bool = setting(True, "cast local rays from patches that few lines meet")
    replicates: int = setting(
        1, "independent sequences of lines, whose scatter tells the error; with one, it is an upper estimate", minimum=1
    )


@dataclass(frozen=True)
class PatchProblem:
    """Patches as what a job works on. ``source`` says where they are from."""

    patches: Patches
    source: str = "<patches>"

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of the geometry, the properties and the sky; the same in every process."""
        digest = hashlib.blake2b(digest_size=16)
        p = self.patches
        for array in (p.vertices, p.faces, p.front, p.back, p.labels, p.reflectance, p.emission, p.sky):
            digest.update(str((array.shape, array.dtype.str)).encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


class LineCasting(Carrying):
    """Bundles of lines through patches, a piece of a few with each :meth:`step`; implements ``core.Method``.

    What was cast is kept: :meth:`segments` and :meth:`shot` are made of it at any time, and depend on how many bundles
    there are, not on when they were cast. A sample of a budget is a bundle, and its error the *square* of the standard
    error that ``goal`` names, as noise of pictures is a variance:

    ============== ===================================================================================================
    ``irradiance`` of the irradiance that a solution on the segments has, mean over the surface in units of its mean
    ``rows``       of the row of form factors of a patch, mean over patches
    ============== ===================================================================================================

    The lines are those of one sequence, whose 16 parts scatter two to nine times as much as their mean errs: what
    ``noise`` and solutions say is then an upper estimate. To end at an error, take ``REPLICATES``: they scatter as
    their mean errs, which is two to four times as much as one sequence of as many lines does.

    settings: see :class:`CastingSettings`. most: bundles to end at, if a budget says so: the last piece may be smaller.
    """

    name: ClassVar[str] = "global-lines"
    carries_on: ClassVar[bool] = True
    Settings: ClassVar[type[AnySettings]] = CastingSettings
    citations: ClassVar[tuple[str, ...]] = ("Sbert1993", "Carpenter1984", "Castro2002")

    def __init__(
        self,
        settings: CastingSettings | None = None,
        *,
        goal: Literal["irradiance", "rows"] | None = None,
        most: int | None = None,
    ) -> None:
        self._options = settings or CastingSettings()
        self.settings: AnySettings = self._options
        self.goal, self.most = goal, most
        #: Bundles that were cast, and their segments.
        self.count, self.made = 0, 0
        self._chunks: list[Pairs] = []
        self._stream: Iterator[Pairs] | None = None
        self._shot: Shot | None = None
        self._known: tuple[Array, Array] | None = None
        # What the chunks so far add to the sums of each replicate over what is known.
        self._sums: list[tuple[Array, Array]] = []
        self._summed = 0
        # Seconds and segments of the sums that were timed, and the number of chunks at the last of them.
        self._passes, self._timed = np.zeros(2), 0

    # ------------------------------------------------------------------ the protocol of methods

    @property
    def error_cadence(self) -> float:
        """Growth of the number of passes from one estimate of the error to the next: with replicates only what is new
        has to be looked at."""
        return 1.0 if self._options.replicates == 1 else 0.1

    @property
    def samples_per_iteration(self) -> int:
        """Bundles of a step."""
        return self._size

    def prepare(self, problem: PatchProblem, seed: int) -> None:
        """Build the engine, and have its loops compiled. Raises :class:`RadiosityError` if not even one bundle fits
        into memory."""
        self._forget_states()
        self.close()
        self.count, self.made, self._chunks, self._shot = 0, 0, [], None
        self._known, self._sums, self._summed = None, [], 0
        patches = self.patches = problem.patches
        self._seed = seed
        self.engine = self._engine_for(patches)
        self._size = self.engine.piece(_USUAL)
        self._take_turns()
        if self.memory() < 1:
            raise RadiosityError(f"not even one bundle of lines through {len(patches)} patches fits into memory")
        emitters = small_emitters(patches, RAYS_PER_SEGMENT) if self._options.shot else np.zeros(len(patches), bool)
        if emitters.any():
            points = OwenSobol(4, seed=seed_key(seed, "first shot", 0)[0])
            self._shot = Shot(self._scene, points, emitters)
            self._shot.cast(1)
        for chunk in self.engine.stream(1):
            self._time_pass([chunk])  # to have it compiled
        self._passes[:] = 0

    def _step(self, iteration: int, seed: int) -> Measurement:
        """Cast the next piece. What is measured is kept here; the sums are empty."""
        if seed != self._seed:
            raise RadiosityError(f"lines of seed {seed} are cast by what was prepared with that seed, not {self._seed}")
        if self._stream is None:
            self._stream = self._pieces()
        chunk = next(self._stream)
        self._chunks.append(chunk)
        self.made += len(chunk)
        size = self.samples_per_iteration
        whole = -(-self.count // size) * size  # see _pieces
        self.count = min(whole + size, self.most or _ENDLESS)
        if self._shot is not None:
            self._shot.grow(self._shot_rays)
        if len(self._chunks) >= 2 * self._timed:
            self._timed = len(self._chunks)
            self._time_pass(self._chunks[-_TIMED:])
        return Measurement({}, {}, Iterations.single(iteration), counters={"rays": float(len(chunk))})

    def _pieces(self) -> Iterator[Pairs]:
        # An odd end is made whole by the next step, so that steps are as many as if the end had not been.
        most, count = self.most or _ENDLESS, self.count
        ahead = min(-count % self.samples_per_iteration, most - count)
        odd = list(self.engine.stream(ahead, count, ahead)) if ahead else []
        for piece in self.engine.stream(most - count - ahead, count + ahead, self._size):
            yield np.concatenate([*odd, piece]) if odd else piece
            odd = []

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture: only how much was cast."""
        return Result({}, {"bundles": state["count"], "segments": sum(map(len, state["chunks"]))})

    def _left(self) -> State:
        """All that was cast."""
        shot = None if self._shot is None else self._shot.state()
        return {"count": self.count, "size": self._size, "chunks": list(self._chunks), "shot": shot}

    def _take(self, state: State) -> None:
        if self.most is not None and state["count"] > self.most:
            raise CheckpointError(f"the checkpoint has {state['count']} bundles, more than {self.most}")
        self.close()
        # A step has the size that it had, also on a machine that would choose another.
        self.count, self._size, self._chunks = state["count"], state["size"], list(state["chunks"])
        self._take_turns()
        self.made = sum(map(len, self._chunks))
        self._known, self._sums, self._summed = None, [], 0
        if self._shot is not None and state["shot"] is not None:
            self._shot.restore(state["shot"])

    def noise(self) -> float | None:
        """Square of the standard error so far, see ``goal``; ``None`` while it is not known."""
        if self.goal is None or len(self._chunks) < _LEAST_PIECES:
            return None
        if self.goal == "rows":
            return float(np.mean(1 / np.sqrt(self.engine.expected(self.count))) ** 2)
        patches, shot = self.patches, self.shot()
        if self._known is None or self.made <= _FEW_SEGMENTS:
            solution = solve(patches, self._lines(), "conjugate-gradient", shot=shot, tolerance=1e-3)
            self._known = solution.radiosity - (0.0 if shot is None else shot.emission), solution.irradiance
            self._sums, self._summed = [], 0
        irradiance = self._known[1]
        error = self._error_of_lines(self._known[0])
        error = error if shot is None else np.hypot(error, shot.error)
        areas = patches.areas[:, None]
        light = (areas * irradiance).sum()
        return float(((areas * error).sum() / light) ** 2) if light > 0 else None

    def _error_of_lines(self, carried: Array) -> Array:
        """Standard error (n, c) of the irradiance by patches of such radiosities and the sky."""
        replicates = self._options.replicates
        if replicates == 1:
            return self._lines().gather_error(carried, self.patches.sky)
        for k in range(replicates):
            new = [i for i in range(self._summed, len(self._chunks)) if i % replicates == k]
            found = self._part([self._chunks[i] for i in new]).sums(carried, self.patches.sky)
            if k < len(self._sums):
                self._sums[k] = self._sums[k][0] + found[0], self._sums[k][1] + found[1]
            else:
                self._sums.append(found)
        self._summed = len(self._chunks)
        sums, weights = (sum(parts[1:], start=parts[0]) for parts in zip(*self._sums, strict=True))
        mean = np.divide(sums, weights[:, None], out=np.zeros_like(sums), where=weights[:, None] > 0)
        return scatter(self._sums, mean)

    # ------------------------------------------------------------------ what was cast

    @property
    def finish_seconds(self) -> float:
        """About how long it will take to make segments and a solution of what was cast; see ``core.Method``."""
        rays, few = local_rays(self.engine.expected(self.count), self.made)
        mixing = 0.0
        if self._options.local_rays and len(few):
            mixing = _RAY_SECONDS * rays * len(few) + _LOOK_SECONDS * self.made
        # What conjugate gradients leave of the error with each sum, if all patches reflected the same.
        reflectance = np.average(self.patches.reflectance, axis=0, weights=self.patches.areas).max()
        root = np.sqrt((1 + reflectance) / (1 - reflectance))
        passes = _COUNTING + (np.log(_RESIDUAL / 2) / np.log((root - 1) / (root + 1)) if root > 1 else 1)
        seconds, segments = self._passes
        return float(passes * seconds / max(segments, 1) * self.made + mixing)

    def segments(self) -> Segments:
        """Of all bundles so far, with local rays from patches that few of them meet. Warns as
        :meth:`LineEngine.cast` does."""
        segments = self._lines()
        if self._options.local_rays:
            points = OwenSobol(4, seed=seed_key(self._seed, "local rays", 0)[0])
            scene = self.__dict__.get("_scene")  # that of a shot, if there is one
            segments = with_local_rays(segments, scene, points=points)
        warn_of_faults(segments)
        return segments

    def shot(self) -> FirstShot | None:
        """The light of small emitters, by a ray for every 4 segments; ``None`` if there is none that needs it."""
        return None if self._shot is None else self._shot.cast(self._shot_rays)

    def memory(self, matrix: bool = False) -> int:
        """Bundles whose segments fit into the memory that is free now; with ``matrix`` form factors as well."""
        free, each = free_memory(), self._expected_segments(1)
        if free is None:
            return _ENDLESS
        if not matrix:
            return int(free / (8 * each))
        # As form_factors reckons: a matrix of as many entries as pairs, or a full one.
        full = 64 * len(self.patches) ** 2
        return int(max(free / ((8 + 4 + 128) * each), (free - full) / ((8 + 4) * each)))

    def close(self) -> None:
        """Cast no more: end what is being cast ahead."""
        if self._stream is not None:
            self._stream.close()  # type: ignore[attr-defined]
            self._stream = None

    @cached_property
    def _scene(self) -> RayScene:
        return RayScene(self.patches)

    @property
    def _shot_rays(self) -> float:
        return RAYS_PER_SEGMENT * self._expected_segments(self.count)

    def _time_pass(self, chunks: list[Pairs]) -> None:
        segments = self._part(chunks)
        begin = time.perf_counter()
        segments.gather(self.patches.emission)
        self._passes += time.perf_counter() - begin, len(segments)

    def _expected_segments(self, count: int) -> float:
        return float(self.engine.expected(count).sum()) / 2

    def _engine_for(self, patches: Patches) -> LineEngine:
        """Bundles of lines; or of local rays, where there would have to be too many lines."""
        if self._options.lines or ABuffer.suits(patches):
            return ABuffer(patches, SpiralPoints(self._seed), self._options.lines or None)
        logger.warning(
            "surfaces are few in a large space, where few lines meet them: local rays are cast from all patches instead"
        )
        points = OwenSobol(4, seed=seed_key(self._seed, "lines", 0)[0])
        return LocalRays(self._scene, points, max(int(LINES_PER_PATCH / 2 * len(patches)), _FEWEST_RAYS))

    def _take_turns(self) -> None:
        """Share the lines out among replicates, piece by piece."""
        if (number := self._options.replicates) > 1:
            sequences = [OwenSobol(4, seed=seed_key(self._seed, "lines", k)[0]) for k in range(number)]
            self.engine.points = Replicates(sequences, self._size * getattr(self.engine, "bundle", 1))

    def _part(self, chunks: list[Pairs]) -> Segments:
        return Segments(self.patches, chunks, np.zeros(len(chunks)), self.engine.expected(1))

    def _lines(self) -> Segments:
        order, replicates = np.arange(len(self._chunks)), self._options.replicates
        batch = order * min(_BATCHES, len(order)) // max(len(order), 1) if replicates == 1 else order % replicates
        return Segments(self.patches, self._chunks, batch, self.engine.expected(self.count))
