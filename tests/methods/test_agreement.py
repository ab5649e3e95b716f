"""Every unbiased method against Mitsuba's own ``path``: emitters x materials x sensors x filters x methods.

A scene shows six materials at once, so four scenes an emitter cross it with all of them. There are two walks: methods
that trace paths of the camera share one, methods that trace paths of the lights as well the other. The fast table has
emitters of every kind and every method, and with each walk every material, every sensor and every filter. The slow one
has all pairs of these and every emitter, but for (emitter, filter) and for the emitters of those methods that only it
runs (:data:`MORE`).
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


#: Emitters of the fast table: on surfaces, at a point, of one direction, all around, and several.
KINDS = ("rectangle", "mesh", "point", "directional", "envmap", "mixed")
#: Those whose pictures do not have the scene's filter.
FILM = tuple(name for name, (method, _) in MORE.items() if method == "film_metropolis")


def possible(emitter: str, group: str, method: str, sensor: str = "perspective", rfilter: str = "box") -> bool:
    """Whether ``path`` can make the picture, and the method too."""
    if method in SPLATS and sensor == "orthographic":
        return False
    if method in FILM and rfilter != "box":
        return False
    return group != "specular" or (emitter not in scenes.DELTA_EMITTERS and method not in SPLATS)


def pairs(row: tuple[str, ...]) -> set[tuple[int, str, int, str]]:
    """The pairs of columns that the covering set is after."""
    columns = [(0, 1), (0, 3), (1, 2), (1, 3), (2, 3), (2, 4), (3, 4)] + [(0, 2)] * (row[2] in METHODS)
    return {(i, row[i], j, row[j]) for i, j in columns}


@lru_cache(maxsize=1)
def covering() -> list[tuple[str, str, str, str, str]]:
    """Rows (emitter, group, method, sensor, filter): one for each (emitter, method of :data:`METHODS`) and each (group,
    method of :data:`MORE`), chosen to cover the most pairs that no earlier row has."""
    rows, covered = [], set()
    for emitters, groups, method in itertools.chain(
        (([emitter], scenes.GROUPS, method) for emitter, method in itertools.product(scenes.EMITTERS, METHODS)),
        ((scenes.EMITTERS, [group], method) for group, method in itertools.product(scenes.GROUPS, MORE)),
    ):
        every = itertools.product(emitters, groups, [method], scenes.SENSORS, scenes.FILTERS)
        if candidates := [row for row in every if possible(*row)]:
            rows.append(max(candidates, key=lambda row: len(pairs(row) - covered)))
            covered |= pairs(rows[-1])
    return rows


@lru_cache(maxsize=1)
def fast() -> list[tuple[str, str, str, str, str]]:
    """Rows of :func:`covering` without :data:`MORE`, as few as have what the fast table is for."""

    def wanted(row: tuple[str, ...]) -> set[Any]:
        walk = row[2] in BOTH_WAYS
        return {row[2], (walk, row[1]), (walk, row[3]), (walk, row[4]), *({row[0]} & set(KINDS))}

    candidates = [row for row in covering() if row[2] in METHODS]
    rows, left = [], set().union(*map(wanted, candidates))
    while left:
        rows.append(max(candidates, key=lambda row: len(wanted(row) & left)))
        left -= wanted(rows[-1])
    return rows


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


def rows() -> list[Any]:
    """Those of a scene one after the other, since they share its reference."""
    ordered = sorted(covering(), key=lambda row: (row[0], row[1], row[3], row[4]))
    return [row if row in fast() else pytest.param(row, marks=pytest.mark.slow) for row in ordered]


@pytest.mark.parametrize("row", rows(), ids=" ".join)
def test_every_pair(row):
    """Slow rows with more noise get longer runs; the noise is judged before the means are compared."""
    samples = (128,) if row in fast() else (128, 1024, 4096)
    for many in samples:
        try:
            return compare(*row, samples=many)
        except TooNoisy:
            if many == samples[-1]:
                raise


def test_the_covering_set_covers():
    every = itertools.product(scenes.EMITTERS, scenes.GROUPS, METHODS | MORE, scenes.SENSORS, scenes.FILTERS)
    wanted = set().union(*(pairs(row) for row in every if possible(*row)))
    assert not wanted - set().union(*(pairs(row) for row in covering()))
