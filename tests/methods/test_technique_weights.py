"""Every technique's share of a picture against one computed without étendue: densities and weights written out in NumPy
for each path of a floor, a wall and a point light, and summed by quadrature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.guides import taught
from support.running import prepared
from support.statistics import assert_agree
from support.tables import thinned

from etendue.core import IndependentSource
from etendue.film import Technique
from etendue.transport import CLASSES, GENERATIONS

LIGHT = np.array([0.9, 1.2, 0.3])
FLOOR, WALL = 0.6, 0.8  # albedos
FOV, SIZE = 20.0, (16, 12)
#: The wall: x = -1, its normal along x, and where y and z lie.
WALL_X, WALL_Y, WALL_Z = -1.0, (0.2, 1.4), (-0.6, 0.6)
#: Where cells of classes end, thirds of the height of floor and wall; what is seen of the floor is in one cell.
CLASS_Y = (WALL_Y[1] / 3.0, 2.0 * WALL_Y[1] / 3.0)
RADIUS, SAMPLES, LIGHT_PATHS, DISCOUNT = 0.01, 128, 4.0, 0.25


def floor_and_wall() -> Any:
    """A camera looks down at the floor; the wall beside it is lit, and not seen. Nothing hides anything."""
    t = scenes.transform()
    wall = t.translate([WALL_X, np.mean(WALL_Y), np.mean(WALL_Z)]).rotate([0, 1, 0], 90).scale([0.6, 0.6, 1.0])
    return scenes.load(
        {
            "type": "scene",
            "sensor": scenes.camera((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), FOV, size=SIZE),
            "light": {"type": "point", "position": list(LIGHT), "intensity": scenes.rgb(1, 1, 1)},
            "floor": {
                "type": "rectangle",
                "to_world": t.rotate([1, 0, 0], -90).scale(2.0),
                "bsdf": scenes.diffuse(*3 * (FLOOR,)),
            },
            "wall": {"type": "rectangle", "to_world": wall, "bsdf": scenes.diffuse(*3 * (WALL,))},
        }
    )


@dataclass
class Counts:
    """Samples of each technique for a camera path; zero: not used. ``splat``: light paths for a pixel's one camera
    path, ``merge``: light paths times the area of the disc, ``diffuse``: factor on it beyond a diffuse surface."""

    next_event: int = 1
    connection: int = 1
    splat: float = LIGHT_PATHS * SIZE[0] * SIZE[1]
    merge: float = DISCOUNT * np.pi * RADIUS**2 * LIGHT_PATHS * SIZE[0] * SIZE[1] * SAMPLES
    diffuse: float = 0.1
    merge_first: bool = True
    direct: bool = True
    beta: int = 1


def seen_points(problem: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points of the floor, (pixels, 4, 3), two by two to a pixel by Gauss's rule, and the area density with which the
    pixel's camera ray meets each."""
    nodes = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    rows, columns, v, u = np.meshgrid(*map(np.arange, SIZE[::-1]), nodes, nodes, indexing="ij")
    film = mi.Point2f(*((a + b).ravel() / n for a, b, n in ((columns, u, SIZE[0]), (rows, v, SIZE[1]))))
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
    origin, direction = (np.array(x).T.astype(np.float64) for x in (ray.o, ray.d))
    points = origin - direction * (origin[:, 1:2] / direction[:, 1:2])
    height, cos = 3.0, -direction[:, 1]
    pixel = (2.0 * np.tan(np.deg2rad(FOV / 2)) / SIZE[0]) ** 2  # its area at distance 1
    density = 1.0 / (pixel * cos**3) * cos / (height / cos) ** 2
    return points.reshape(-1, 4, 3), density.reshape(-1, 4)


def geometry(a: np.ndarray, b: np.ndarray, normal_a: Any, normal_b: Any) -> tuple[np.ndarray, ...]:
    """(cosine at a, cosine at b, squared distance)."""
    offset = b - a
    square = (offset**2).sum(-1)
    direction = offset / np.sqrt(square)[..., None]
    return (direction @ np.array(normal_a)), -(direction @ np.array(normal_b)), square


def shares(densities: dict[Technique, Any], beta: int) -> dict[Technique, Any]:
    """Weights of a path's techniques, by samples times density."""
    total = sum(value**beta for value in densities.values())
    return {technique: value**beta / total for technique, value in densities.items()}


def evenly(direction: np.ndarray) -> np.ndarray:
    """Density of emission from the point light over that of the uniform sphere."""
    return np.ones(direction.shape[:-1])


def by_quadrature(
    problem: Any,
    counts: Counts,
    relative: Callable[[np.ndarray], np.ndarray] = evenly,
    chance: Callable[[np.ndarray, np.ndarray], Any] = lambda floor, wall: 1.0,
) -> dict[str, np.ndarray]:
    """The weighted layer of every technique that makes paths of two or three edges. ``relative``: as
    :func:`evenly`; ``chance``: probability of a light vertex on the wall, for a camera vertex on the floor, over that
    of a uniform choice."""
    x1, by_camera = seen_points(problem)
    up, out = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
    # camera, x1, light
    offset = LIGHT - x1
    square = (offset**2).sum(-1)
    cos = offset[..., 1] / np.sqrt(square)
    by_light = cos / (4.0 * np.pi * square) * relative(-offset / np.sqrt(square)[..., None])
    two = {
        Technique(False, 1, 2): counts.next_event * by_camera,
        Technique(False, 2, 1): counts.splat * counts.direct * by_light,
        Technique(True, 2, 2): counts.merge * counts.merge_first * counts.direct * by_camera * by_light,
    }
    radiance = FLOOR / np.pi * cos / square
    parts = {k: (w * radiance).mean(-1) for k, w in shares(two, counts.beta).items()}
    # camera, x1, x2, light
    nodes, factors = np.polynomial.legendre.leggauss(16)
    # Piece by piece along y, as classes of points change there.
    bounds = np.unique([*WALL_Y, *(y for y in CLASS_Y if WALL_Y[0] < y < WALL_Y[1])])
    below, lengths = bounds[:-1, None], np.diff(bounds)[:, None]
    along_y, by_y = (below + (nodes + 1) * lengths / 2).ravel(), (factors * lengths / 2).ravel()
    z0, z1 = WALL_Z
    y, z = (a.ravel() for a in np.meshgrid(along_y, z0 + (nodes + 1) * (z1 - z0) / 2, indexing="ij"))
    area = np.outer(by_y, factors * (z1 - z0) / 2).ravel()
    x2 = np.stack([np.full_like(y, WALL_X), y, z], -1)
    x1, by_camera = x1[:, :, None, :], by_camera[:, :, None]
    cos1, cos2, square12 = geometry(x1, x2, up, out)
    offset = LIGHT - x2
    square = (offset**2).sum(-1)
    cos = offset[..., 0] / np.sqrt(square)
    by_light = cos / (4.0 * np.pi * square) * relative(-offset / np.sqrt(square)[..., None])
    there, back = cos1 / np.pi * cos2 / square12, cos2 / np.pi * cos1 / square12  # x1 to x2, x2 to x1: areas
    three = {
        Technique(False, 1, 3): counts.next_event * by_camera * there,
        Technique(False, 2, 2): counts.connection * chance(x1, x2) * by_camera * by_light,
        Technique(False, 3, 1): counts.splat * by_light * back,
        Technique(True, 3, 2): counts.merge * counts.diffuse * counts.merge_first * by_camera * by_light * back,
        Technique(True, 2, 3): counts.merge * counts.direct * by_camera * there * by_light,
    }
    radiance = FLOOR * WALL / np.pi**2 * cos1 * cos2 / square12 * cos / square
    parts |= {k: (w * radiance * area).sum(-1).mean(-1) for k, w in shares(three, counts.beta).items()}
    return {k.layer(): value.reshape(SIZE[1], SIZE[0]) for k, value in parts.items()}


NONE: Any = {"next_event": 0, "connection": 0, "splat": 0.0}
#: One row a set of techniques: method, settings, the counts that they mean.
ROWS: dict[str, tuple[str, dict[str, Any], Counts]] = {
    "bpt": ("bpt", {"light_source": "path"}, Counts(merge=0.0, direct=False)),
    "bpm": ("bpm", {"eta_discount": DISCOUNT}, Counts(diffuse=1.0, **NONE)),
    "vcm": ("vcm", {"connections": 1}, Counts(direct=False)),
    "vcm direct": ("vcm", {"connections": 1, "direct_light": "all"}, Counts()),
    "vcm late power": (
        "vcm",
        {"heuristic": "power", "merge_first": False, "next_events": 2, "connections": 3},
        Counts(next_event=2, connection=3, merge_first=False, direct=False, beta=2),
    ),
}


@pytest.mark.parametrize("name", thinned(ROWS, ("bpt", "vcm direct", "vcm late power")))
def test_the_share_of_every_technique(name):
    method, settings, counts = ROWS[name]
    problem = floor_and_wall()
    runner = prepared(problem, method, **asked(settings, counts))
    assert_shares([runner.step(i, 1) for i in range(6)], by_quadrature(problem, counts), name)


def asked(settings: dict[str, Any], counts: Counts) -> dict[str, Any]:
    """All settings of a run of these counts."""
    if counts.merge:
        settings = settings | {"radius": RADIUS, "radius_unit": "absolute", "alpha": 1.0, "eta_discount": DISCOUNT}
    length = {"max_depth": 3, "pyramid": True, "pyramid_depth": 3}
    return {"samples_per_pass": SAMPLES, "light_paths": LIGHT_PATHS} | length | settings


def assert_shares(steps: list[Any], expected: dict[str, np.ndarray], name: Any) -> None:
    """Every layer of the passes is what quadrature says."""
    whole = sum(expected.values())
    for layer, values in (expected | {"image": whole}).items():
        if not values.any():
            assert layer not in steps[0].sums, layer
        elif values.mean() > 1e-4 * whole.mean():  # a share so small takes too few paths to be known
            found = np.stack([step.mean(layer) for step in steps])
            true = np.tile(values[None, :, :, None], (2, 1, 1, 3))
            assert_agree(found, true, (name, layer), precision=0.05)


@pytest.mark.parametrize("name", ["bpt", pytest.param("vcm late power", marks=pytest.mark.slow)])
def test_the_share_of_every_technique_with_learned_emission(name):
    method, settings, counts = ROWS[name]
    problem, guide = floor_and_wall(), taught(floor_and_wall(), 5)
    runner = prepared(problem, method, **asked(settings, counts), guide_emission="on")
    state = runner.state()
    learned = state["emission"] | {"guide": guide.state(), "generation": GENERATIONS}
    learned["sums"] = {
        key: np.zeros(old.size if key in ("count", "direct", "moments") else guide.places)
        for key, old in state["emission"]["sums"].items()
    }
    runner.restore({**state, "emission": learned})

    def relative(direction: np.ndarray) -> np.ndarray:
        flat = direction.reshape(-1, 3).astype(np.float32)
        world = mi.Vector3f(*(mi.Float(np.ascontiguousarray(flat[:, i])) for i in range(3)))
        mixed = guide.departures.at(mi.UInt32(0), mi.Bool(True)).mixed(world, mi.Float(0.25 / np.pi), mi.Bool(True))
        return 4.0 * np.pi * np.array(mixed, np.float64).reshape(direction.shape[:-1])

    assert_shares([runner.step(i, 1) for i in range(6)], by_quadrature(problem, counts, relative), name)


@pytest.mark.parametrize("name", thinned(("vcm", "vcm late power"), ("vcm",)))
def test_the_share_of_every_technique_with_learned_connections(name):
    method, settings, counts = ROWS[name]
    problem, random = floor_and_wall(), np.random.default_rng(3)
    box = problem.scene.bbox()
    lower, upper = (np.array(corner, np.float64).ravel() for corner in (box.min, box.max))

    def place(points: np.ndarray, facing: int) -> np.ndarray:
        """Class: cells in thirds of the box, and a facing, of 2 axis + (1 where the normal is against it)."""
        cell = np.clip(((points - lower) / (upper - lower) * 3.0).astype(int), 0, 2)
        return (cell[..., 0] * 9 + cell[..., 1] * 3 + cell[..., 2]) * 6 + facing

    wall = np.stack(np.meshgrid([WALL_X], np.linspace(*WALL_Y, 30), np.linspace(*WALL_Z, 30)), -1)
    walls = np.unique(place(wall, 0))
    uneven = random.random((CLASSES, len(walls))) ** 2 + 0.05
    slots = np.stack([random.choice(walls, 256, p=row / row.sum()) for row in uneven])
    expected = np.zeros(CLASSES)
    expected[walls] = random.random(len(walls)) + 0.2
    expected *= 0.7 / expected.sum()  # the floor has the others
    runner = prepared(problem, method, **asked(settings, counts), guide_connections=True)
    state = runner.state()
    guide = {"slots": slots, "expected": expected}
    runner.restore({**state, "connections": state["connections"] | {"guide": guide, "generation": GENERATIONS}})

    def chance(floor: np.ndarray, wall: np.ndarray) -> np.ndarray:
        """A fifth of the draws is uniform."""
        camera, light = np.broadcast_arrays(place(floor, 2), place(wall, 0))
        share = (slots[:, :, None] == walls).mean(axis=1)[camera, np.searchsorted(walls, light)]
        return 0.2 + 0.8 * share / expected[light]

    ratios = chance(seen_points(problem)[0][:, :, None, :], wall.reshape(-1, 3))
    assert ratios.max() > 3.0 * ratios.min()
    pictures = by_quadrature(problem, counts, chance=chance)
    assert_shares([runner.step(i, 1) for i in range(6)], pictures, name)


@lru_cache(maxsize=1)
def single() -> Any:
    return prepared(floor_and_wall(), "mmlt", samples_per_pass=4, bootstrap=1 << 10)


@pytest.mark.parametrize("technique", [(1, 2), (2, 1), (1, 3), (2, 2), (3, 1)], ids=str)
def test_the_share_of_a_technique_alone(technique):
    """What ``mmlt`` evaluates: one technique a sample, with as many light paths as camera paths."""
    runner, lanes, batches = single(), 6 << 16, 6
    target, problem = runner.runner.target, runner.problem
    lane = dr.arange(mi.UInt32, lanes)
    sources = {name: IndependentSource(lane, 1, name, 0) for name in ("camera", "light")}
    place = mi.Point2f(*(u * n for u, n in zip(sources["camera"].next_2d(0, 0), SIZE, strict=True)))
    s, t = (dr.full(mi.UInt32, n, lanes) for n in technique)
    found = target._single.trace(s, t, place, sources["camera"], sources["light"])
    x, y, values = np.array(found.position.x), np.array(found.position.y), np.array(found.value)
    pixel = np.where(values[0] > 0.0, y.astype(int) * SIZE[0] + x.astype(int), 0)
    pixel += np.arange(lanes) * batches // lanes * SIZE[0] * SIZE[1]
    sums = [np.bincount(pixel, channel, batches * SIZE[0] * SIZE[1]) for channel in values]
    pictures = np.stack(sums, -1).reshape(batches, SIZE[1], SIZE[0], 3) * (SIZE[0] * SIZE[1] * batches / lanes)
    expected = by_quadrature(problem, Counts(splat=SIZE[0] * SIZE[1], merge=0.0))[Technique(False, *technique).layer()]
    assert_agree(pictures, np.tile(expected[None, :, :, None], (2, 1, 1, 3)), technique, precision=0.05)
