"""Loops that are traced once: the same numbers, whatever the body leaves unchanged."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import prepared

from etendue.transport.loop import loop_traced_once


@dataclass
class Walked:
    rest: mi.UInt32
    total: mi.Float
    lane: mi.UInt32
    factor: mi.Float
    side: mi.Bool
    colour: mi.Color3f
    ray: mi.Ray3f
    parts: dict[str, mi.Color3f]
    pair: list[mi.Float]
    none: mi.Float | None = None


def start() -> Walked:
    lane = dr.arange(mi.UInt32, 5)
    ray = mi.Ray3f(mi.Point3f(mi.Float(lane), 0.0, 0.0), mi.Vector3f(0.0, 0.0, 1.0))
    fixed = mi.Color3f(mi.Float(lane), 2.0, 3.0)
    return Walked(
        lane, mi.Float(0.0), lane, mi.Float(2.0), mi.Bool(True), fixed, ray, {"a": fixed}, [mi.Float(7.0)] * 2
    )


def test_a_body_that_changes_little_is_traced_once():
    count = 0

    def body(s: Walked) -> Walked:
        nonlocal count
        count += 1
        s.total += s.factor * s.colour.x + s.parts["a"].y + dr.select(s.side, s.pair[1], 0.0)
        s.ray.o.y += 1.0
        s.factor = mi.Float(2.0)  # the literal of before the loop
        return replace(s, rest=s.rest - 1, parts=dict(s.parts))

    s = loop_traced_once(start(), lambda s: s.rest > 0, body, "test")
    lane = np.arange(5)
    np.testing.assert_array_equal(np.array(s.total), lane * (2.0 * lane + 2.0 + 7.0))
    np.testing.assert_array_equal(np.array(s.lane), lane)
    np.testing.assert_array_equal(np.array(s.ray.o), [lane, lane, 0 * lane])
    np.testing.assert_array_equal(np.array(s.ray.d)[2] + 0 * lane, 1.0)
    np.testing.assert_array_equal(np.array(s.colour) + np.zeros(5), np.array([lane, 2 + 0 * lane, 3 + 0 * lane]))
    assert count == 1


@pytest.mark.parametrize(
    ("method", "labels"),
    [
        ("path", {"path"}),
        pytest.param("light", {"light walk"}, marks=pytest.mark.slow),
        ("vcm", {"light walk", "camera walk"}),
        ("guided", {"guided path"}),
        ("sppm", {"light walk", "photon gathering"}),
    ],
)
def test_walks_are_traced_once(method, labels, monkeypatch):
    traced: dict[str, list[int]] = {}
    loop = dr.while_loop

    def counted(state, going, body, label=None, **options):
        counts = traced.setdefault(label, [])
        counts.append(0)

        def once_more(*s):
            counts[-1] += 1
            return body(*s)

        return loop(state, going, once_more, label=label, **options)

    monkeypatch.setattr(dr, "while_loop", counted)
    prepared(scenes.room("rectangle", "rough", size=(4, 4)), method).step(0, 1)
    walks = {label: set(counts) for label, counts in traced.items() if label in labels}
    assert walks == {label: {1} for label in labels}
