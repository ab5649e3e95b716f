"""Line casting in passes, as a method of the engine."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from etendue.core import (
    Array,
    CheckpointError,
    Iterations,
    Measurement,
    Method,
    Pass,
    Record,
    Result,
    Settings as AnySettings,
    State,
    Weight,
    free_memory,
    logger,
    seed_key,
    setting,
)
from etendue.points import OwenSobol
from etendue.surfaces import Patches, RayScene

from .error_estimate import IrradianceError
from .errors import RadiosityError
from .factors.counting import MatrixRoom
from .lines.abuffer import LINES_PER_PATCH, ABuffer
from .lines.engine import LineEngine, warn_of_faults
from .lines.local import LocalRays
from .lines.mixing import local_rays, with_local_rays
from .lines.replicates import Replicates
from .lines.segments import Directed, Pairs, Segments
from .lines.spiral import SpiralPoints
from .problem import PatchProblem
from .solvers.shot import SEQUENCES, FirstShot, Shot, ShotSums, small_emitters

#: Rays of a first shot per segment. They take half the time of casting; half of the error then comes from the lines.
RAYS_PER_SEGMENT = 1 / 4
#: Batches of segments, whose variance gives errors.
_BATCHES = 16
#: Sequences of lines for runs to an error. With four, runs with few patches ended at 1.2 times that error.
REPLICATES = 8
#: Smallest number of passes from which an error is estimated; two would suffice, with a large variance.
_LEAST_PASSES = 16
#: Number of sums over all segments for counts and for the error of a solution; tolerance of a solution's residual.
_COUNTING, _RESIDUAL = 3, 1e-6
#: Seconds per local ray, and seconds per segment to find the segments that need a weight because of local rays.
_RAY_SECONDS, _LOOK_SECONDS = 3e-7, 1e-8
#: Number of passes whose segments are summed to measure the time of a sum; smallest number of local rays of a bundle.
_TIMED, _FEWEST_RAYS = 64, 8192
#: Number of bundles of an unlimited stream, and the number for which the size of a pass is chosen.
_ENDLESS, _USUAL = 1 << 31, 1024
#: Size of a segment, two patch indices, and of the direction of a bundle or ray.
_SEGMENT_BYTES, _WAY_BYTES = 8, 32
#: Names in a measurement: the records of segments and of their directions, the counter of bundles, the sums of the
#: first shot by sequence.
SEGMENTS, _DIRECTIONS, _BUNDLES, _SHOT = "segments", "directions", "bundles", "shot"


@dataclass(frozen=True, kw_only=True)
class CastingSettings(AnySettings):
    """Settings that determine the lines."""

    lines: float = setting(0.0, "lines of a bundle through the bounding sphere, 0 for the engine's choice", minimum=0)
    shot: bool = setting(True, "send the light of small emitters by local rays")
    local_rays: bool = setting(True, "cast local rays from patches that few lines meet")
    replicates: int = setting(
        1, "independent sequences of lines, whose variance gives the error; with one, an upper estimate", minimum=1
    )
    bundles_per_pass: int = setting(0, "bundles of a pass, 0 for the engine's choice", minimum=0)
    directions: int = setting(0, "bundles of a spiral, after which another begins; 0 for 1024", minimum=0)


class LineCasting(Method):
    """Bundles of lines through all patches, which are stored and solved.

    A measurement holds the segments of its passes as a record, the number of bundles, and sums of the first shot.
    Passes are independent: the results of :meth:`segments` and :meth:`shot` depend only on the passes of a
    measurement, not on their order or machine. A sample of a budget is a bundle. Its error is the *square* of the
    standard error of ``goal``, as the noise of pictures is a variance:

    ============== ===================================================================================================
    ``irradiance`` the irradiance of a solution on the segments, averaged over the surface, relative to its mean
    ``rows``       a row of form factors, averaged over patches
    ============== ===================================================================================================

    By default all lines are of one sequence. The standard error from the variance of its 16 parts is then two to nine
    times the error of their mean: ``noise`` and the errors of solutions are upper estimates. For runs to an error use
    ``REPLICATES`` sequences. Their variance is that of their mean, but the error is two to four times that of one
    sequence with as many lines.

    settings: see :class:`CastingSettings`. most: the number of bundles at which the budget ends; the last pass may have
    fewer bundles than the others. directed: keep the directions of lines, for :meth:`Segments.sky_counts`.
    :meth:`go_on` continues a measurement whose last pass is incomplete.
    """

    name: ClassVar[str] = "lines"
    counts: ClassVar[str] = "bundles"
    Settings: ClassVar[type[AnySettings]] = CastingSettings
    has_fast_noise: ClassVar[bool] = False
    citations: ClassVar[tuple[str, ...]] = ("Sbert1993", "Carpenter1984", "Castro2002")

    def __init__(
        self,
        settings: CastingSettings | None = None,
        *,
        goal: Literal["irradiance", "rows"] | None = None,
        most: int | None = None,
        directed: bool = False,
    ) -> None:
        self._options = self._given = settings or CastingSettings()
        #: Including the number of bundles per pass once :meth:`prepare` has chosen it, since it determines the passes.
        self.settings: AnySettings = self._options
        self.goal, self.most, self.directed = goal, most, directed
        self._shot: Shot | None = None
        self._lamps: FirstShot | None = None
        self._stream: _Stream | None = None
        #: First index and number of the bundles that an incomplete pass has left out; the next pass casts them.
        self.owed = 0, 0
        # Seconds and segments of the timed sums, and the number of passes at the last of them.
        self._timing, self._timed = np.zeros(2), 0

    # ------------------------------------------------------------------ the protocol of methods

    @property
    def error_cadence(self) -> float:
        """See ``core.Method``: with replicates an estimate only reads the segments of new passes, for rows none."""
        if self.goal == "rows":
            return 0.0
        return 1.0 if self._options.replicates == 1 else 0.1

    @property
    def samples_per_iteration(self) -> int:
        """Bundles of a pass."""
        return self._options.bundles_per_pass

    def prepare(self, problem: PatchProblem, seed: int) -> None:
        """Build the engine and compile its loops. Raises :class:`RadiosityError` if not one bundle fits into memory."""
        self.close()
        self._shot, self.owed = None, (0, 0)
        patches = self.patches = problem.patches
        self._lamps = problem.lamps
        self._error = IrradianceError(patches, self._options.replicates)
        self._seed = seed
        self.engine = self._engine_for(patches)
        size = self._given.bundles_per_pass or self.engine.piece(min(self.most or _USUAL, _USUAL))
        self._options = self.settings = self._given.replace(bundles_per_pass=size)
        self._take_turns()
        if self.memory() < 1:
            raise RadiosityError(f"not even one bundle of lines through {len(patches)} patches fits into memory")
        # A shot aims at patches of one period, not at their repetitions.
        shoots = self._options.shot and patches.period is None
        emitters = small_emitters(patches, RAYS_PER_SEGMENT) if shoots else np.zeros(len(patches), bool)
        if emitters.any():
            points = OwenSobol(4, seed=seed_key(seed, "first shot", 0)[0])
            self._shot = Shot(self._scene, points, emitters)
            self._shot.light(0, 1)  # compiles
        for chunk in self.engine.stream(1):
            self._time_sums([chunk])  # compiles
        self._timing[:], self._timed = 0, 0

    def go_on(self, measurement: Measurement) -> None:
        """Prepare for the passes after ``measurement``. If its last pass is incomplete, the next pass also casts the
        missing bundles (with replicates, as many others). Raises :class:`CheckpointError` for more than ``most``."""
        self.close()
        done = self.bundles(measurement)
        if self.most is not None and done > self.most:
            raise CheckpointError(f"the checkpoint has {done} bundles, more than {self.most}")
        passes, size = measurement.iterations, self.samples_per_iteration
        is_whole = passes.next_iteration() == len(passes)  # false if a run on a cluster has skipped passes
        self.owed = (done, size * len(passes) - done) if is_whole else (0, 0)

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """Cast the bundles of a pass and its share of the first shot."""
        if seed != self._seed:
            raise RadiosityError(f"the method was prepared with seed {self._seed}, not {seed}: prepare it again")
        size = self.samples_per_iteration
        first, end = iteration * size, min((iteration + 1) * size, self.most or _ENDLESS)
        chunks = [self._cast(iteration)] if first < end else []
        owed, left_out = self.owed
        left = min(left_out, (self.most or _ENDLESS) - owed)
        if left > 0 and owed + left_out == first:
            engine = self.engine
            if self._options.replicates > 1:  # those of an earlier replicate must not count for this one
                engine = engine.with_points(OwenSobol(4, seed=seed_key(self._seed, "owed lines", iteration)[0]))
            chunks = [*_directed(engine, self.directed, left, owed, left), *chunks]
            first, end = owed, max(owed + left, end)
        if not chunks:
            raise RadiosityError(f"pass {iteration} has no lines: the limit is {self.most} bundles")
        chunk = np.concatenate([made.pairs for made in chunks])
        records = {SEGMENTS: Record.single(chunk, iteration)}
        if self.directed:
            records[_DIRECTIONS] = Record.single(np.concatenate([made.ways for made in chunks]), iteration)
        sums: dict[str, Array] = {}
        weights: dict[str, Weight] = {}
        if self._shot is not None:
            begin, stop = self._shot_blocks(first), self._shot_blocks(end)
            light = self._shot.light(begin, stop - begin)
            for k, (received, blocks) in enumerate(zip(light.received, light.blocks, strict=True)):
                sums[f"{_SHOT}/{k}"], weights[f"{_SHOT}/{k}"] = received, float(blocks)
        measurement = Measurement(
            sums,
            weights,
            Iterations.single(iteration),
            counters={"rays": float(len(chunk)), _BUNDLES: float(end - first)},
            records=records,
        )
        return Pass(measurement, state)

    def develop(self, measurement: Measurement, state: State) -> Result:
        """No picture, only the numbers of bundles and segments."""
        return Result({}, {"bundles": self.bundles(measurement), "segments": len(measurement.records[SEGMENTS])})

    def noise(self, measurement: Measurement) -> float | None:
        """Square of the standard error of ``goal``; ``None`` for fewer than 16 passes, and without a goal."""
        record = measurement.records[SEGMENTS]
        if self.goal is None or len(record.passes) < _LEAST_PASSES:
            return None
        if self.goal == "rows":
            expected = self.engine.expected(self.bundles(measurement))
            return float(np.mean(1 / np.sqrt(expected[~self.patches.empty])) ** 2)
        return self._error.square(record, lambda: self._lines(measurement), self.shot(measurement))

    def finish_seconds(self, measurement: Measurement) -> float:
        """Estimated seconds to compute segments and a solution from ``measurement``; see ``core.Method``."""
        record = measurement.records[SEGMENTS]
        made, passes = len(record), record.passes
        if len(passes) >= 2 * self._timed:
            self._timed = len(passes)
            self._time_sums([record[key] for key in passes[-_TIMED:]])
        rays, few = local_rays(self.engine.expected(self.bundles(measurement)), made)
        mixing = 0.0
        if self._options.local_rays and len(few):
            mixing = _RAY_SECONDS * rays * len(few) + _LOOK_SECONDS * made
        # Convergence rate of conjugate gradients if all patches had the same reflectance.
        reflectance = np.average(self.patches.reflectance, axis=0, weights=self.patches.areas).max()
        root = np.sqrt((1 + reflectance) / max(1 - reflectance, 1e-4))
        sums = _COUNTING + (np.log(_RESIDUAL / 2) / np.log((root - 1) / (root + 1)) if root > 1 else 1)
        seconds, segments = self._timing
        return float(sums * seconds / max(segments, 1) * made + mixing)

    # ------------------------------------------------------------------ results

    def bundles(self, measurement: Measurement) -> int:
        """Number of bundles that were cast."""
        return int(measurement.counters[_BUNDLES])

    def segments(self, measurement: Measurement) -> Segments:
        """The segments of all bundles, with local rays from patches that few lines meet. Warns as
        :meth:`LineEngine.cast` does."""
        segments = self._lines(measurement)
        if self._options.local_rays:
            points = OwenSobol(4, seed=seed_key(self._seed, "local rays", 0)[0])
            scene = self.__dict__.get("_scene")  # the scene of the shot, if one was built
            segments = with_local_rays(segments, scene, points=points)
        warn_of_faults(segments)
        return segments

    def shot(self, measurement: Measurement) -> FirstShot | None:
        """The light of small emitters, with a ray for every 4 segments, and that of lamps that are no patches; ``None``
        if there are none. Rays that were too few to fill the device in the passes are cast now."""
        if self._shot is None:
            return self._lamps
        names = [f"{_SHOT}/{k}" for k in range(SEQUENCES)]
        received = np.stack([measurement.sums[name] for name in names])
        known = ShotSums(received, np.array([measurement.weights[name] for name in names]))
        first = self._shot_blocks(self.bundles(measurement))
        missing = self._shot.blocks(self._shot_rays(self.bundles(measurement))) - int(known.blocks.sum())
        shot = self._shot.result(known + self._shot.light(first, max(missing, 0)))
        return shot if self._lamps is None else shot + self._lamps

    def memory(self, matrix: float = 0.0, in_files: bool = False, wanted: int = _ENDLESS) -> int:
        """Number of bundles whose segments fit into the free memory.

        matrix: form factors of so many bytes each must fit as well; if it is uncertain whether those of ``wanted``
        bundles do, some bundles are cast to see how the number of form factors grows. in_files: segments are in the
        files of a record and take no memory.
        """
        free, each = free_memory(), float(self.engine.expected(1).sum()) / 2
        stored = 0 if in_files else self._bytes
        if free is None or not (matrix or stored):
            return _ENDLESS
        if not matrix:
            return int(free / (stored * each))
        room = MatrixRoom(free, len(self.patches), each, stored, matrix)
        most = room.most(_ENDLESS)
        return most if most >= wanted else room.with_pilot(self._pilot).most(_ENDLESS)

    @property
    def bytes_per_bundle(self) -> float:
        """Expected size of the segments of a bundle."""
        return self._bytes * float(self.engine.expected(1).sum()) / 2

    def attributes_for_workers(self) -> dict[str, Any]:
        """See ``core.Method``."""
        return {"most": self.most, "owed": self.owed, "directed": self.directed}

    def close(self) -> None:
        """End the casting, including lines that are cast ahead."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    # ------------------------------------------------------------------ internals

    @property
    def _bytes(self) -> int:
        """Size of a stored segment; each ray has its own direction, bundles have few."""
        return _SEGMENT_BYTES + (_WAY_BYTES if self.directed and self.engine.bundles is None else 0)

    @cached_property
    def _scene(self) -> RayScene:
        return RayScene(self.patches)

    def _pilot(self, first: int, count: int) -> Iterator[Pairs]:
        """Segments between patches, the sky and dark."""
        return self.engine.stream(count, first)

    def _cast(self, iteration: int) -> Directed:
        """The segments of a pass. Consecutive passes share a stream, in which engines cast ahead."""
        if self._stream is None or self._stream.next_pass != iteration:
            self.close()
            first = iteration * self.samples_per_iteration
            count = (self.most or _ENDLESS) - first
            made = _directed(self.engine, self.directed, count, first, self.samples_per_iteration)
            self._stream = _Stream(made, iteration)
        try:
            return self._stream.take()
        except BaseException:
            self._stream = None
            raise

    def _shot_rays(self, bundles: int) -> float:
        return RAYS_PER_SEGMENT * float(self.engine.expected(bundles).sum()) / 2

    def _shot_blocks(self, bundles: int) -> int:
        """Blocks of the shot for so many bundles, as a multiple of the blocks that fill the device."""
        assert self._shot is not None
        at_once = self._shot.at_once
        return self._shot.blocks(self._shot_rays(bundles)) // at_once * at_once if bundles else 0

    def _time_sums(self, chunks: Sequence[Pairs]) -> None:
        segments = self._part(chunks)
        begin = time.perf_counter()
        segments.gather(self.patches.emission)
        self._timing += time.perf_counter() - begin, len(segments)

    def _engine_for(self, patches: Patches) -> LineEngine:
        """An engine of bundles, or of local rays if the scene would need too many lines."""
        if self._options.lines or ABuffer.suits(patches):
            spiral = SpiralPoints(self._seed, self._options.directions or _USUAL)
            return ABuffer(patches, spiral, self._options.lines or None)
        logger.warning(
            "surfaces are few in a large space, where few lines meet them: local rays are cast from all patches instead"
        )
        points = OwenSobol(4, seed=seed_key(self._seed, "lines", 0)[0])
        return LocalRays(self._scene, points, max(int(LINES_PER_PATCH / 2 * len(patches)), _FEWEST_RAYS))

    def _take_turns(self) -> None:
        """Distribute the passes over the replicates."""
        if (number := self._options.replicates) > 1:
            sequences = [OwenSobol(4, seed=seed_key(self._seed, "lines", k)[0]) for k in range(number)]
            run = self.samples_per_iteration * getattr(self.engine, "bundle", 1)
            self.engine.points = Replicates(sequences, run)

    def _part(self, chunks: Sequence[Pairs]) -> Segments:
        return Segments(self.patches, chunks, np.zeros(len(chunks)), self.engine.expected(1))

    def _lines(self, measurement: Measurement) -> Segments:
        record, replicates = measurement.records[SEGMENTS], self._options.replicates
        iterations = np.array([iteration for _, iteration in record.passes])
        order, batches = np.arange(len(iterations)), min(_BATCHES, len(iterations))
        batch = order * batches // len(order) if replicates == 1 else iterations % replicates
        ways = list(measurement.records[_DIRECTIONS]) if _DIRECTIONS in measurement.records else None
        expected, are_even = self.engine.expected(self.bundles(measurement)), self.engine.bundles is not None
        return Segments(self.patches, list(record), batch, expected, ways, are_even)


def _directed(engine: LineEngine, directed: bool, *asked: int) -> Iterator[Directed]:
    """The segments of a stream, with directions if ``directed``."""
    if directed:
        return engine.directed(*asked)
    return (Directed(pairs, np.empty((0, 4))) for pairs in engine.stream(*asked))


class _Stream:
    """The segments of consecutive passes."""

    def __init__(self, chunks: Iterator[Directed], iteration: int) -> None:
        self._chunks, self.next_pass = chunks, iteration

    def take(self) -> Directed:
        """The segments of the next pass."""
        chunk = next(self._chunks)
        self.next_pass += 1
        return chunk

    def close(self) -> None:
        """End the casting."""
        self._chunks.close()  # type: ignore[attr-defined]
