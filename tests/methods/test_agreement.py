"""Every unbiased method against Mitsuba's own ``path``: emitters x materials x sensors x filters x methods.

A scene shows six materials at once, so three scenes an emitter cross it with all of them. The fast table covers every
pair of (emitter, material), (sensor, filter), (method, material), (method, sensor), (method, filter), (emitter, sensor)
in one row or more; the slow one is the full cross of emitters, materials, sensors and methods, the filters in turn.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_path, run
from support.statistics import assert_agree

#: One row an unbiased method: name, method, settings.
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "bpt cache": ("bpt", {}),
    "path": ("path", {}),
    "bpt path": ("bpt", {"light_source": "path", "heuristic": "power"}),
    "light": ("light", {"light_paths": 4.0}),
}
#: What only the slow table runs.
MORE = {
    "path power": ("path", {"heuristic": "power"}),
    "bpt counts": ("bpt", {"connections": 3, "next_events": 2, "light_paths": 0.5}),
}


def possible(emitter: str, group: str, method: str) -> bool:
    """Whether ``path`` can make the picture, and the method too."""
    if group != "specular":
        return True
    return emitter not in scenes.DELTA_EMITTERS and method != "light"


def covering() -> list[tuple[str, str, str, str, str]]:
    """Rows (emitter, group, method, sensor, filter): pairs are spread by counting on at different paces."""
    rows = []
    for i, emitter in enumerate(scenes.EMITTERS):
        for j, group in enumerate(scenes.GROUPS):
            names = [m for m in METHODS if possible(emitter, group, m)]
            if names:
                method = names[(i + j + i // 4) % len(names)]
                sensor = tuple(scenes.SENSORS)[(i + j + i // 5) % 2]
                rows.append((emitter, group, method, sensor, scenes.FILTERS[(3 * i + j + i // 2) % 4]))
    return rows


def everything() -> list[tuple[str, str, str, str, str]]:
    rows = []
    for i, (emitter, group, sensor) in enumerate(itertools.product(scenes.EMITTERS, scenes.GROUPS, scenes.SENSORS)):
        methods = [m for m in METHODS | MORE if possible(emitter, group, m)]
        rows += [(emitter, group, m, sensor, scenes.FILTERS[(i + i // 6) % 4]) for m in methods]
    return rows


@lru_cache(maxsize=1)
def _reference(*key: str) -> np.ndarray:
    return mitsuba_path(_scene(*key), passes=6, samples=512)


def _scene(emitter: str, group: str, sensor: str, rfilter: str) -> Any:
    return scenes.room(emitter, group, sensor=sensor, rfilter=rfilter)


def compare(emitter: str, group: str, name: str, sensor: str, rfilter: str) -> None:
    method, settings = (METHODS | MORE)[name]
    key = (emitter, group, sensor, rfilter)
    reference = _reference(*key)
    result = run(_scene(*key), method, passes=6, samples=256, **settings)
    assert result.measurement.counters["nonfinite"] == 0
    assert_agree(result.images, reference, (name, *key))


@pytest.mark.parametrize("row", covering(), ids=" ".join)
def test_every_pair(row):
    emitter, group, method, sensor, rfilter = row
    compare(emitter, group, method, sensor, rfilter)


@pytest.mark.slow
@pytest.mark.parametrize("row", everything(), ids=" ".join)
def test_the_full_cross(row):
    emitter, group, method, sensor, rfilter = row
    compare(emitter, group, method, sensor, rfilter)


def test_the_covering_set_covers():
    rows = covering()
    for emitter, group in itertools.product(scenes.EMITTERS, scenes.GROUPS):
        if any(possible(emitter, group, m) for m in METHODS):
            assert any(row[:2] == (emitter, group) for row in rows), (emitter, group)
    for i, j in ((3, 4), (2, 3), (2, 4), (0, 3)):
        tables = (scenes.EMITTERS, scenes.GROUPS, METHODS, scenes.SENSORS, scenes.FILTERS)
        missing = set(itertools.product(tables[i], tables[j])) - {(row[i], row[j]) for row in rows}
        assert not missing, missing
    groups = {(row[1], row[2]) for row in rows}
    assert groups >= {(g, m) for g, m in itertools.product(scenes.GROUPS, METHODS) if possible("rectangle", g, m)}
