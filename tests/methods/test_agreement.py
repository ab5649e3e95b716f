"""Every unbiased method against Mitsuba's own ``path``: emitters x materials x sensors x filters x methods.

A scene shows six materials at once, so four scenes an emitter cross it with all of them. There are two walks: methods
that trace paths of the camera share one, methods that trace paths of the lights as well the other. The fast table has
every emitter and every method, and with each walk every material, every sensor and every filter. Of the slow ones the
first adds the pairs (method, material), (method, sensor), (method, filter), (emitter, material), (emitter, sensor) and
(sensor, filter); the second is the full cross of emitters, materials and methods, the sensors and filters in turn.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_images, replicas, run
from support.statistics import TooNoisy, assert_agree

#: One row an unbiased method: name, method, settings.
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "bpt cache": ("bpt", {}),
    "path": ("path", {}),
    "bpt path": ("bpt", {"light_source": "path", "heuristic": "power"}),
    "light": ("light", {"light_paths": 4.0}),
    "guided": ("guided", {"cell_samples": 500}),
    "vegas": ("vegas", {}),
    "stratified": ("stratified", {}),
    "pssmlt": ("pssmlt", {"bootstrap": 1 << 14}),
}
#: Methods whose passes depend on each other: independent runs have the variance.
DEPENDENT = ("auto", "guided", "vegas", "pssmlt", "mmlt", "film_metropolis")
#: Those that trace paths of the lights as well.
BOTH_WAYS = ("bpt cache", "bpt path", "light")
#: Those that connect vertices of light paths to the camera, and find nothing else.
SPLATS = ("light", "film light")
#: Uniform directions find the peaks of these materials rarely, and after several bounces so rarely that the mean of a
#: few passes is not normal: four hundred thousand samples of a pixel lack one per cent of the light, with an
#: estimated error of one per mille. There, their paths are short.
GLOSSY = ("rough", "wrapped")
#: What only the slow table runs.
MORE = {
    "path power": ("path", {"heuristic": "power"}),
    "bpt counts": ("bpt", {"connections": 3, "next_events": 2, "light_paths": 0.5}),
    "vegas one path": ("vegas", {"one_path": True, "groups": "film; light; bounce", "learning": "stratified"}),
    "mmlt": ("mmlt", {"bootstrap": 1 << 14}),
    "auto": ("auto", {"radius": 0.001}),
    "pssmlt bidirectional": ("pssmlt", {"bootstrap": 1 << 14, "estimator": "bidirectional"}),
    "film_metropolis": ("film_metropolis", {"bootstrap": 1 << 14}),
    "film light": ("film_metropolis", {"bootstrap": 1 << 14, "paths": "light"}),
    "film pairs": ("film_metropolis", {"bootstrap": 1 << 14, "paths": "bidirectional"}),
    "film uniform": ("film_metropolis", {"bootstrap": 1 << 14, "bsdf_sampling": False}),
    "stratified joint": ("stratified", {"parameters": "light1 bounce1", "bsdf_sampling": False}),
}


#: Those whose pictures do not have the scene's filter.
FILM = tuple(name for name, (method, _) in MORE.items() if method == "film_metropolis")


def possible(emitter: str, group: str, method: str, sensor: str = "perspective") -> bool:
    """Whether ``path`` can make the picture, and the method too."""
    if method in SPLATS and sensor == "orthographic":
        return False
    if group != "specular":
        return True
    return emitter not in scenes.DELTA_EMITTERS and method not in SPLATS


def pairs(row: tuple[str, ...]) -> set[tuple[int, str, int, str]]:
    """The pairs of columns that the covering set is after."""
    return {(i, row[i], j, row[j]) for i, j in ((0, 3), (1, 2), (2, 3), (2, 4), (3, 4))}


@lru_cache(maxsize=1)
def covering() -> list[tuple[str, str, str, str, str]]:
    """Rows (emitter, group, method, sensor, filter): one for each (emitter, group), each chosen to cover the most pairs
    that no earlier row has."""
    rows, covered = [], set()
    for emitter, group in itertools.product(scenes.EMITTERS, scenes.GROUPS):
        candidates = [
            (emitter, group, method, sensor, rfilter)
            for method, sensor, rfilter in itertools.product(METHODS, scenes.SENSORS, scenes.FILTERS)
            if possible(emitter, group, method, sensor)
        ]
        if candidates:
            best = max(candidates, key=lambda row: len(pairs(row) - covered))
            covered |= pairs(best)
            rows.append(best)
    return rows


@lru_cache(maxsize=1)
def fast() -> list[tuple[str, str, str, str, str]]:
    """Rows of :func:`covering`, as few as have what the fast table is for."""

    def wanted(row: tuple[str, ...]) -> set[Any]:
        walk = row[2] in BOTH_WAYS
        return {row[0], row[2], (walk, row[1]), (walk, row[3]), (walk, row[4])}

    rows, left = [], set().union(*map(wanted, covering()))
    while left:
        rows.append(max(covering(), key=lambda row: len(wanted(row) & left)))
        left -= wanted(rows[-1])
    return rows


def everything() -> list[tuple[str, str, str, str, str]]:
    """One row for each possible (emitter, group, method): sensors in turn, and filters by scene and sensor."""
    rows, sensors = [], list(scenes.SENSORS)
    columns = (enumerate(column) for column in (scenes.EMITTERS, scenes.GROUPS, METHODS | MORE))
    for (e, emitter), (g, group), (m, method) in itertools.product(*columns):
        turn = [(e + g + m + k) % len(sensors) for k in range(len(sensors))]
        allowed = [k for k in turn if possible(emitter, group, method, sensors[k])]
        if allowed:
            rfilter = "box" if method in FILM else scenes.FILTERS[(e + allowed[0]) % len(scenes.FILTERS)]
            rows.append((emitter, group, method, sensors[allowed[0]], rfilter))
    return sorted(rows, key=lambda row: (row[0], row[1], row[3]))  # rows of a scene share its reference


@lru_cache(maxsize=2)
def _reference(samples: int, runs: int, seed: int, depth: int, *key: str) -> np.ndarray:
    # Mitsuba's path does not look for lights through surfaces; its volpath does.
    integrator = mi.load_dict({"type": "volpath" if key[1] == "transparent" else "path", "max_depth": depth})
    return mitsuba_images(_scene(*key), integrator, passes=runs, samples=samples, seed=1000 * seed)


def _scene(emitter: str, group: str, sensor: str, rfilter: str) -> Any:
    return scenes.room(emitter, group, sensor=sensor, rfilter=rfilter)


def compare(
    emitter: str, group: str, name: str, sensor: str, rfilter: str, samples: int, runs: int = 6, seed: int = 1
) -> None:
    method, settings = (METHODS | MORE)[name]
    if not settings.get("bsdf_sampling", True) and group in GLOSSY:
        settings = settings | {"max_depth": 3}
    key = (emitter, group, sensor, rfilter)
    reference = _reference(2 * samples, runs, seed, settings.get("max_depth", -1), *key)
    if method in DEPENDENT:
        images = replicas(_scene(*key), method, runs, 2, samples=max(128, samples // 2), seed=seed, **settings)
    else:
        result = run(_scene(*key), method, passes=runs, samples=samples, seed=seed, **settings)
        if result.measurement.counters["nonfinite"]:
            pytest.fail(f"{name} {key}: values that are not finite")  # no chance: not compared again by another seed
        images = result.images
    assert_agree(images, reference, (name, *key))


@pytest.mark.parametrize(
    "row", [row if row in fast() else pytest.param(row, marks=pytest.mark.slow) for row in covering()], ids=" ".join
)
def test_every_pair(row):
    """Slow rows with more noise get longer runs; the noise is judged before the means are compared."""
    try:
        compare(*row, samples=128)
    except TooNoisy:
        if row in fast():
            raise
        compare(*row, samples=1024)


@pytest.mark.slow
@pytest.mark.parametrize("row", everything(), ids=" ".join)
def test_the_full_cross(row):
    """Longer runs for rows with more noise; the noise is judged before the means are compared. Of so many rows one may
    differ by chance: four times the runs of another seed show a difference that there is more clearly, and no other."""
    samples = (256, 2048, 4096)
    for many in samples:
        try:
            compare(*row, samples=many)
        except TooNoisy:
            if many == samples[-1]:
                raise
            continue
        except AssertionError:
            compare(*row, samples=many, runs=24, seed=100)
        return


def test_the_cross_has_every_triple_and_all_pairs_with_sensors_and_filters():
    rows = everything()
    assert len(rows) == len({row[:3] for row in rows})
    for wanted, columns in (
        (itertools.product(scenes.EMITTERS, scenes.SENSORS), (0, 3)),
        (itertools.product(scenes.GROUPS, scenes.SENSORS), (1, 3)),
        (itertools.product(METHODS | MORE, scenes.SENSORS), (2, 3)),
        (itertools.product(METHODS | MORE, scenes.FILTERS), (2, 4)),
        (itertools.product(scenes.SENSORS, scenes.FILTERS), (3, 4)),
    ):
        missing = set(wanted) - {tuple(row[c] for c in columns) for row in rows}
        expected = {(name, "orthographic") for name in SPLATS}
        expected |= {(name, f) for name in FILM for f in scenes.FILTERS if f != "box"}
        assert missing <= expected, missing


def test_the_covering_set_covers():
    every = itertools.product(scenes.EMITTERS, scenes.GROUPS, METHODS, scenes.SENSORS, scenes.FILTERS)
    wanted = set().union(*(pairs(row) for row in every if possible(*row[:4])))
    missing = wanted - set().union(*(pairs(row) for row in covering()))
    # Three groups cannot bring four sensors to one emitter.
    assert {(p[1], p[0], p[2]) for p in missing} <= {(e, 0, 3) for e in scenes.DELTA_EMITTERS}, missing
