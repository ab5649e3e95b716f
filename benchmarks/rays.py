"""Share of ray casting in a pass: the rays of one pass are recorded, and cast again from arrays with nothing else.

Recording wraps ``ray_intersect``, ``ray_intersect_preliminary`` and ``ray_test`` of ``mi.Scene``: each call writes its
rays, in the order in which the lanes come to it, to buffers. The replay casts them in that order by
``ray_intersect_preliminary`` (closest hit, no interaction is built) and ``ray_test`` (shadow). The
replay reads from memory what a method has in registers, so the share is an upper bound by that little.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from etendue import methods, scene
from etendue.core import Replica

from .measuring import COST_SCENE, COST_SETTINGS, Record, interleaved, spread
from .options import Methods, Rounds, Size, WarmUp

_CLOSEST = ("ray_intersect", "ray_intersect_preliminary")
_FLOATS = 7  # origin, direction, length
_PLACES = 64  # in the code of a pass; a loop body may be traced more than once


class _Recorder:
    """Rays of one kind in one array, a section for each place in the code that casts them.

    A place needs a counter of its own, since a counter cannot be read twice in one symbolic loop. ``counts`` of an
    earlier, equal pass says how long the sections must be; without it rays are counted only.
    """

    def __init__(self, counts: Sequence[int] = ()) -> None:
        import drjit as dr
        import mitsuba as mi

        self._lengths = list(counts)
        self._counters = [mi.UInt32(0) for _ in range(_PLACES)]
        self._values = dr.zeros(mi.Float, max(1, _FLOATS * sum(counts)))
        dr.make_opaque(self._counters, self._values)
        self._places = 0

    def write(self, ray: Any, active: Any) -> None:
        """Called where rays are cast, possibly in a symbolic loop."""
        import drjit as dr
        import mitsuba as mi

        place, self._places = self._places, self._places + 1
        active = mi.Bool(active)
        slot = dr.scatter_inc(self._counters[place], mi.UInt32(0), active)
        if self._lengths:
            active &= slot < self._lengths[place]
            slot += sum(self._lengths[:place])
            for number, value in enumerate((*ray.o, *ray.d, ray.maxt)):
                dr.scatter(self._values, mi.Float(value), slot * _FLOATS + number, active)

    def counts(self) -> list[int]:
        """Rays by place."""
        return [int(counter[0]) for counter in self._counters]

    def rays(self) -> Any:
        """The recorded rays as one evaluated ray array."""
        import drjit as dr
        import mitsuba as mi

        if self.counts() != self._lengths:
            raise SystemExit(f"two equal passes cast different rays: {self._lengths} and {self.counts()} by place")
        base = dr.arange(mi.UInt32, sum(self._lengths)) * _FLOATS
        ray = dr.zeros(mi.Ray3f, sum(self._lengths))
        ray.o = mi.Point3f(*(dr.gather(mi.Float, self._values, base + k) for k in range(3)))
        ray.d = mi.Vector3f(*(dr.gather(mi.Float, self._values, base + 3 + k) for k in range(3)))
        ray.maxt = dr.gather(mi.Float, self._values, base + 6)
        dr.eval(ray)
        dr.sync_thread()
        return ray


@contextmanager
def _recorded(closest: _Recorder, shadow: _Recorder) -> Iterator[None]:
    """Within the block every ray that is cast is written to one of the recorders."""
    import mitsuba as mi

    originals = {name: getattr(mi.Scene, name) for name in (*_CLOSEST, "ray_test")}

    def wrapper(original: Callable[..., Any], recorder: _Recorder) -> Callable[..., Any]:
        def cast(self: Any, ray: Any, *arguments: Any, **named: Any) -> Any:
            # `active` is the last positional argument of every overload.
            recorder.write(ray, named.get("active", arguments[-1] if arguments else True))
            return original(self, ray, *arguments, **named)

        return cast

    try:
        for name, original in originals.items():
            setattr(mi.Scene, name, wrapper(original, shadow if name == "ray_test" else closest))
        yield
    finally:
        for name, original in originals.items():
            setattr(mi.Scene, name, original)


def _record(estimator: Any) -> tuple[Any, Any]:
    """The closest-hit and the shadow rays of the first pass."""
    counting = _Recorder(), _Recorder()
    with _recorded(*counting):
        Replica(estimator, 0).step(0)
    recorders = _Recorder(counting[0].counts()), _Recorder(counting[1].counts())
    with _recorded(*recorders):
        Replica(estimator, 0).step(0)
    return recorders[0].rays(), recorders[1].rays()


def measure(
    names: Methods = "path,bpt,vcm",
    size: Size = "512x512",
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
    source: str = COST_SCENE,
) -> Record:
    """A pass and the replay of its rays in turn."""
    import drjit as dr

    problem = scene.load(source, size=size)
    record = Record(
        f"Share of ray casting, {source}, {size[0]}x{size[1]}",
        ("", "closest M", "shadow M", "pass s", "closest share", "shadow share", "all", "with interactions"),
    )
    for name in names:
        method = methods.get(name)
        estimator = method(method.Settings(**COST_SETTINGS[name]))
        estimator.prepare(problem, 0)
        closest, shadow = _record(estimator)

        def cast(
            number: int, what: str, world: Any = problem.scene, closest: Any = closest, shadow: Any = shadow
        ) -> None:
            if what == "shadow":
                hit = world.ray_test(shadow)
            elif what == "closest":
                hit = world.ray_intersect_preliminary(closest).t
            else:
                si = world.ray_intersect(closest)
                hit = [si.t, si.p, si.n, si.sh_frame, si.uv, si.wi]
            dr.eval(hit)
            dr.sync_thread()

        times = interleaved(
            {
                "pass": lambda number, estimator=estimator: Replica(estimator, 0).step(0),
                "closest": lambda number, cast=cast: cast(number, "closest"),
                "shadow": lambda number, cast=cast: cast(number, "shadow"),
                "full": lambda number, cast=cast: cast(number, "full"),
            },
            rounds,
            warm_up,
        )
        share = {
            what: [a.wall / b.wall for a, b in zip(times[what], times["pass"], strict=True)]
            for what in ("closest", "shadow", "full")
        }
        both = [a + b for a, b in zip(share["closest"], share["shadow"], strict=True)]
        full = [a + b for a, b in zip(share["full"], share["shadow"], strict=True)]
        record.add(
            name,
            f"{dr.width(closest) / 1e6:.2f}",
            f"{dr.width(shadow) / 1e6:.2f}",
            f"{statistics.median(clock.wall for clock in times['pass']):.3f}",
            f"{statistics.median(share['closest']):.0%}",
            f"{statistics.median(share['shadow']):.0%}",
            spread(both, ".0%"),
            f"{statistics.median(full):.0%}",
        )
    record.notes += [
        f"the rays of one pass, recorded and cast again from arrays; {rounds} rounds in turn with the pass itself",
        "with interactions: closest hits by ray_intersect, whose surface interactions are written to memory",
    ]
    return record
