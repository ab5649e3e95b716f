"""The test cases: scenes, meters and what they should read. Illuminances are in lux, luminances in cd/m^2.

Where the document states a table, the reference is nevertheless the closed form or integral behind it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from etendue.lighting import EFFICACY

from . import rooms
from .masks import Mask
from .references import (
    INDEX,
    GeneralSky,
    Opening,
    Outside,
    configuration_factor,
    gauss,
    illuminance,
    pane,
    peak,
    twice_refracted,
)
from .rooms import DEPTH, HEIGHT, WIDTH, Array, Scene, X, Y, Z

#: Of the sky on the horizontal, of lamps, and of a sun on a surface that reflects its light.
_SKY_LUX, _FLUX, SUN_LUX = 10_000.0, 10_000.0, 50_000.0
#: Height of the sun in degrees, and reflectance of ground and masks.
_SUN_HEIGHT, _GROUND = 60.0, 0.3
_ROOFS = {"1x1": (1.5, 2.5), "4x4": (0.0, 4.0)}
_FACADES = {"2x1": ((1.0, 3.0), (1.0, 2.0)), "4x3": ((0.0, 4.0), (0.0, 3.0))}
_MASKS = {
    "5.13": {f"horizontal mask of {r:g} m": Mask(r, level=HEIGHT, reflectance=_GROUND) for r in (0.5, 1.0, 2.0)},
    "5.14": {f"vertical mask of {t:g} m": Mask(6.0, top=t, reflectance=_GROUND) for t in (3.0, 6.0, 9.0)},
}
_ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 80.0)
REFLECTANCES = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
_LONG = 1 << 18


@dataclass(frozen=True)
class Case:
    """A scene and meters. ``expected``: (n,) of each meter, or with ``weights`` (n,) one, of their weighted sum.

    ``row`` names the row of the table that the case belongs to, ``what`` the case within it. ``spp`` is the number of
    paths of each meter, ``max_depth`` that of their edges at most."""

    number: str
    row: str
    what: str
    scene: Scene
    points: Array
    directions: Array
    names: tuple[str, ...]
    expected: Array
    methods: tuple[str, ...] = ("path",)
    spp: int = 1 << 17
    max_depth: int = 2
    quantity: str = "irradiance"
    weights: Array | None = None


def cases(numbers: Sequence[str], kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    """Those of some ``numbers``, under skies of some ``kinds``. ``folder``: for photometric files."""
    for number in numbers:
        yield from _MAKERS[number](kinds, folder)


def _places(*groups: tuple[Mapping[str, Any], ArrayLike]) -> dict[str, Any]:
    """Points, directions and names of a case."""
    points = [p for group, _ in groups for p in group.values()]
    directions = [np.asarray(n, float) for group, n in groups for _ in group]
    names = tuple(name for group, _ in groups for name in group)
    return {"points": np.array(points, float), "directions": np.array(directions), "names": names}


def _isotropic(c: Array, g: Array) -> Array:
    return np.full(np.broadcast(c, g).shape, _FLUX / (4.0 * np.pi))


def _cosine(c: Array, g: Array) -> Array:
    return 1000.0 * np.maximum(np.cos(g), 0.0) + 0.0 * c


def _lobe(c: Array, g: Array) -> Array:
    return 1000.0 * np.maximum(np.cos(g), 0.0) * (1.0 + 0.6 * np.sin(g) * np.cos(c - np.pi / 6.0))


def photometric_file(path: Path, intensity: Callable[[Array, Array], Array], planes: int, last: int) -> Path:
    """Write LM-63 with an intensity of C and gamma in radians, at every degree of gamma up to ``last``."""
    c = np.linspace(0.0, 360.0, planes) if planes > 1 else np.zeros(1)
    gamma = np.arange(last + 1.0)
    rows = intensity(np.deg2rad(c)[:, None], np.deg2rad(gamma)[None])
    lines = ["IESNA:LM-63-2002", "TILT=NONE", f"1 -1 1 {len(gamma)} {len(c)} 1 2 0 0 0", "1 1 0"]
    lines += [" ".join(f"{x:.7g}" for x in row) for row in (gamma, c, *rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def _luminaire(path: Path, place: Sequence[float]) -> Scene:
    import mitsuba as mi

    at = mi.ScalarTransform4f().translate(list(place))
    return {"type": "luminaire", "filename": str(path), "to_world": at}


def _point_lamps(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    offsets = ((0, 0), (1, 0), (2, 0), (3, 0), (1, 1), (2, 1), (3, 1), (2, 2), (3, 2), (3, 3))
    points = {name: (0.5 * x, 0.5 * y, 0.0) for name, (x, y) in zip("ABCDEFGHIJ", offsets, strict=True)}
    lamps = {"isotropic": (_isotropic, 1, 180), "cosine": (_cosine, 1, 90), "lobe": (_lobe, 181, 90)}
    for name, (intensity, planes, last) in lamps.items():
        path = photometric_file(folder / f"{name}.ies", intensity, planes, last)
        floor = rooms.wall("floor", (-2, -2, 0), WIDTH * X, DEPTH * Y)
        scene = {"type": "scene", **floor, "lamp": _luminaire(path, (0, 0, HEIGHT))}
        places = _places((points, Z))
        x, y = places["points"][:, :2].T
        square = x**2 + y**2 + HEIGHT**2
        cos = HEIGHT / np.sqrt(square)
        lux = intensity(np.arctan2(y, x), np.arccos(cos)) * cos / square
        yield Case("5.2", "point lamps", name, scene, expected=lux, methods=("path", "bpt"), spp=1 << 12, **places)


def _area_lamp(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    hole, candela = ((1.5, 2.5), (1.5, 2.5)), 1000.0
    corners = np.array([(1.5, 1.5, HEIGHT), (2.5, 1.5, HEIGHT), (2.5, 2.5, HEIGHT), (1.5, 2.5, HEIGHT)])
    light = {"type": "area", "radiance": {"type": "rgb", "value": candela / EFFICACY}}
    scene = rooms.room(roof=hole)
    scene["lamp"] = rooms.rectangle(corners[0], Y, X, rooms.grey(0.0), emitter=light)
    places = _places((rooms.wall_points(0.0), Y), (rooms.floor_points(), Z))
    lux = np.pi * candela * configuration_factor(places["points"], places["directions"], corners)
    yield Case("5.3", "area lamp", "", scene, expected=lux, methods=("path", "bpt"), spp=1 << 14, **places)


def _surfaces(ceiling: bool, count: int = 10) -> tuple[dict[str, Any], Array]:
    """Meters at Gauss's points of the inner surfaces of the room, and the areas that they stand for."""
    w, d, h = WIDTH * X, DEPTH * Y, HEIGHT * Z
    faces = [((0, 0, 0), w, d, Z), ((0, 0, 0), w, h, Y), ((0, DEPTH, 0), w, h, -Y)]
    faces += [((0, 0, 0), d, h, X), ((WIDTH, 0, 0), d, h, -X)]
    if ceiling:
        faces.append(((0, 0, HEIGHT), w, d, -Z))
    x, weight = gauss([0.0, 1.0], count)
    points, normals, areas = [], [], []
    for corner, u, v, normal in faces:
        points.append((np.asarray(corner, float) + x[:, None, None] * u + x[None, :, None] * v).reshape(-1, 3))
        normals.append(np.tile(normal, (count * count, 1)))
        areas.append(np.outer(weight, weight).ravel() * np.linalg.norm(np.cross(u, v)))
    made = {"points": np.concatenate(points), "directions": np.concatenate(normals), "names": ("flux",)}
    return made, np.concatenate(areas)


def _conservation(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    """Flux in lumens: through the opening, and on black surfaces."""
    places, areas = _surfaces(ceiling=True)
    lamp = _luminaire(photometric_file(folder / "isotropic.ies", _isotropic, 1, 180), (2.0, 2.0, 1.5))
    room = rooms.room() | {"lamp": lamp}
    shared = {"number": "5.4", "row": "conservation of flux"}
    yield Case(**shared, what="lamp", scene=room, expected=np.array([_FLUX]), weights=areas, spp=1 << 10, **places)
    places, areas = _surfaces(ceiling=False)
    low, high = _ROOFS["1x1"]
    for kind in kinds:
        sun = _sun(1.0)
        for glazed in (False, True):
            scene = _under_roof("1x1", kind, glazed)
            passing = np.array([_SKY_LUX * _passing(GeneralSky(kind, sun), glazed) * (high - low) ** 2])
            what = f"sky {kind}, {'glazed' if glazed else 'open'}"
            yield Case(
                **shared, what=what, scene=scene, expected=passing, weights=areas, spp=1 << 11, max_depth=3, **places
            )


def _passing(sky: GeneralSky, glazed: bool) -> float:
    """The share of the sky's illuminance of the horizontal that a pane lets through."""
    zenith, along = gauss([0.0, np.deg2rad(90.0 - _SUN_HEIGHT), 1.2, 1.5, 0.5 * np.pi], 30)
    turn = np.arctan2(sky.sun[1], sky.sun[0])
    azimuth, across = gauss([turn, turn + np.pi], 60)
    sin, cos = np.sin(zenith)[:, None], np.cos(zenith)[:, None]
    d = np.stack(np.broadcast_arrays(sin * np.cos(azimuth), sin * np.sin(azimuth), cos), axis=-1)
    share = pane(cos) if glazed else np.ones_like(cos)
    return float(2.0 * (sky.luminance(d) * share * cos * sin * along[:, None] * across).sum())


def _glass(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    """Luminance of a uniform sky through a pane, over its own: as a pane without thickness, as two interfaces 6 mm
    apart, and the same without reflections inside."""
    directions = np.array([(np.sin(a), 0.0, np.cos(a)) for a in np.deg2rad(_ANGLES)])
    points, cos = np.zeros_like(directions), directions[:, 2]
    corner, u, v = np.array([-50.0, -50.0, 1.0]), 100.0 * X, 100.0 * Y
    solid = {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0}
    thin = {"pane": rooms.glass(corner, u, v, INDEX)}
    slab = {"low": rooms.rectangle(corner, v, u, solid), "high": rooms.rectangle(corner + 0.006 * Z, u, v, solid)}
    luminance = _SKY_LUX / np.pi
    ways = {"thin pane": (thin, pane, -1), "6 mm slab": (slab, pane, -1), "6 mm slab, once": (slab, twice_refracted, 3)}
    for what, (parts, share, depth) in ways.items():
        scene = {"type": "scene", **parts, "sky": rooms.sky(5, _sun(1.0), _SKY_LUX, 0.0)}
        names = tuple(f"{a:g} degrees" for a in _ANGLES)
        expected = luminance * share(cos)
        made = Case("5.5", "clear glass", what, scene, points, directions, names, expected, quantity="radiance")
        yield replace(made, max_depth=depth, spp=1 << 14)


def _sun_lamp(direction: ArrayLike, lux: float) -> Scene:
    import mitsuba as mi

    value = {"type": "rgb", "value": float(lux / EFFICACY)}
    return {"type": "directional", "direction": mi.ScalarVector3f(*np.asarray(direction)), "irradiance": value}


def floor_lit(size: float) -> tuple[Scene, Array]:
    """A square on the ground of reflectance .3 with its middle at (2, 2), lit from the side by a sun that no measuring
    plane hides, and its corners."""
    low, high = 2.0 - 0.5 * size, 2.0 + 0.5 * size
    height = np.deg2rad(35.0)
    lux = SUN_LUX / np.sin(height)
    scene = {"type": "scene", **rooms.wall("lit", (low, low, 0), size * X, size * Y, value=_GROUND)}
    scene["sun"] = _sun_lamp((np.cos(height), 0.0, -np.sin(height)), lux)
    return scene, np.array([(low, low, 0), (high, low, 0), (high, high, 0), (low, high, 0)])


def _reflection(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    names = {0.5: "0.5 m", 4.0: "4 m", 500.0: "500 m"}
    for size, what in names.items():
        scene, corners = floor_lit(size)
        places = _places((dict(list(rooms.wall_points(0.0).items())[:-1]), Y), (rooms.floor_points(HEIGHT), -Z))
        # A wall sees only the part of the ground in front of it.
        corners = np.maximum(corners, [-np.inf, 0.0, 0.0])
        whole = floor_lit(size)[1]
        factors = [
            configuration_factor(p, n, corners if n[1] else whole)[0]
            for p, n in zip(places["points"], places["directions"], strict=True)
        ]
        made = Case(
            "5.6", "one diffuse reflection", what, scene, expected=SUN_LUX * _GROUND * np.array(factors), **places
        )
        yield replace(made, methods=("path", "bpt"), max_depth=3, spp=1 << 16)


def wall_lit() -> Scene:
    """A wall of reflectance .6 behind a black box of 4 x .2 x 1 m, lit by a sun 60 degrees high; a black roof keeps
    direct light from the floor."""
    height = np.deg2rad(_SUN_HEIGHT)
    scene: Scene = {"type": "scene", **rooms.wall("lit", (0, DEPTH, 0), WIDTH * X, HEIGHT * Z, value=0.6)}
    scene["sun"] = _sun_lamp((0.0, np.cos(height), -np.sin(height)), SUN_LUX / np.cos(height))
    scene |= rooms.wall("roof", (0, -2.0, HEIGHT), WIDTH * X, 3.0 * Y)
    scene |= rooms.wall("box near", (0, 2.5, 0), WIDTH * X, Z) | rooms.wall("box top", (0, 2.5, 1), WIDTH * X, 0.2 * Y)
    return scene | rooms.wall("box far", (0, 2.7, 0), Z, WIDTH * X)


def wall_seen(points: ArrayLike, normals: ArrayLike) -> Array:
    """Configuration factors of the part of that wall that points at y < 2.5 see above the box."""
    factors = []
    for p, n in zip(np.atleast_2d(points), np.atleast_2d(normals), strict=True):
        edge = 2.7 if p[2] > 1.0 else 2.5
        foot = max(p[2] + (1.0 - p[2]) * (DEPTH - p[1]) / (edge - p[1]), 0.0)
        if foot >= HEIGHT - 1e-9:
            factors.append(0.0)
            continue
        corners = [(0, DEPTH, foot), (WIDTH, DEPTH, foot), (WIDTH, DEPTH, HEIGHT), (0, DEPTH, HEIGHT)]
        factors.append(configuration_factor(p, n, corners)[0])
    return np.array(factors)


def _obstructed(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    places = _places((rooms.wall_points(0.0), Y), (rooms.floor_points(names="GHIJK"), Z))
    lux = SUN_LUX * 0.6 * wall_seen(places["points"], places["directions"])
    made = Case("5.7", "the same with an obstruction", "", wall_lit(), expected=lux, **places)
    yield replace(made, methods=("path", "bpt"), max_depth=3, spp=1 << 16)


def cube(value: float, folder: Path) -> Scene:
    """A closed cube of 4 m with a lamp of 10,000 lm in the middle."""
    path = photometric_file(folder / "isotropic.ies", _isotropic, 1, 180)
    return rooms.room(height=WIDTH, value=value) | {"lamp": _luminaire(path, (2.0, 2.0, 2.0))}


def _closed(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
    """The mean illuminance of a wall: all walls are alike, and what they receive is what the lamp gives and they
    reflect, phi / (1 - rho)."""
    x, weight = gauss([0.0, 0.5 * WIDTH], 8)
    points = np.stack([*(m.ravel() for m in np.meshgrid(x, x, indexing="ij")), np.zeros(len(x) ** 2)], axis=1)
    areas = np.outer(weight, weight).ravel()
    for value in REFLECTANCES:
        mean = np.array([_FLUX / (6.0 * WIDTH**2 * (1.0 - value))])
        made = Case(
            "5.8",
            "closed cube",
            f"{value:g}",
            cube(value, folder),
            points,
            np.tile(Z, (len(x) ** 2, 1)),
            ("mean",),
            mean,
        )
        yield replace(made, weights=areas / areas.sum(), max_depth=-1, spp=1 << 12, methods=("path", "bpt"))


def _sun(side: float) -> tuple[float, float, float]:
    """Towards +y or -y."""
    height = np.deg2rad(_SUN_HEIGHT)
    return 0.0, side * float(np.cos(height)), float(np.sin(height))


def _under_roof(opening: str, kind: int, glazed: bool) -> Scene:
    low, high = _ROOFS[opening]
    scene = rooms.room(roof=((low, high), (low, high))) | {"sky": rooms.sky(kind, _sun(1.0), _SKY_LUX, 0.0)}
    if glazed:
        scene["glass"] = rooms.glass((low, low, HEIGHT), (high - low) * X, (high - low) * Y, INDEX)
    return scene


def _roofs(number: str, glazed: bool) -> Callable[[Sequence[int], Path], Iterator[Case]]:
    def made(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
        places = _places((rooms.wall_points(0.0), Y), (rooms.floor_points(), Z))
        for name, (low, high) in _ROOFS.items():
            opening = Opening(2, (low, low, HEIGHT), (high, high, HEIGHT))
            for kind in kinds:
                outside = Outside(GeneralSky(kind, _sun(1.0)))
                yield Case(
                    number,
                    f"roof opening {name}{', glazed' if glazed else ''}",
                    f"sky {kind}",
                    _under_roof(name, kind, glazed),
                    expected=_through(places, opening, outside, glazed),
                    max_depth=3 if glazed else 2,
                    spp=_LONG if glazed else 1 << 17,
                    **places,
                )

    return made


def _through(places: Mapping[str, Any], opening: Opening, outside: Outside, glazed: bool) -> Array:
    lux = []
    for p, n in zip(places["points"], places["directions"], strict=True):
        cuts = peak(p, opening, outside.sky.sun)
        cuts[2] = [*cuts.get(2, ()), p[2]]  # the horizon
        lux.append(_SKY_LUX * illuminance(p, n, opening, outside.luminance, cuts, glazed))
    return np.array(lux)


def _behind_facade(opening: str, kind: int, glazed: bool, more: Scene) -> Scene:
    hole = _FACADES[opening]
    scene = rooms.room(facade=hole) | {"sky": rooms.sky(kind, _sun(-1.0), _SKY_LUX, _GROUND)} | more
    if glazed:
        (x0, x1), (z0, z1) = hole
        scene["glass"] = rooms.glass((x0, 0.0, z0), (x1 - x0) * X, (z1 - z0) * Z, INDEX)
    return scene


def _opening(name: str) -> Opening:
    (x0, x1), (z0, z1) = _FACADES[name]
    return Opening(1, (x0, 0.0, z0), (x1, 0.0, z1))


def _facades(number: str, glazed: bool) -> Callable[[Sequence[int], Path], Iterator[Case]]:
    def made(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
        floor, above = rooms.floor_points(back=True), [f"{name}'" for name in "GHIJKLMN"]
        places = _places((rooms.wall_points(DEPTH), -Y), (floor, Z), (rooms.floor_points(HEIGHT, above, back=True), -Z))
        for name in _FACADES:
            for kind in kinds:
                outside = Outside(GeneralSky(kind, _sun(-1.0)), _GROUND)
                yield Case(
                    number,
                    f"facade opening {name}{', glazed' if glazed else ''}",
                    f"sky {kind}",
                    _behind_facade(name, kind, glazed, {}),
                    expected=_through(places, _opening(name), outside, glazed),
                    max_depth=3 if glazed else 2,
                    spp=_LONG if glazed else 1 << 17,
                    **places,
                )

    return made


def _masked(number: str) -> Callable[[Sequence[int], Path], Iterator[Case]]:
    def made(kinds: Sequence[int], folder: Path) -> Iterator[Case]:
        places = _places((rooms.floor_points(names="ABCDEFGH", back=True), Z))
        for name, mask in _MASKS[number].items():
            strip = {"mask": rooms.mask(mask.reach, mask.level, mask.top, mask.reflectance)}
            for kind in kinds:
                outside = Outside(GeneralSky(kind, _sun(-1.0)), _GROUND)
                lux = [_SKY_LUX * mask.illuminance(p, _opening("2x1"), outside) for p in places["points"]]
                scene = _behind_facade("2x1", kind, False, strip)
                yield Case(number, name, f"sky {kind}", scene, expected=np.array(lux), max_depth=3, spp=_LONG, **places)

    return made


_MAKERS: dict[str, Callable[[Sequence[int], Path], Iterator[Case]]] = {
    "5.2": _point_lamps,
    "5.3": _area_lamp,
    "5.4": _conservation,
    "5.5": _glass,
    "5.6": _reflection,
    "5.7": _obstructed,
    "5.8": _closed,
    "5.9": _roofs("5.9", False),
    "5.10": _roofs("5.10", True),
    "5.11": _facades("5.11", False),
    "5.12": _facades("5.12", True),
    "5.13": _masked("5.13"),
    "5.14": _masked("5.14"),
}
NUMBERS = tuple(_MAKERS)
