"""Daylight coefficients of all patches of a source by lines, the daylight of a year on them, and their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from etendue.core import OptionError, Settings
from etendue.engine import Budget, Job, RunResult, Task, silent
from etendue.lighting import SkyPatches, Weather, compass, read_epw
from etendue.methods import SkySettings
from etendue.radiosity import LineCasting, PatchProblem, PatchSource, daylight_of_patches

from ..daylight import DaylightResult, check_daylight_file
from ..registry import find
from .base import PatchProduct
from .factors import with_sky_patches
from .tasks import PatchRun


@dataclass(kw_only=True)
class PatchDaylight(PatchProduct[DaylightResult]):
    """Daylight coefficients of patches, see :func:`etendue.radiosity.daylight_of_patches`, and with ``weather``, an EPW
    file or what was read of one, the daylight of a year; ``sky_patches`` is m."""

    kind: ClassVar[str] = "daylight of patches"
    goal: ClassVar[Literal["rows", "irradiance"]] = "rows"
    entry_bytes: ClassVar[float] = 76.0

    sky_patches: int = 1
    up: str = "z"
    north: float = 0.0
    weather: Weather | Path | str | None = None
    outputs: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        self._sky = SkyPatches(self.sky_patches)
        compass(self.up, self.north)
        self._year = self.weather if isinstance(self.weather, Weather) else self.weather and read_epw(self.weather)
        self.outputs = tuple(check_daylight_file(path, self._year is not None) for path in self.outputs)

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`Product`."""
        return self.outputs

    def notes(self) -> dict[str, Any]:
        """See :class:`Product`; weather that is in memory only is not kept."""
        kept = None if self.weather is None or isinstance(self.weather, Weather) else Path(self.weather).absolute()
        known = {"sky_patches": self.sky_patches, "up": self.up, "north": self.north, "weather": kept and str(kept)}
        return {"product": {"kind": self.kind, **known, "outputs": [str(path.absolute()) for path in self.outputs]}}

    def default_budget(self, task: Task, problem: PatchProblem) -> Budget:
        """See :class:`PatchProduct`; some bundles for each patch of the sky."""
        return with_sky_patches(super().default_budget(task, problem), self._sky)

    def at_once(
        self, source: PatchSource, tell: Callable[[str], object] = silent, on_patches: Callable[[Any], object] = silent
    ) -> DaylightResult:
        """See :class:`PatchProduct`; always raises :class:`OptionError`."""
        raise OptionError("daylight of patches needs lines; take method lines")

    def _casting(self, task: Task, kind: Any, settings: Settings, problem: PatchProblem, **own: Any) -> LineCasting:
        return super()._casting(task, kind, settings, problem, **own, directed=True)

    def _make(self, job: Job, run: RunResult, writing: Any, tell: Callable[[str], object]) -> DaylightResult:
        bundles, segments = self._counted(job, run, tell)
        tell("reflections")
        known = self._metadata(job, bundles=bundles, up=self.up, north=self.north)
        coefficients = daylight_of_patches(segments, self.sky_patches, self.up, self.north, metadata=known)
        result = DaylightResult(coefficients)
        if self._year:
            tell("the hours of the year")
            result.annual = coefficients.annual(self._year)
        for path in self.outputs:
            with writing.attempt(f"write '{path}'"):
                result.save(path)
        return result


@dataclass(kw_only=True)
class DaylightRun(PatchRun):
    """Daylight of patches; see :func:`etendue.daylight`."""

    patches: int = 1
    up: str = "z"
    north: float = 0.0
    weather: Weather | Path | str | None = None
    outputs: tuple[Path, ...] = ()

    def task(self) -> Task:
        """Check what can be checked before the source is read. Raises :class:`OptionError` for what does not fit."""
        lines = LineCasting.name
        product = PatchDaylight(
            **self._common(lines),
            sky_patches=self.patches,
            up=self.up,
            north=self.north,
            weather=self.weather,
            outputs=self.outputs,
        )
        return self._task(PatchSource(**self._given()), find(lines), product)


def daylight_run(settings: Mapping[str, Any], **asked: Any) -> DaylightRun:
    """The run of ``settings`` as of :class:`etendue.methods.SkySettings`. Raises :class:`OptionError` for those of
    paths."""
    sky = SkySettings.from_mapping(settings, owner="daylight")
    if of_paths := [name for name in ("max_depth", "samples_per_pass") if name in settings]:
        raise OptionError(f"{of_paths[0]} is for paths from meters; surfaces have all reflections, so leave it out")
    return DaylightRun(patches=sky.patches, up=sky.up, north=sky.north, **asked)
