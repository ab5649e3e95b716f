"""Tests of ray casting against a test of each triangle in double precision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import graph

from .report import Finding, Findings
from .surfaces import Array, host, uniform_sphere, vectors

_RAYS, _TRIANGLES = 2048, 512
_QUICK = 4
#: Accepted error of a hit, and least distance from the edges at which a ray must hit a triangle, relative to the
#: scene's extent.
_TOLERANCE = 1e-4
#: Least cosine of a ray that must hit.
_LEAST_COSINE = 1e-2


@dataclass(frozen=True)
class _Triangles:
    """Every triangle of a scene's meshes, and a random selection of them."""

    corners: Array  #: (n, 3, 3)
    first: dict[int, int]  #: number of the first triangle of each mesh, by the mesh's registry number
    chosen: NDArray[np.int64]  #: numbers of the selected triangles


def check_ray_casting(
    scene: mi.Scene, component: str = "ray casting", *, variants: Sequence[str] = (), quick: bool = False, seed: int = 0
) -> list[Finding]:
    """Test a loaded scene's ray casting on its meshes, with random rays, half of them aimed at triangles.

    ``hits``: each hit is on the triangle that it reports. ``misses``: no triangle of a random selection is hit before
    it. ``variant NAME``, for other Mitsuba variants: rays hit the selection as the test in double precision does. The
    variant is set during the test and restored afterwards; other threads must not use Mitsuba meanwhile.
    """
    rng = np.random.default_rng([seed, 0x4A75])
    rays = _RAYS // (_QUICK if quick else 1)
    findings = Findings(component)
    triangles = _collect(scene, _TRIANGLES // (_QUICK if quick else 1), rng)
    if triangles is None:
        return []
    box = scene.bbox()
    low, high = (np.asarray(v, np.float64).ravel() for v in (box.min, box.max))
    extent = float(np.linalg.norm(high - low))
    beyond = np.maximum(0.1 * (high - low), 0.05 * extent)  # also of a flat scene
    origin = rng.uniform(low - beyond, high + beyond, (rays, 3)).astype(np.float32).astype(np.float64)
    aim = triangles.corners[rng.choice(triangles.chosen, rays)]
    target = np.einsum("rk,rkc->rc", rng.dirichlet((1.0, 1.0, 1.0), rays), aim)
    d = np.where(np.arange(rays)[:, None] % 2 == 0, target - origin, uniform_sphere(rng, rays))
    d = (d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-30)).astype(np.float32).astype(np.float64)

    every = triangles.corners[triangles.chosen]
    surely, perhaps = _nearest(origin, d, every, extent)
    with findings.trying("hits"):
        _check_scene(findings, scene, triangles, origin, d, surely, extent)
    for variant in variants:
        with findings.trying(f"variant {variant}"):
            _check_variant(findings, variant, every, origin, d, surely, perhaps, extent)
    return findings.rows


def _collect(scene: mi.Scene, count: int, rng: np.random.Generator) -> _Triangles | None:
    corners, first, total = [], {}, 0
    for mesh in scene.shapes():
        if not mesh.is_mesh():
            continue
        points = np.asarray(mesh.vertex_positions_buffer(), np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces_buffer()).reshape(-1, 3)
        # A 'rectangle' is a mesh, but its hits report no triangle.
        if "vertex_positions" in dict(graph.contents(mesh).values):
            number = dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))
            first[int(np.asarray(number).ravel()[0])] = total
        corners.append(points[faces])
        total += len(faces)
    if not total:
        return None
    chosen = np.sort(rng.choice(total, min(count, total), replace=False))
    return _Triangles(np.concatenate(corners), first, chosen)


def _nearest(o: Array, d: Array, triangles: Array, extent: float) -> tuple[Array, Array]:
    """Distance along each ray to the nearest triangle that it must hit, and to the nearest one that it may hit (edges,
    grazing rays)."""
    surely, perhaps = np.full(len(o), np.inf), np.full(len(o), np.inf)
    for start in range(0, len(o), 256):
        part = slice(start, start + 256)
        t, inside, cos, height = _cross(o[part, None], d[part, None], triangles[None])
        slack = _TOLERANCE * extent
        ahead = t > slack
        sure = ahead & (inside > slack) & (cos > _LEAST_COSINE)
        may = (t > -slack) & (inside > -slack)
        # A ray within the plane, as nearly as it is known, meets it anywhere.
        t = np.where((cos <= _LEAST_COSINE) & (height <= slack), 0.0, t)
        may |= t == 0.0
        surely[part] = np.where(sure, t, np.inf).min(1)
        perhaps[part] = np.where(may & ~sure, t, np.inf).min(1)
    return surely, perhaps


def _cross(o: Array, d: Array, corners: Array) -> tuple[Array, Array, Array, Array]:
    """Distance along a ray to a triangle's plane, :func:`_inside` there, cosine to the normal, and distance of the
    ray's origin from the plane."""
    n = _normal(corners)
    along, height = (d * n).sum(-1), ((corners[..., 0, :] - o) * n).sum(-1)
    flat = np.abs(along) < 1e-12
    t = np.where(flat, np.inf, height / np.where(flat, 1.0, along))
    p = o + np.where(np.isfinite(t), t, 0.0)[..., None] * d
    return t, _inside(p, corners), np.abs(along), np.abs(height)


def _inside(p: Array, corners: Array) -> Array:
    """Distance of points in a triangle's plane to its edges (in scene units, negative outside)."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    n, twice = _normal(corners), _length(np.cross(b - a, c - a))
    safe = np.where(twice > 0.0, twice, 1.0)
    longest = np.maximum(np.maximum(_length(b - a), _length(c - b)), _length(a - c))
    # Distances to the edges are barycentric coordinates times heights; a lower bound with the least height.
    weights = [(np.cross(v - u, p - u) * n).sum(-1) / safe for u, v in ((a, b), (b, c), (c, a))]
    inside = np.minimum(np.minimum(*weights[:2]), weights[2]) * (safe / np.maximum(longest, 1e-30))
    result: Array = np.where(twice > 0.0, inside, -np.inf)
    return result


def _normal(corners: Array) -> Array:
    n = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    length = _length(n)
    result: Array = n / np.where(length > 0.0, length, 1.0)[..., None]
    return result


def _length(v: Array) -> Array:
    return np.linalg.norm(v, axis=-1)


def _check_scene(
    findings: Findings, scene: mi.Scene, triangles: _Triangles, o: Array, d: Array, surely: Array, extent: float
) -> None:
    rays = len(o)
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(np.ascontiguousarray(o.T, np.float32)), vectors(d)))
    number = dr.reinterpret_array(mi.UInt32, si.shape)
    nested = dr.reinterpret_array(mi.UInt32, si.instance)
    results = (si.t, si.prim_index, number, nested, si.is_valid())
    dr.eval(*results)
    t, face, shape, instance, valid = (host(v, rays) for v in results)
    t = np.where(valid > 0.0, t, np.inf)
    first = np.array([triangles.first.get(int(s), -1) for s in shape])
    known = (valid > 0.0) & (first >= 0) & (instance == 0)
    corners = triangles.corners[(first + face.astype(np.int64))[known]]
    points, slack = o[known] + t[known, None] * d[known], _TOLERANCE * extent
    off = np.abs(((points - corners[:, 0]) * _normal(corners)).sum(-1)) > slack
    wrong = int((off | (_inside(points, corners) < -slack)).sum())
    findings.judge(
        "hits",
        float(wrong),
        0.0,
        f"number of {int(known.sum())} hits that are not on the triangle that they report",
        f"{wrong} of {int(known.sum())} hits are not on the triangle that they report; check the mesh for very large "
        "or small coordinates, and move it to the origin",
    )
    missed = int((t > surely + slack).sum())
    aimed = int(np.isfinite(surely).sum())
    findings.judge(
        "misses",
        float(missed),
        0.0,
        f"number of {aimed} rays at {len(triangles.chosen)} triangles that pass through a triangle",
        f"{missed} of {aimed} rays pass through a triangle, so light leaks; check the mesh for very large or small "
        "coordinates",
    )


def _check_variant(
    findings: Findings, variant: str, every: Array, o: Array, d: Array, surely: Array, perhaps: Array, extent: float
) -> None:
    rays = slice(0, 512)
    with mi.variant_context(variant):
        mesh = mi.Mesh("triangles", 3 * len(every), len(every))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = every.astype(np.float32).ravel()
        parameters["faces"] = np.arange(3 * len(every), dtype=np.uint32)
        parameters.update()
        alone = mi.load_dict({"type": "scene", "mesh": mesh})
        if variant.startswith("scalar"):
            found = np.array(
                [
                    alone.ray_intersect_preliminary(mi.Ray3f(list(p), list(v))).t
                    for p, v in zip(o[rays], d[rays], strict=True)
                ]
            )
        else:
            ray = mi.Ray3f(mi.Point3f(np.ascontiguousarray(o[rays].T, np.float32)), vectors(d[rays]))
            found = np.asarray(alone.ray_intersect_preliminary(ray).t, np.float64)
    slack = _TOLERANCE * extent
    clear = surely[rays] < perhaps[rays]
    clear |= ~np.isfinite(surely[rays]) & ~np.isfinite(perhaps[rays])
    with np.errstate(invalid="ignore"):
        same = (found == surely[rays]) | (np.abs(found - surely[rays]) * _LEAST_COSINE < slack)
    wrong = int((clear & ~same).sum())
    findings.judge(
        f"variant {variant}",
        float(wrong),
        0.0,
        f"number of {int(clear.sum())} rays at {len(every)} triangles that hit another one under this variant",
        f"{wrong} of {int(clear.sum())} rays hit another triangle under {variant}; report this with the scene",
    )
