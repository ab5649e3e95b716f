"""The recursive weights against brute force.

A path x_0 (light) ... x_k (camera) is given by the numbers that its densities are made of: squared lengths, cosines,
densities of scattering both ways. Here every technique's density is multiplied out from first principles, in double
precision, edge by edge; :class:`etendue.transport.Mis` must give each technique ``(n p)^beta / sum (n p)^beta``.

A specular vertex scatters with the same density both ways, as the recursion has it [Georgiev 2012b, eq. 53]; it is a
number here (1), since it enters every technique that does not vanish alike.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from etendue.transport import Mis, Techniques

LANES = 64
LIGHTS = ("area", "delta", "infinite")


@dataclass
class Path:
    """``LANES`` random paths of ``k`` edges that share their pattern of specular inner vertices."""

    k: int
    specular: tuple[bool, ...]  #: of x_1 .. x_{k-1}
    light: str
    seed: int = 1
    splattable: bool = True
    pick: float = 0.3
    numbers: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        random = np.random.default_rng(self.seed + 100 * self.k + 7 * LIGHTS.index(self.light))
        k = self.k

        def draw(low: float, high: float, *shape: int) -> np.ndarray:
            return np.exp(random.uniform(np.log(low), np.log(high), (*shape, LANES)))

        self.d2 = draw(0.2, 5.0, k)  # edge j joins x_j and x_{j+1}
        self.cos_in = draw(0.1, 1.0, k + 1)  # at x_j, of the edge to x_{j-1}
        self.cos_out = draw(0.1, 1.0, k + 1)  # at x_j, of the edge to x_{j+1}
        self.forward = draw(0.05, 3.0, k)  # solid-angle density at x_j of scattering on to x_{j+1}
        self.reverse = draw(0.05, 3.0, k)  # ... of scattering back to x_{j-1}
        for j in range(1, k):
            if self.is_specular(j):
                self.forward[j] = self.reverse[j] = 1.0
        self.pixel = draw(1.0, 100.0) if self.splattable else np.zeros(LANES)  # camera ray, per solid angle
        self.cos_light = self.cos_out[0]
        match self.light:
            case "area":
                self.p_direct = self.pick * draw(0.1, 10.0)  # per area
                self.p_emit = self.p_direct * self.cos_light / np.pi  # per area and solid angle
            case "delta":
                self.p_direct = np.full(LANES, self.pick)
                self.p_emit = self.pick * draw(0.05, 1.0)  # per solid angle
                self.cos_light = np.ones(LANES)
            case "infinite":
                self.p_direct = self.pick * draw(0.05, 2.0)  # per solid angle
                self.p_emit = self.p_direct / (np.pi * draw(1.0, 9.0))  # and area of the scene's disc
                self.cos_light = np.ones(LANES)

    def is_specular(self, j: int) -> bool:
        return 1 <= j < self.k and self.specular[j - 1]

    def smooth(self, j: int) -> bool:
        """Whether x_j is an inner vertex that can be joined or merged."""
        return 1 <= j < self.k and not self.specular[j - 1]

    # ---- densities of sub-paths, multiplied out

    def light_density(self, j: int) -> np.ndarray:
        """Of a light sub-path x_0 .. x_j made by emission and scattering (j >= 1)."""
        if self.light == "infinite":
            p = self.p_emit * self.cos_in[1]  # the disc's area projected onto the surface: no distance
        else:
            p = self.p_emit * self.cos_in[1] / self.d2[0]
        for i in range(1, j):
            p = p * self.forward[i] * self.cos_in[i + 1] / self.d2[i]
        return p

    def camera_density(self, j: int) -> np.ndarray:
        """Of a camera sub-path x_{k-1} .. x_j, given the pixel (1 <= j, or 0 for a hit of the light)."""
        # A sensor that cannot be splatted from still traces rays: its density is common to all that is left.
        p = (self.pixel if self.splattable else 1.0) * self.cos_out[self.k - 1] / self.d2[self.k - 1]
        for i in range(self.k - 1, j, -1):
            if i == 1 and self.light == "infinite":
                p = p * self.reverse[1]  # per solid angle: the light has no place
            else:
                p = p * self.reverse[i] * self.cos_out[i - 1] / self.d2[i - 1]
        return p

    # ---- techniques

    def techniques(self, t: Techniques, eta: float, light_paths: float) -> dict[tuple[str, int], np.ndarray]:
        """(family, where) -> n p, of every technique that can make this path."""
        k, result = self.k, {}
        if k == 1:
            return {("emission", 0): np.ones(LANES)} if t.emission and self.light != "delta" else {}
        if t.emission and t.connects and self.light != "delta":
            result["emission", 0] = t.emission * self.camera_density(0)
        if t.next_event and self.smooth(1):
            result["next_event", 1] = t.next_event * self.camera_density(1) * self.p_direct
        if t.connection:
            for j in range(1, k - 1):
                if self.smooth(j) and self.smooth(j + 1):
                    result["connection", j] = t.connection * self.light_density(j) * self.camera_density(j + 1)
        if t.splat and self.splattable and self.smooth(k - 1):
            result["splat", k - 1] = light_paths * self.light_density(k - 1)
        if t.merge:
            for j in range(1, k):
                if self.smooth(j) and (t.merge_first or j < k - 1):
                    result["merge", j] = eta * self.light_density(j) * self.camera_density(j)
        if not result and t.emission and self.light != "delta":
            result["emission", 0] = self.camera_density(0)  # without connecting: what nothing else can make
        return result

    def expected(self, t: Techniques, eta: float, light_paths: float) -> dict[tuple[str, int], np.ndarray]:
        """The weights, by definition."""
        products = {key: value**t.beta for key, value in self.techniques(t, eta, light_paths).items()}
        total = sum(products.values())
        return {key: value / total for key, value in products.items()}

    # ---- the same through the recursion

    def computed(self, t: Techniques, eta: float, light_paths: float) -> dict[tuple[str, int], np.ndarray]:
        """The weights of every technique of :meth:`techniques`, as the walks and joints would compute them."""
        k = self.k
        mis = Mis(t, mi.Float(eta), mi.Float(light_paths))
        delta = mi.Bool(self.light == "delta")
        d2, cos_in, cos_out = (_floats(v) for v in (self.d2, self.cos_in, self.cos_out))
        forward, reverse = _floats(self.forward), _floats(self.reverse)
        direct, emit, cos_light, pixel = _floats([self.p_direct, self.p_emit, self.cos_light, self.pixel])

        light: dict[int, Any] = {}
        state = mis.start_light(direct, emit, cos_light, delta)
        for j in range(1, k):
            distance = mi.Float(1.0) if j == 1 and self.light == "infinite" else d2[j - 1]
            state = light[j] = mis.hit(*state, distance, cos_in[j])
            state = mis.scatter_light(*state, cos_out[j], forward[j], reverse[j], mi.Bool(self.is_specular(j)))

        camera: dict[int, Any] = {}
        state = mis.start_camera(pixel)
        for j in range(k - 1, 0, -1):
            state = camera[j] = mis.hit(*state, d2[j], cos_out[j])
            specular = mi.Bool(self.is_specular(j))
            state = mis.scatter_camera(depth(k, j), *state, cos_in[j], reverse[j], forward[j], specular)
        if self.light != "infinite":
            state = mis.hit(*state, d2[0], cos_out[0])

        weights = {}
        for family, j in self.techniques(t, eta, light_paths):
            match family:
                case "emission":
                    weight = mis.emission_weight(depth(k, 0), *state, direct, emit)
                case "next_event":
                    pdf = direct
                    if self.light != "infinite":
                        pdf = pdf * d2[0] / cos_light
                    ratio = emit * cos_in[1] / (pdf * cos_light)
                    hit = mi.Float(0.0) if self.light == "delta" else reverse[1]
                    weight = mis.next_event_weight(depth(k, 1), *camera[1], hit, forward[1], pdf, ratio)
                case "connection":
                    to_light = reverse[j + 1] * cos_out[j] / d2[j]
                    to_camera = forward[j] * cos_in[j + 1] / d2[j]
                    ends = camera[j + 1], light[j]
                    weight = mis.connection_weight(
                        depth(k, j + 1), *ends, to_light, to_camera, forward[j + 1], reverse[j]
                    )
                case "splat":
                    weight = mis.splat_weight(*light[j], reverse[j], pixel * cos_out[j] / d2[j])
                case _:
                    weight = mis.merge_weight(depth(k, j), camera[j], light[j], reverse[j], forward[j])
            weights[family, j] = np.broadcast_to(np.array(weight, np.float64), LANES)
        return weights


def depth(k: int, j: int) -> Any:
    """Edges from the camera to x_j."""
    return mi.UInt32(k - j)


def _floats(values: Any) -> list[Any]:
    return [mi.Float(np.asarray(v, np.float32)) for v in values]


def patterns(k: int) -> list[tuple[bool, ...]]:
    """Which inner vertices are specular: all ways."""
    return list(itertools.product((False, True), repeat=k - 1))


def check(path: Path, t: Techniques, eta: float = 0.3, light_paths: float = 12.0) -> int:
    """Every weight, and their sum. Returns how many techniques the path has."""
    expected, computed = path.expected(t, eta, light_paths), path.computed(t, eta, light_paths)
    for key, weight in expected.items():
        what = f"{key} of {path.k} edges, specular {path.specular}, {path.light}, {t}"
        np.testing.assert_allclose(computed[key], weight, rtol=2e-4, atol=1e-6, err_msg=what)
    if expected:
        np.testing.assert_allclose(sum(computed.values()), 1.0, rtol=1e-4, err_msg=f"{path.specular} {path.light} {t}")
    return len(expected)


VCM = Techniques()
BPT = Techniques(merge=False)
BPM = Techniques(emission=1, next_event=0, connection=0, splat=False, merge=True)
#: One row a set of techniques.
TABLE = {
    "vcm": VCM,
    "vcm, no merge at the first vertex": Techniques(merge_first=False),
    "vcm, three connections": Techniques(connection=3),
    "vcm, two next events": Techniques(next_event=2),
    "vcm, counts mixed": Techniques(next_event=2, connection=3, merge_first=False),
    "vcm without connections": Techniques(connection=0),
    "vcm without next event": Techniques(next_event=0),
    "vcm without splats": Techniques(splat=False),
    "vcm without emission hits": Techniques(emission=0),
    "bpt": BPT,
    "bpt, three connections": Techniques(connection=3, merge=False),
    "bpt, two next events": Techniques(next_event=2, merge=False),
    "bpt without connections": Techniques(connection=0, merge=False),
    "bpt without next event": Techniques(next_event=0, merge=False),
    "bpt without splats": Techniques(splat=False, merge=False),
    "path": Techniques(connection=0, splat=False, merge=False),
    "light": Techniques(emission=0, next_event=0, connection=0, splat=True, merge=False),
    "bpm": BPM,
    "bpm, no merge at the first vertex": Techniques(1, 0, 0, False, True, merge_first=False),
}


@pytest.mark.parametrize("beta", [1, 2])
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("name", TABLE)
def test_weights_are_those_of_the_definition(name, light, beta):
    """All patterns of specular vertices, two to five edges."""
    techniques = Techniques(**(TABLE[name].__dict__ | {"beta": beta}))
    count = sum(check(Path(k, specular, light), techniques) for k in (1, 2, 3, 4, 5) for specular in patterns(k))
    assert count > 0


@pytest.mark.parametrize("beta", [1, 2])
@pytest.mark.parametrize(("eta", "light_paths"), [(1e-4, 1.0), (30.0, 0.25), (0.02, 5000.0)])
def test_any_radius_and_number_of_light_paths(eta, light_paths, beta):
    for light, specular in itertools.product(LIGHTS, patterns(4)):
        check(Path(4, specular, light, seed=5), Techniques(connection=2, beta=beta), eta, light_paths)


@pytest.mark.parametrize("light", LIGHTS)
def test_a_direction_that_cannot_be_splatted(light):
    """Where the sensor has no density the splat is no technique; the others sum to one without it."""
    for k, t in itertools.product((2, 3, 4), (VCM, BPT)):
        for specular in patterns(k):
            path = Path(k, specular, light, splattable=False)
            assert ("splat", k - 1) not in path.techniques(t, 0.3, 12.0)
            check(path, t)


def test_vcm_has_every_technique():
    """Four edges, all smooth: a hit, a next event, two connections, a splat and three merges."""
    path = Path(4, (False, False, False), "area")
    keys = set(path.techniques(VCM, 0.3, 12.0))
    inner = {("connection", 1), ("connection", 2), ("merge", 1), ("merge", 2), ("merge", 3)}
    assert keys == {("emission", 0), ("next_event", 1), ("splat", 3)} | inner


def test_a_light_seen_directly_has_weight_one():
    """Hits at the first vertex compete with nothing: no technique joins a light point to the camera."""
    for t, light in itertools.product((VCM, BPT, BPM), ("area", "infinite")):
        weight = Path(1, (), light).computed(t, 0.3, 12.0)["emission", 0]
        np.testing.assert_array_equal(weight, 1.0)
