"""The recursive weights against brute force.

A path x_0 (light) ... x_k (camera) is given by the numbers that its densities are made of: squared lengths, cosines,
densities of scattering both ways. Here every technique's density is multiplied out from first principles, in double
precision, edge by edge; :class:`etendue.transport.Mis` must give each technique ``(n p)^beta / sum (n p)^beta``.

A specular vertex scatters with the same density both ways, as the recursion has it [Georgiev 2012b, eq. 53]; it is a
number here (1), since it enters every technique that does not vanish alike.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tables import crossed, thinned

from etendue.core import OptionError, on_device
from etendue.transport import GRAZING, WIDE, Counts, Mis, Passing, SingleTechnique, Techniques

#: Random paths for each pattern of specular vertices.
COPIES = 8
LIGHTS = ("area", "delta", "infinite", "sphere")
Key = tuple[str, int]


class Paths:
    """Random paths of ``k`` edges, ``COPIES`` for each pattern of specular inner vertices, one lane each. ``chooses``:
    connections prefer some light vertices; ``varies``: the merging disc differs from vertex to vertex; ``media``: edges
    pass media of three colours, and half of the vertices that are not specular are in one."""

    def __init__(
        self,
        k: int,
        light: str,
        seed: int = 1,
        splattable: bool = True,
        pick: float = 0.3,
        chooses: bool = False,
        varies: bool = False,
        media: bool = False,
    ) -> None:
        random = np.random.default_rng(seed + 100 * k + 7 * LIGHTS.index(light))
        self.k, self.light, self.splattable = k, light, splattable
        patterns = list(itertools.product((False, True), repeat=k - 1)) * COPIES
        #: [lane, j - 1]: whether x_j is specular.
        self.specular = np.array(patterns, bool).reshape(len(patterns), k - 1)
        self.lanes = len(patterns)

        def draw(low: float, high: float, *shape: int) -> np.ndarray:
            return np.exp(random.uniform(np.log(low), np.log(high), (*shape, self.lanes)))

        self.d2 = draw(0.2, 5.0, k)  # edge j joins x_j and x_{j+1}
        self.cos_in = draw(0.2 * GRAZING, 1.0, k + 1)  # at x_j, of the edge to x_{j-1}
        self.cos_out = draw(0.1, 1.0, k + 1)  # at x_j, of the edge to x_{j+1}
        self.forward = draw(0.05, 3.0, k)  # solid-angle density at x_j of scattering on to x_{j+1}
        self.reverse = draw(0.05, 3.0, k)  # ... of scattering back to x_{j-1}
        for j in range(1, k):
            self.forward[j][self.is_specular(j)] = self.reverse[j][self.is_specular(j)] = 1.0
        self.pixel = draw(1.0, 100.0) if splattable else np.zeros(self.lanes)  # camera ray, per solid angle
        self.cos_light = self.cos_out[0]
        match light:
            case "area":
                self.p_direct = pick * draw(0.1, 10.0)  # per area
                self.p_emit = self.p_direct * self.cos_light / np.pi  # per area and solid angle
            case "sphere":  # next event draws its points by the point that is lit
                self.p_direct = pick * draw(0.1, 10.0)
                self.p_emit = pick * draw(0.1, 10.0) * self.cos_light / np.pi
            case "delta":
                self.p_direct = np.full(self.lanes, pick)
                self.p_emit = pick * draw(0.05, 1.0)  # per solid angle
                self.cos_light = np.ones(self.lanes)
            case "infinite":
                self.p_direct = pick * draw(0.05, 2.0)  # per solid angle
                self.p_emit = self.p_direct / (np.pi * draw(1.0, 9.0))  # and area of the scene's disc
                self.cos_light = np.ones(self.lanes)
        self.chooses = chooses
        #: Of edge j: the probability of x_j as a light vertex for x_{j+1}, over that of a uniform choice.
        self.ratio = draw(0.2, 20.0, k) if chooses else np.ones((k, self.lanes))
        self.varies = varies
        #: Area of the merging disc at x_j, relative to the largest.
        self.share = draw(0.01, 1.0, k) if varies else np.ones((k, self.lanes))

        self.media = media
        #: Of edge j by channel: the probability of passing it; and extinction at x_j, 1 on a surface.
        self.passing = np.exp(-draw(0.01, 3.0, k, 3)) if media else np.ones((k, 3, self.lanes))
        self.extinction = np.ones((k + 1, 3, self.lanes))
        for j in range(1, k) if media else ():
            inside = ~self.is_specular(j) & (random.random(self.lanes) < 0.5)
            self.extinction[j][:, inside] = draw(0.1, 5.0, 3)[:, inside]
            self.cos_in[j][inside] = self.cos_out[j][inside] = 1.0

    def found(self, edge: int, j: int) -> np.ndarray:
        """Factor of an edge on the density of finding its end x_j, beside cosine and distance."""
        return np.mean(self.passing[edge] * self.extinction[j], axis=0)

    def is_specular(self, j: int) -> np.ndarray:
        return self.specular[:, j - 1]

    def smooth(self, j: int) -> np.ndarray:
        """Whether inner vertex x_j can be joined or merged."""
        return ~self.is_specular(j)

    # ---- densities of sub-paths, multiplied out

    def light_density(self, j: int) -> np.ndarray:
        """Of a light sub-path x_0 .. x_j made by emission and scattering (j >= 1)."""
        p = self.p_emit * self.cos_in[1] * self.found(0, 1)
        if self.light != "infinite":  # else it is the disc's area, projected onto the surface: no distance
            p = p / self.d2[0]
        for i in range(1, j):
            p = p * self.forward[i] * self.cos_in[i + 1] * self.found(i, i + 1) / self.d2[i]
        return p

    def camera_density(self, j: int) -> np.ndarray:
        """Of a camera sub-path x_{k-1} .. x_j, given the pixel (1 <= j, or 0 for a hit of the light)."""
        # A sensor that cannot be splatted from still traces rays: its density is common to all that is left.
        last = self.k - 1
        p = (self.pixel if self.splattable else 1.0) * self.cos_out[last] * self.found(last, last) / self.d2[last]
        for i in range(self.k - 1, j, -1):
            if i == 1 and self.light == "infinite":
                p = p * self.reverse[1] * self.found(0, 0)  # per solid angle: the light has no place
            else:
                p = p * self.reverse[i] * self.cos_out[i - 1] * self.found(i - 1, i - 1) / self.d2[i - 1]
        return p

    # ---- techniques

    def merged(self, j: int, t: Techniques) -> np.ndarray:
        """Share of the light vertices x_j that are merged."""
        if j == 1:
            return np.full(self.lanes, 0.0 if t.leaves_direct else 1.0)
        return np.where(self.smooth(j - 1) & (self.forward[j - 1] <= WIDE), t.diffuse, 1.0)

    def products(self, t: Techniques, eta: float, light_paths: float) -> dict[Key, np.ndarray]:
        """(family, where) -> n p of every technique, zero where it cannot make the path."""
        k, result = self.k, {}
        hits = t.emission * self.camera_density(0) if t.emission and self.light != "delta" else np.zeros(self.lanes)
        if k > 1 and t.connects:
            result["emission", 0] = hits
        if k > 1 and t.next_event:
            result["next_event", 1] = self.smooth(1) * t.next_event * self.camera_density(1) * self.p_direct
        if t.connection:
            for j in range(1, k - 1):
                product = t.connection * self.ratio[j] * self.light_density(j) * self.camera_density(j + 1)
                result["connection", j] = (self.smooth(j) & self.smooth(j + 1)) * product
        if k > (2 if t.leaves_direct else 1) and t.splat and self.splattable:
            result["splat", k - 1] = self.smooth(k - 1) * light_paths * self.light_density(k - 1)
        if t.merge:
            for j in range(2 if t.leaves_direct else 1, k if t.merge_first else k - 1):
                merges = self.smooth(j) & ((self.cos_in[j] >= GRAZING) | (not t.connects))
                count = eta * self.share[j] * self.merged(j, t)
                result["merge", j] = merges * count * self.light_density(j) * self.camera_density(j)
        if ("emission", 0) not in result:  # without connecting: what nothing else can make
            result["emission", 0] = np.where(sum(result.values(), np.zeros(self.lanes)) > 0.0, 0.0, hits)
        return result

    def expected(self, t: Techniques, eta: float, light_paths: float) -> dict[Key, np.ndarray]:
        """The weights, by definition; NaN where nothing makes the path."""
        powers = {key: value**t.beta for key, value in self.products(t, eta, light_paths).items()}
        total = sum(powers.values())
        with np.errstate(invalid="ignore"):
            return {key: value / total for key, value in powers.items()}

    # ---- the same through the recursion

    def computed(
        self,
        keys: Iterable[Key],
        t: Techniques,
        eta: float,
        light_paths: float,
        more: Iterable[float] = (),
        candidates: Iterable[Counts] = (),
    ) -> dict[Key, np.ndarray]:
        """The weights of the techniques ``keys``, as the walks and joints would compute them; those of ``eta``, with
        ``more`` radii in the same walk. With ``candidates``, their ratios: (candidates, lanes)."""
        k = self.k
        mis = Mis(t, [mi.Float(value) for value in (*more, eta)], mi.Float(light_paths), list(candidates))
        here = [mis.at(share if self.varies else None) for share in _floats(self.share)]
        delta = mi.Bool(self.light == "delta")
        d2, cos_in, cos_out = (_floats(v) for v in (self.d2, self.cos_in, self.cos_out))
        forward, reverse = _floats(self.forward), _floats(self.reverse)
        chances = _floats(self.ratio)
        direct, emit, cos_light, pixel = _floats([self.p_direct, self.p_emit, self.cos_light, self.pixel])

        def passing(edge: int, start: int, end: int) -> Passing | None:
            if not self.media:
                return None
            return Passing(*_floats([self.found(edge, end), self.found(edge, start)]))

        def passed(state: Any, edge: Passing | None) -> Any:
            return state if edge is None else mis.passed(*state, edge)

        def factor(edge: int, j: int) -> Any:
            return _floats([self.found(edge, j)])[0] if self.media else 1.0

        merged = [None, *(_floats([self.merged(j, t)])[0] if t.waits else None for j in range(1, k))]
        light: dict[int, Any] = {}
        waiting = mi.Float(0.7) if self.light == "sphere" else direct  # the density is known at the first hit
        state = mis.start_light(waiting, emit, cos_light, delta)
        for j in range(1, k):
            if j == 1 and self.light == "sphere":
                state = mis.lit(state[0], direct / waiting), state[1]
            distance = mi.Float(1.0) if j == 1 and self.light == "infinite" else d2[j - 1]
            state = mis.hit(*passed(state, passing(j - 1, j - 1, j)), distance, cos_in[j])
            state = light[j] = mis.chosen(state[0], chances[j - 1] if j > 1 and self.chooses else None), state[1]
            specular = on_device(mi.Bool, self.is_specular(j))
            pdfs = forward[j], reverse[j]
            state = here[j].scatter_light(*state, cos_in[j], cos_out[j], *pdfs, specular, merged[j])

        camera: dict[int, Any] = {}
        state = mis.start_camera(pixel)
        left = mis.nothing_left(1)
        for j in range(k - 1, 0, -1):
            edge = passing(j, j + 1, j)
            state = mis.hit(*passed(state, edge), d2[j], cos_out[j])
            chosen = chances[j] if j < k - 1 and self.chooses else None
            specular = on_device(mi.Bool, self.is_specular(j))
            if left is not None:
                d_vc = mis.completed(state[1], mis.landed(left, cos_out[j], edge), forward[j], specular)
                state = state[0], d_vc
            state = camera[j] = mis.joined(depth(k, j), state[0], chosen), state[1]
            if left is not None:
                left = here[j].left_out(depth(k, j), state[0], cos_in[j], reverse[j], specular)
            state = here[j].scatter_camera(depth(k, j), *state, cos_in[j], reverse[j], forward[j], specular)
        state = passed(state, passing(0, 1, 0))
        cos = mi.Float(1.0) if self.light == "infinite" else cos_out[0]
        if self.light != "infinite":
            state = mis.hit(*state, d2[0], cos)
        if left is not None and not t.leaves_direct:
            state = state[0], mis.completed(state[1], mis.landed(left, cos, passing(0, 1, 0)))

        weights = {}
        for family, j in keys:
            match family:
                case "emission":
                    weight = mis.emission_weight(depth(k, 0), *state, direct, emit)
                case "next_event":
                    pdf = direct
                    if self.light != "infinite":
                        pdf = pdf * d2[0] / cos_light
                    ratio = emit * cos_in[1] / (pdf * cos_light) * factor(0, 1)
                    hit = mi.Float(0.0) if self.light == "delta" else reverse[1] * factor(0, 0)
                    weight = here[1].next_event_weight(depth(k, 1), *camera[1], cos_in[1], hit, forward[1], pdf, ratio)
                case "connection":
                    to_light = reverse[j + 1] * cos_out[j] / d2[j] * factor(j, j)
                    to_camera = forward[j] * cos_in[j + 1] / d2[j] * factor(j, j + 1)
                    ends = camera[j + 1], light[j]
                    cosines = cos_in[j + 1], cos_in[j]
                    weight = here[j + 1].connection_weight(
                        depth(k, j + 1),
                        *ends,
                        *cosines,
                        to_light,
                        to_camera,
                        forward[j + 1],
                        reverse[j],
                        forward[j],
                        chances[j] if self.chooses else None,
                        merged[j],
                        here[j],
                    )
                case "splat":
                    density = pixel * cos_out[j] / d2[j] * factor(j, j)
                    weight = here[j].splat_weight(*light[j], cos_in[j], reverse[j], density, merged[j])
                case _:
                    weight = here[j].merge_weight(camera[j], light[j], reverse[j], forward[j], merged[j])
            weights[family, j] = weight.ratios if candidates else weight[-1]
        dr.eval(weights)
        if candidates:
            return {key: np.stack([np.broadcast_to(np.array(r), self.lanes) for r in w]) for key, w in weights.items()}
        return {key: np.broadcast_to(np.array(w, np.float64), self.lanes) for key, w in weights.items()}


def depth(k: int, j: int) -> Any:
    """Edges from the camera to x_j."""
    return mi.UInt32(k - j)


def _floats(values: Any) -> list[Any]:
    return [on_device(mi.Float, v) for v in values]


def check(paths: Paths, t: Techniques, eta: float = 0.3, light_paths: float = 12.0, more: Iterable[float] = ()) -> int:
    """Every weight, and their sum. Returns how many weights there were."""
    expected = paths.expected(t, eta, light_paths)
    computed = paths.computed(expected, t, eta, light_paths, more)
    count, total = 0, np.zeros(paths.lanes)
    for key, weight in expected.items():
        own = weight > 0.0
        what = f"{key} of {paths.k} edges, {paths.light} light, {t}, specular {paths.specular[own][:8]}"
        np.testing.assert_allclose(computed[key][own], weight[own], rtol=2e-4, err_msg=what)
        total[own] += computed[key][own]
        count += int(own.sum())
    makeable = np.isfinite(sum(expected.values()))
    np.testing.assert_allclose(total[makeable], 1.0, rtol=1e-4, err_msg=f"{paths.light} {t}")
    return count


VCM = Techniques()
BPT = Techniques(merge=False)
BPM = Techniques(emission=1, next_event=0, connection=0, splat=False, merge=True)
#: One row a set of techniques.
TABLE = {
    "vcm": VCM,
    "vcm, no merge at the first vertex": Techniques(merge_first=False),
    "vcm, direct light by next event": Techniques(direct=False),
    "vcm, direct light by next event, no merge at the first vertex": Techniques(
        direct=False, merge_first=False, next_event=2, beta=2
    ),
    "merging and next event": Techniques(1, 1, 0, False, True, direct=False),
    "bpt, direct light by next event": Techniques(merge=False, connection=2, direct=False),
    "no next event": Techniques(next_event=0, direct=False),
    "vcm, a tenth of diffuse light": Techniques(diffuse=0.1),
    "vcm, a tenth of diffuse light, direct light by next event": Techniques(connection=2, direct=False, diffuse=0.1),
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


@pytest.mark.parametrize(("light", "beta"), crossed(LIGHTS, (1, 2), 2))
@pytest.mark.parametrize("name", thinned(TABLE, [*list(TABLE)[::2], *(name for name, t in TABLE.items() if t.thins)]))
def test_weights_are_those_of_the_definition(name, light, beta):
    """All patterns of specular vertices, one to five edges."""
    techniques = dataclasses.replace(TABLE[name], beta=beta)
    assert sum(check(Paths(k, light), techniques) for k in (1, 2, 3, 4, 5)) > 0
    if techniques.connection:
        assert sum(check(Paths(k, light, chooses=True), techniques) for k in (3, 4, 5)) > 0
    if techniques.merge:
        assert sum(check(Paths(k, light, varies=True), techniques) for k in (2, 3, 4, 5)) > 0
    assert sum(check(Paths(k, light, varies=techniques.merge, media=True), techniques) for k in (1, 2, 3, 4, 5)) > 0


@pytest.mark.parametrize("beta", [1, 2])
@pytest.mark.parametrize(("eta", "light_paths"), [(1e-4, 1.0), (30.0, 0.25), (0.02, 5000.0)])
def test_any_radius_and_number_of_light_paths(eta, light_paths, beta):
    for light in LIGHTS:
        assert check(Paths(4, light, seed=5), Techniques(connection=2, beta=beta), eta, light_paths) > 0


@pytest.mark.parametrize(("light", "beta"), crossed(LIGHTS, (1, 2), 4))
@pytest.mark.parametrize("name", [name for name, t in TABLE.items() if t.merge])
def test_several_radii_in_one_walk(name, light, beta):
    """The recursion without a radius, filled in last, gives the same weights."""
    techniques = dataclasses.replace(TABLE[name], beta=beta)
    chooses = bool(techniques.connection)
    for media in (False, True):
        paths = [Paths(k, light, chooses=chooses, varies=True, media=media) for k in (2, 3, 4)]
        assert sum(check(some, techniques, more=(2.0, 0.01)) for some in paths) > 0


#: Connections, eta and light paths.
OTHER_COUNTS = ((0, 0.0, 0.0), (0, 0.0, 3.0), (4, 0.0, 3.0), (0, 0.7, 24.0), (2, 0.05, 1.5))


@pytest.mark.parametrize(("light", "beta"), crossed(LIGHTS, (1, 2), 4))
@pytest.mark.parametrize("name", [name for name, t in TABLE.items() if t.merge and t.emission and t.next_event])
def test_denominators_for_other_counts(name, light, beta):
    """The ratio of the weights' denominators is that of the sums of all densities times their counts."""
    t, eta, light_paths = dataclasses.replace(TABLE[name], beta=beta), 0.3, 12.0
    candidates = [Counts(float(n), float(k), e) for k, e, n in OTHER_COUNTS]
    checked = 0
    for k in (2, 3, 4):
        paths = Paths(k, light, chooses=bool(t.connection), varies=True, media=k > 2)
        used = paths.products(t, eta, light_paths)
        total = sum(product**beta for product in used.values())
        ratios = paths.computed(used, t, eta, light_paths, candidates=candidates)
        for i, (connections, other_eta, other_paths) in enumerate(OTHER_COUNTS):
            other = dataclasses.replace(t, connection=connections)
            sums = sum(p**beta for p in paths.products(other, other_eta, other_paths).values())
            with np.errstate(divide="ignore", invalid="ignore"):
                expected = np.minimum(total / sums, 1e6)  # the bound where a candidate cannot sample a path
            for key, product in used.items():
                own = product > 0.0
                np.testing.assert_allclose(ratios[key][i][own], expected[own], rtol=1e-3, err_msg=f"{key} {k} {i}")
                checked += int(own.sum())
    assert checked > 0


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("unit", [1e4, 1e-4])
def test_power_heuristic_in_other_units(light, unit):
    """Lengths enter it by their fourth power: no sum of the recursion may leave single precision."""
    paths = Paths(4, light, seed=3)
    paths.d2 = paths.d2 * unit**2
    if light != "infinite":
        paths.p_direct = paths.p_direct / (unit**2 if light != "delta" else 1.0)
    if light != "delta":
        paths.p_emit = paths.p_emit / unit**2
    assert check(paths, Techniques(beta=2), 0.3 * unit**2) > 0


@pytest.mark.parametrize("light", LIGHTS)
def test_a_direction_that_cannot_be_splatted(light):
    """Where the sensor has no density the splat is no technique; the others sum to one without it."""
    for k, t in itertools.product((2, 3, 4), (VCM, BPT)):
        paths = Paths(k, light, splattable=False)
        assert ("splat", k - 1) not in paths.products(t, 0.3, 12.0)
        assert check(paths, t) > 0


def test_vcm_has_every_technique():
    """Four edges, all smooth: a hit, a next event, two connections, a splat and three merges."""
    inner = {("connection", 1), ("connection", 2), ("merge", 1), ("merge", 2), ("merge", 3)}
    assert set(Paths(4, "area").products(VCM, 0.3, 12.0)) == {("emission", 0), ("next_event", 1), ("splat", 3)} | inner


@pytest.mark.parametrize("light", ["area", "infinite", "sphere"])
@pytest.mark.parametrize("name", ["vcm", "bpt", "path", "bpm"])
def test_a_light_seen_directly_has_weight_one(name, light):
    """Hits at the first vertex compete with nothing: no technique joins a light point to the camera."""
    weight = Paths(1, light).computed([("emission", 0)], TABLE[name], 0.3, 12.0)["emission", 0]
    np.testing.assert_array_equal(weight, 1.0)


def test_a_single_technique_refuses_to_leave_direct_light_to_next_event():
    parts: dict[str, Any] = dict.fromkeys(("visibility", "lights", "camera", "max_edges"))
    SingleTechnique(mis=Mis(BPT, [0.0], 1.0), **parts)
    with pytest.raises(OptionError, match="direct=True"):
        SingleTechnique(mis=Mis(dataclasses.replace(BPT, direct=False), [0.0], 1.0), **parts)
