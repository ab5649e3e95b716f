"""Seconds of a pass, relative to Mitsuba's own ``path`` at one sample per pixel on the same scene."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import typer

from etendue import methods, scene
from etendue.cli.options import parse_pairs
from etendue.core import Replica, kernel_target
from etendue.core.kernels import use_gathers

from .measuring import COST_SCENE, COST_SETTINGS, Clock, Record, interleaved, spread, verdict
from .options import Rounds, Size, WarmUp

BARS = {"bpt": 2.0, "vcm": 2.7, "sppm": 3.0}
BAR_SIZE = (512, 512)
_MITSUBA = "Mitsuba path"
#: Russian roulette as Mitsuba's ``path`` plays it by default, and no other.
ROULETTE = {"rr_depth": 5, "shadow_roulette": 0.0}


@dataclass(frozen=True)
class Variant:
    """A method with settings of its own over those of the benchmark."""

    method: str
    settings: Mapping[str, str]

    @classmethod
    def parse(cls, text: str) -> Variant:
        """From ``vcm`` or ``vcm:split_layers=true:rr_depth=3``. Raises :class:`OptionError` for what does not exist."""
        name, *pairs = text.split(":")
        method = methods.get(name)
        own = parse_pairs(pairs, name)
        method.Settings.from_mapping(own, owner=f"method '{name}'")
        return cls(name, own)

    def __str__(self) -> str:
        return " ".join([self.method, *(f"{key}={value}" for key, value in self.settings.items())])


def _variants(text: str) -> list[Variant]:
    """Those between commas; a comma before a number is one of a setting: ``vcm:radii=0.5,2``."""
    return [Variant.parse(part) for part in re.split(r"\s*,\s*(?=[a-z])", text.strip())]


def measure(
    variants: Annotated[
        Any,
        typer.Option(
            "--methods",
            parser=_variants,
            help="Names, separated by commas; vcm:split_layers=true is vcm with that setting.",
            metavar="NAME[:SETTING=VALUE]...,...",
        ),
    ] = "path,bpt,vcm,sppm",
    size: Size = "512x512",
    rounds: Rounds = 11,
    warm_up: WarmUp = 2,
    source: str = COST_SCENE,
) -> Record:
    """Passes in turn: Mitsuba's ``path``, then each variant, again and again.

    A method without settings of its own runs twice: with its defaults where the settings of this benchmark do not
    speak, and with the roulette of Mitsuba's ``path``. One with settings is also compared with the same method without,
    if that is among the variants.
    """
    import drjit as dr
    import mitsuba as mi

    problem = scene.load(source, size=size)
    depth = COST_SETTINGS["path"]["max_depth"]
    mitsuba_path = mi.load_dict({"type": "path", "max_depth": depth})

    def mitsuba(number: int, gathers: bool = False) -> None:
        use_gathers(gathers)
        # Rendering is lazy: without these two lines the clock would stop before the first ray.
        image = mi.render(problem.scene, sensor=problem.sensor, integrator=mitsuba_path, spp=1, seed=number)
        dr.eval(image)
        dr.sync_thread()
        use_gathers()

    tasks: dict[str, Callable[[int], Any]] = {_MITSUBA: mitsuba}
    if use_gathers():
        tasks[f"{_MITSUBA}, with gathers"] = partial(mitsuba, gathers=True)
    bars: dict[str, float | None] = {}
    plain: dict[str, str] = {}  # label of a variant -> that of its method without settings
    for variant in variants:
        method = methods.get(variant.method)
        rows: dict[str, Mapping[str, Any]] = {str(variant): variant.settings}
        if variant.settings:
            plain[str(variant)] = variant.method
        else:
            alike = {key: value for key, value in ROULETTE.items() if key in method.Settings.names()}
            rows[f"{variant}, roulette as Mitsuba"] = alike
        for label, extra in rows.items():
            estimator = method(method.Settings.from_mapping({**COST_SETTINGS[variant.method], **extra}))
            estimator.prepare(problem, 0)
            tasks[label] = _Adding(Replica(estimator, 0))
            stated = size == BAR_SIZE and source == COST_SCENE and not variant.settings
            bars[label] = BARS.get(variant.method) if stated else None
    times = interleaved(tasks, rounds, warm_up)

    processor = f", {kernel_target().split(',')[0]}" if kernel_target() else ""  # the ratios depend on it
    record = Record(
        f"Cost of a pass, {source}, {size[0]}x{size[1]}, depth {depth}{processor}",
        ("", "wall s", "cpu s", "wall ratio", "cpu ratio", "bar", *(("to the method without",) if plain else ())),
    )
    for name, clocks in times.items():
        wall, cpu = _ratios(clocks, times[_MITSUBA])
        cells = [
            name,
            f"{statistics.median(clock.wall for clock in clocks):.3f}",
            f"{statistics.median(clock.cpu for clock in clocks):.3f}",
            spread(wall),
            spread(cpu),
            verdict(statistics.median(wall), bars.get(name)),
        ]
        if plain:
            base = times.get(plain.get(name, ""))
            cells.append(spread(_ratios(clocks, base)[0], ".3f") if base else "")
        record.add(*cells)
    record.notes += [
        f"median (min … max) of {rounds} rounds after {warm_up} to warm up; a ratio is that of two passes of one round",
        "one camera path per pixel; for bpt and vcm one light path, connection and light point, for sppm as many light "
        "paths; merge and first gather radius 0.003 of half the box's diagonal (constant for vcm); a pass of ours "
        "ends with its sums added to those of the passes before, on the host in float64",
        "roulette as Mitsuba: " + ", ".join(f"{key}={value:g}" for key, value in ROULETTE.items()),
        "cpu: all threads of the process; of no meaning under CUDA",
        *(["with gathers: as in a process that imports étendue, which compiles kernels with them"] * use_gathers()),
    ]
    if plain:
        record.notes.append("to the method without: ratio of wall times to the method without those settings")
    return record


class _Adding:
    """A pass, and the addition of its sums to those before."""

    def __init__(self, replica: Replica) -> None:
        self._replica, self._total = replica, replica.step(1 << 20)

    def __call__(self, number: int) -> None:
        self._total += self._replica.step(number)


def _ratios(clocks: Sequence[Clock], others: Sequence[Clock]) -> tuple[list[float], list[float]]:
    """Wall and processor time relative to those of another task, round by round."""
    pairs = list(zip(clocks, others, strict=True))
    return [a.wall / b.wall for a, b in pairs], [a.cpu / b.cpu for a, b in pairs]
