"""Pictures of meshes: which face a ray hits, by brute force; fronts only; near faces before far ones."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.display import MeshView, mesh_picture
from etendue.surfaces import box


def hit_by_rays(vertices, faces, view, size, two_sided):
    """The nearest face in front that the ray through each pixel hits, with every triangle tried."""
    width, height = size
    inverse = np.linalg.inv(view.matrix)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    ways = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
    best, shown = np.full((height, width), np.inf), np.full((height, width), -1)
    for number, (a, b, c, d) in enumerate(faces):
        for corners in ((a, b, c), (a, c, d)):
            p, q, r = (vertices[k] - view.eye for k in corners)
            normal = np.cross(q - p, r - p)
            if not normal.any():
                continue
            with np.errstate(divide="ignore", invalid="ignore"):
                t = (normal @ p) / (ways @ normal)
                point = t[..., None] * ways
                inside = t > 0
                for one, other in ((p, q), (q, r), (r, p)):
                    inside &= np.cross(other - one, point - one) @ normal >= 0
            front = ways @ normal < 0
            nearer = inside & (t < best) & (front | two_sided)
            best[nearer], shown[nearer] = t[nearer], np.where(front, number, number + len(faces))[nearer]
    return shown


@pytest.mark.parametrize("two_sided", [False, True])
def test_each_pixel_shows_the_face_that_its_ray_hits(two_sided):
    rng = np.random.default_rng(8)
    room, faces = box([0, 0, 0], [4, 3, 2], 3, inward=True)
    thing, more = box([1, 1, 0.4], [2, 2.3, 1.1], 2)
    shards = rng.uniform([0, 0, 0], [4, 3, 2], (12, 1, 3)) + rng.normal(0, 0.3, (12, 3, 3))
    triangles = np.arange(36).reshape(12, 3)[:, [0, 1, 2, 2]] + len(room) + len(thing)
    vertices = np.concatenate([room, thing, shards.reshape(-1, 3)])
    faces = np.concatenate([faces, more + len(room), triangles])
    ahead, up = np.array([0.3, 1.0, -0.2]), np.array([0.0, 0.0, 1.0])
    right = np.cross(ahead, up)
    corner = ahead - 0.6 * right + 0.5 * up
    inside = MeshView.from_corners("inside", [1.7, 0.2, 1.2], [corner, corner + 1.2 * right, corner - up])
    outside = MeshView.around("outside", vertices, [-0.5, 0.75, -0.55], [0, 0, 1], 4 / 3)
    for view in (inside, outside):
        shown = mesh_picture(vertices, faces, view, (40, 30), two_sided)
        expected = hit_by_rays(vertices, faces, view, (40, 30), two_sided)
        assert (shown != expected).mean() < 0.005  # rays along an edge
        assert len(set(shown.ravel().tolist())) > 12
    assert (mesh_picture(vertices, faces, outside, (40, 30)) == -1).any()  # all of the mesh is in the picture


def test_nothing_is_in_front_of_an_empty_view():
    vertices, faces = box([0, 0, 0], [1, 1, 1])
    away = MeshView.from_corners("away", [0.5, -1, 0.5], [[-1, -1, 1], [1, -1, 1], [-1, -1, -1]])
    assert (mesh_picture(vertices, faces, away, (8, 6)) == -1).all()
