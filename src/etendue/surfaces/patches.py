"""Patches: flat faces in space, grouped, each group with one reflectance and one emission."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, InNotebooks, free_memory
from etendue.scene import warn_of_steps

from .coincident import Coincident
from .errors import PatchError
from .faces import face_vectors, flat_faces
from .periods import checked_period, endless_faces
from .revolution import Rings, checked_profile, revolved
from .subdivision import subdivide

Index = NDArray[np.int64]
Number = TypeVar("Number", bound=np.generic)

#: Bytes for each patch made by subdivision (measured: 460).
_BYTES = 500
#: Attributes that :meth:`Patches.arrays` contains.
_ARRAYS = (
    *("vertices", "faces", "face_areas", "face_normals", "labels", "front", "back", "_fronts", "_sheets"),
    *("numbers", "face", "reflectance", "emission", "sky"),
)


class Patches(InNotebooks):
    """Patches of constant radiosity, each made of flat triangles and quadrilaterals.

    A face has two sides. Its front, from which the corners are seen counterclockwise, belongs to a patch; its back
    belongs to another patch if it is ``two_sided``; otherwise it belongs to none and only occludes. Patches seen from
    the front come first, in order of their faces or ``ids``; the backs of sheets follow, in the same order.

    Parameters
    ----------
    vertices: (v, 3).
    faces: (m, 3), (m, 4), or m rows of three or four indices. A quadrilateral that is not flat and convex becomes two
        triangles of the same patch.
    reflectance: diffuse, in [0, 1]: a number, one for each patch (n,), or with channels (n, c); (1, c) is one
        colour for all.
    emission: emitted power per area (for a Lambertian light of radiance L: pi L), in the same forms.
    ids: (m,) whole numbers, faces with equal numbers form a patch; by default each face is one. Patches are in
        ascending order of these numbers, which are kept in ``labels``.
    two_sided: whether the backs are patches too: one answer, or one for each patch (n,). Backs get the reflectance of
        the front and no emission, unless ``reflectance`` and ``emission`` have rows for them (see above).
    sky: radiosity of the surroundings, seen in directions without a face: a number, or (c,).
    left_out: indices of faces that are left out, such as those without area. Their patches keep their rows: a patch
        without any other face is ``empty``. It has area, reflectance and emission zero, and sees nothing.
    numbers: (m,) numbers of the faces, for ``face``; by default their indices.
    obstacles: indices of faces that only occlude: neither side belongs to a patch, and both are as dark as a back.
    periodic: the lengths (Lx, Ly) of a domain that is repeated without end along x and y, 0 for no repetition; z is up.
        The faces are those of one period. What leaves it at a side enters it at the opposite side, at the same height.
    rings: the rings that the faces stand for, see :meth:`revolved`; areas are theirs.

    Raises :class:`PatchError` for invalid input: no face, a vertex that is not finite, a face without area, an index
    out of range, a reflectance outside [0, 1], a negative emission, faces that exceed the period.

    Attributes
    ----------
    faces: (f, 4) vertex indices; a triangle repeats its last index.
    numbers: (f,) the number of the face that each of them is, or is a part of.
    face_areas, face_normals: (f,), (f, 3).
    front, back: (f,) the patch of each side of a face, -1 for a side that belongs to none: a back, or an obstacle's.
    areas, normals, centres: (n,), (n, 3), (n, 3), of patches; the normal is the mean over the patch.
    reflectance, emission: (n, c).
    sky: (c,).
    face: (n,) the number of the first face of each patch, for example in the mesh file.
    labels: (n,) the number in ``ids``, or the index of the face; a back has the label of its front.
    shapes, shape_names: (n,) the shape of a scene, or the object of a mesh file, to which each patch belongs, -1 for
        none; and the names of the shapes. ``shapes`` is ``None`` if they are not known.
    zones: (n,) the zone of a building that each patch faces, of files of zones; ``None`` if there are none.
    period: the lengths of ``periodic``, ``None`` if there is no repetition.
    files: names of the mesh files of the patches, and the number of the first face of each.
    rings: of surfaces of revolution; ``None`` for others.
    """

    shapes: Index | None = None
    shape_names: tuple[str, ...] = ()
    zones: NDArray[np.str_] | None = None
    period: tuple[float, float] | None = None
    files: tuple[tuple[str, int], ...] = ()
    rings: Rings | None = None

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike | Sequence[Sequence[int]],
        *,
        reflectance: ArrayLike = 0.0,
        emission: ArrayLike = 0.0,
        ids: ArrayLike | None = None,
        two_sided: ArrayLike = False,
        sky: ArrayLike = 0.0,
        left_out: ArrayLike = (),
        numbers: ArrayLike | None = None,
        obstacles: ArrayLike = (),
        periodic: Sequence[float] | None = None,
        rings: Rings | None = None,
    ) -> None:
        self.vertices: Array = _vertices(vertices)
        quads, rows = flat_faces(self.vertices, faces)
        count = int(rows[-1]) + 1
        labels = np.arange(count) if ids is None else _whole("ids", ids, count)
        number = np.arange(count) if numbers is None else _whole("numbers", numbers, count)
        ours = ~np.isin(np.arange(count), np.asarray(obstacles, dtype=np.int64))
        if not ours.any():
            raise PatchError(f"all {count} faces are obstacles; a radiosity problem needs one patch at least")
        self.labels, first, inverse = np.unique(labels[ours], return_index=True, return_inverse=True)
        patch = np.full(count, -1, dtype=np.int64)
        patch[ours] = inverse.reshape(-1)
        kept = ~np.isin(rows, np.asarray(left_out, dtype=np.int64))
        self.faces, rows = quads[kept], rows[kept]
        self.face_areas, self.face_normals = _faces_with_area(self.vertices, self.faces, rows)
        if rings is not None:
            self.rings = Rings(rings.profile, rings.of[rows])
            flat = np.bincount(self.rings.of, self.face_areas, len(rings.profile))
            self.face_areas = self.face_areas * (rings.areas / np.where(flat > 0, flat, 1.0))[self.rings.of]
        self.numbers: Index = number[rows]
        self.front: Index = patch[rows]
        fronts = len(self.labels)

        sheets = np.asarray(two_sided, dtype=bool)
        if sheets.shape not in ((), (fronts,)):
            raise PatchError(f"two_sided is one answer or one for each of {fronts} patches, not {sheets.shape}")
        sheets = np.broadcast_to(sheets, (fronts,))
        back = np.full(fronts + 1, -1, dtype=np.int64)  # the last is that of obstacles
        back[:-1][sheets] = fronts + np.arange(np.count_nonzero(sheets))
        self.back: Index = back[self.front]
        self._fronts, self._sheets = fronts, np.flatnonzero(sheets)
        self.labels, self.face = (self._both_sides(x) for x in (self.labels, number[ours][first]))
        self._set_properties(reflectance, emission, sky)
        if periodic is not None:
            self.period = checked_period(periodic, *self.bounds)

    @classmethod
    def revolved(cls, profile: ArrayLike, **properties: Any) -> Patches:
        """Surfaces of revolution about z: ring k, a patch, has the ends r, z and r, z of ``profile[k]``, (k, 4).

        The front is to the left of the way from the first end to the second, with r to the right and z up. Exact form
        factors are those of round rings, and so are areas; faces, which lines and rays meet, are those of polygons with
        64 corners. properties: ``reflectance``, ``emission``, ``two_sided`` and ``sky``. Raises :class:`PatchError` for
        radii below zero, rings without area, and rings that lie on each other.
        """
        ends = checked_profile(profile)
        vertices, faces, of = revolved(ends)
        return cls(vertices, faces, ids=of, numbers=of, rings=Rings(ends, of), **properties)

    def _set_properties(self, reflectance: ArrayLike, emission: ArrayLike, sky: ArrayLike) -> None:
        rho = np.where(self.empty[:, None], 0.0, self._spread("reflectance", reflectance, backs=1.0))
        exitance = np.where(self.empty[:, None], 0.0, self._spread("emission", emission, backs=0.0))
        light = np.atleast_1d(np.asarray(sky, dtype=np.float64))
        if light.ndim != 1 or not np.isfinite(light).all() or (light < 0).any():
            raise PatchError("the sky has one number for each channel, not negative and finite")
        for name, x, ok in (
            ("reflectance", rho, (rho >= 0) & (rho <= 1)),
            ("emission", exitance, (exitance >= 0) & np.isfinite(exitance)),
        ):
            bad = np.flatnonzero(~ok.all(axis=1))
            if len(bad):
                bounds = "must not be negative, nor infinite"
                if x is rho:
                    bounds = "must be in [0, 1]"
                if np.isnan(x[bad]).any():
                    bounds = "must be numbers"
                raise PatchError(
                    f"{name} of {len(bad)} patches {bounds}; the first is patch {bad[0]} with {x[bad[0]].tolist()}"
                )
        channels = {x.shape[-1] for x in (rho, exitance, light)} - {1}
        if len(channels) > 1:
            raise PatchError(
                f"reflectance has {rho.shape[1]} channels, emission {exitance.shape[1]}, the sky {len(light)}: give "
                "them the same number, or one"
            )
        shape = (len(self), max(channels, default=1))
        self.reflectance: Array = np.broadcast_to(rho, shape).copy()
        self.emission: Array = np.broadcast_to(exitance, shape).copy()
        self.sky: Array = np.broadcast_to(light, shape[1:]).copy()

    def _spread(self, name: str, value: ArrayLike, backs: float) -> Array:
        """``value`` for each patch, (n, channels) or (n, 1); ``backs`` scales the value of a front for its back."""
        try:
            x = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            raise PatchError(f"{name} is a number, (n,) or (n, channels)") from None
        if x.ndim < 2:
            x = x.reshape(-1, 1)
        if x.ndim != 2 or x.shape[1] == 0:
            raise PatchError(f"{name} is a number, (n,) or (n, channels), not an array of shape {x.shape}")
        if len(x) == 1:
            x = np.broadcast_to(x, (self._fronts, x.shape[1]))
        if len(x) == self._fronts:
            x = np.concatenate([x, backs * x[self._sheets]])
        if len(x) != len(self):
            also = f" (or {len(self)} with the backs)" if len(self) > self._fronts else ""
            raise PatchError(f"{name} has {len(x)} rows for {self._fronts} patches{also}")
        return x

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that defines these patches, as arrays; :meth:`of_arrays` is the inverse."""
        known = {name: np.asarray(getattr(self, name)) for name in _ARRAYS}
        if self.shapes is not None:
            known["shapes"] = self.shapes
            known["shape_names"] = np.array(self.shape_names, dtype=str)
        if self.zones is not None:
            known["zones"] = self.zones
        if self.period is not None:
            known["period"] = np.array(self.period)
        if self.rings is not None:
            known["profile"], known["ring"] = self.rings.profile, self.rings.of
        if self.files:
            known["files"] = np.array([name for name, _ in self.files])
            known["firsts"] = np.array([first for _, first in self.files])
        return known

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Patches:
        """The patches of :meth:`arrays`, bit by bit."""
        patches = cls.__new__(cls)
        for name in _ARRAYS:
            setattr(patches, name, arrays[name])
        patches._fronts = int(arrays["_fronts"])
        if "shapes" in arrays:
            patches.shapes, patches.shape_names = arrays["shapes"], tuple(map(str, arrays["shape_names"]))
        patches.zones = arrays.get("zones")
        if "period" in arrays:
            patches.period = float(arrays["period"][0]), float(arrays["period"][1])
        if "profile" in arrays:
            patches.rings = Rings(arrays["profile"], arrays["ring"])
        if "files" in arrays:
            patches.files = tuple(zip(arrays["files"].tolist(), arrays["firsts"].tolist(), strict=True))
        return patches

    def __len__(self) -> int:
        return self._fronts + len(self._sheets)

    def __repr__(self) -> str:
        return f"Patches({len(self)} patches of {len(self.faces)} faces, {self.channels} channels)"

    @property
    def channels(self) -> int:
        """Colours or bands of reflectance and emission."""
        return self.reflectance.shape[1]

    @property
    def fronts(self) -> int:
        """Patches seen from the front; those from this index on are backs of sheets."""
        return self._fronts

    @cached_property
    def other_side(self) -> Index:
        """(n,) the patch on the other side of a sheet, -1 where there is none."""
        other = np.full(len(self), -1, dtype=np.int64)
        backs = self._fronts + np.arange(len(self._sheets))
        other[self._sheets], other[backs] = backs, self._sheets
        return other

    @cached_property
    def areas(self) -> Array:
        """(n,)"""
        return self._both_sides(self._totals(self.face_areas))

    @property
    def sides(self) -> Index:
        """(f, 2) the patches of the front and the back of each face, n + 1 for a side that belongs to none."""
        sides = np.stack([self.front, self.back], axis=1)
        return np.where(sides < 0, len(self) + 1, sides)

    @property
    def empty(self) -> NDArray[np.bool_]:
        """(n,) patches without a face, because it was left out."""
        return self.areas == 0

    @cached_property
    def divisors(self) -> Array:
        """(n,) the areas to divide by: 1 for empty patches, whose sums are zero."""
        return np.where(self.empty, 1.0, self.areas)

    @property
    def names(self) -> NDArray[np.str_]:
        """(n,) the name of the shape of each patch, empty where there is none."""
        known = np.array([*self.shape_names, ""], dtype=str)
        return known[np.full(len(self), -1) if self.shapes is None else self.shapes]

    @cached_property
    def normals(self) -> Array:
        """(n, 3) unit vectors; the mean for a patch that is not flat, zero if the mean vanishes."""
        summed = self._sums(self.face_normals)
        length = np.linalg.norm(summed, axis=1, keepdims=True)
        is_turned = length > 1e-9 * self._totals(self.face_areas)[:, None]
        normals = self._both_sides(np.divide(summed, length, out=np.zeros_like(summed), where=is_turned))
        normals[self._fronts :] *= -1
        return normals

    @cached_property
    def centres(self) -> Array:
        """(n, 3); zero for empty patches."""
        middle = self.vertices[self.faces].mean(axis=1)
        triangle = self.faces[:, 2] == self.faces[:, 3]
        middle[triangle] = self.vertices[self.faces[triangle, :3]].mean(axis=1)
        return self._both_sides(self._sums(middle)) / self.divisors[:, None]

    def _sums(self, of_faces: Array) -> Array:
        weighted = of_faces * self.face_areas[:, None]
        return np.stack([self._totals(column) for column in weighted.T], axis=1)

    def _totals(self, of_faces: Array) -> Array:
        """(fronts,) sums over the faces of each patch."""
        seen = self.front >= 0
        return np.bincount(self.front[seen], of_faces[seen], self._fronts).astype(np.float64)

    def _both_sides(self, fronts: NDArray[Number]) -> NDArray[Number]:
        return np.concatenate([fronts, fronts[self._sheets]])

    @cached_property
    def coincident(self) -> Coincident:
        """Faces that lie on each other."""
        return Coincident.of(self)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Corners of the smallest box around all faces."""
        used = self.vertices[np.unique(self.faces)]
        return used.min(axis=0), used.max(axis=0)

    @cached_property
    def sphere(self) -> tuple[Array, float]:
        """Centre and radius of a sphere around all faces: centred in the box, with the smallest possible radius."""
        centre = (self.bounds[0] + self.bounds[1]) / 2
        used = self.vertices[np.unique(self.faces)]
        return centre, float(np.sqrt(((used - centre) ** 2).sum(axis=1).max()))

    def subdivided(self, max_area: float, *, grouped: bool = False) -> Patches:
        """The same surfaces in patches of at most ``max_area``: each larger face is divided into equal parts.

        Every resulting face is a patch, and keeps reflectance and emission; ``labels`` and ``face`` are those of the
        original patches and faces. Surfaces without end along y become strips, rings become rings. grouped: the parts
        stay in their patches instead. Raises :class:`PatchError` for an area that is not positive, and for more faces
        than memory can hold.
        """
        if not np.isfinite(max_area) or max_area <= 0:
            raise PatchError(f"the largest area of a patch must be a positive number, not {max_area!r}")
        count, free = float(self.face_areas.sum()) / max_area, free_memory()
        if free is not None and _BYTES * count > free:
            raise PatchError(
                f"faces of at most {max_area:g} would be {count:.2g} or more and need {_BYTES * count / 1e9:.3g} GB; "
                f"{free / 1e9:.1f} GB are free: allow larger ones"
            )
        if self.rings is not None:
            return self._divided_rings(self.rings, max_area, grouped)
        strips = endless_faces(self.vertices, self.faces, self.period)
        whole = self.faces if strips is None else strips
        vertices, faces, source = subdivide(self.vertices, whole, max_area, strips is not None)
        # Empty patches have a face without area, which is left out again.
        empty = np.flatnonzero(self.empty[: self._fronts])
        number = np.concatenate([self.numbers[source], self.face[empty]])
        order = np.argsort(number, kind="stable")
        front = np.concatenate([self.front[source], empty])[order]
        seen = front[front >= 0]
        back = self.other_side[seen]
        sides = np.arange(len(self)) if grouped else np.concatenate([seen, back[back >= 0]])
        result = Patches(
            vertices,
            np.concatenate([faces, np.zeros((len(empty), 4), np.int64)])[order],
            reflectance=self.reflectance[sides],
            emission=self.emission[sides],
            ids=front if grouped else None,
            two_sided=self.other_side[: self._fronts] >= 0 if grouped else back >= 0,
            sky=self.sky,
            left_out=np.flatnonzero(order >= len(source)),
            numbers=number[order],
            obstacles=np.flatnonzero(front < 0),
        )
        result._name_as(self, sides)
        return result

    def _divided_rings(self, rings: Rings, max_area: float, grouped: bool) -> Patches:
        profile, source = rings.divided(max_area)
        vertices, faces, of = revolved(profile)
        face = np.unique(rings.of, return_index=True)[1][source]
        front = self.front[face]
        back = self.other_side[front]
        sides = np.arange(len(self)) if grouped else np.concatenate([front, back[back >= 0]])
        result = Patches(
            vertices,
            faces,
            reflectance=self.reflectance[sides],
            emission=self.emission[sides],
            ids=front[of] if grouped else of,
            two_sided=self.other_side[: self._fronts] >= 0 if grouped else back >= 0,
            sky=self.sky,
            numbers=self.numbers[face][of],
            rings=Rings(profile, of),
        )
        result._name_as(self, sides)
        return result

    def of_files(self, names: Sequence[str]) -> NDArray[np.bool_]:
        """(n,) the patches of some of the ``files``. Raises :class:`PatchError` for a name of none, and of several."""
        known = [name for name, _ in self.files]
        for name in names:
            if known.count(name) != 1:
                what = "there is no file" if name not in known else "there are several files"
                raise PatchError(f"{what} '{name}' among those of the patches: {', '.join(known)}")
        number = np.searchsorted([first for _, first in self.files], self.face, side="right") - 1
        return np.isin(number, [known.index(name) for name in names])

    def _name_as(self, other: Patches, patches: Index) -> None:
        """Take labels, shapes and zones from ``patches`` (n,) of another mesh, its files and its period."""
        self.period, self.files = other.period, other.files
        self.labels = other.labels[patches]
        self.shapes, self.shape_names = None if other.shapes is None else other.shapes[patches], other.shape_names
        self.zones = None if other.zones is None else other.zones[patches]

    def only(self, chosen: ArrayLike, *, obstacles: bool = False) -> tuple[Patches, Index]:
        """The ``chosen`` (n,) patches with their labels, and the index that each of them has here.

        Empty patches are left out, and obstacles unless they are asked for. Both sides of a sheet stay together: only
        the choice of fronts counts. Raises :class:`PatchError` for none.
        """
        kept = np.flatnonzero((np.asarray(chosen, dtype=bool) & ~self.empty)[: self._fronts])
        faces = np.isin(self.front, kept)
        if not faces.any():
            raise PatchError("no patch is chosen")
        faces |= obstacles & (self.front < 0)
        used, corners = np.unique(self.faces[faces], return_inverse=True)
        backs = self.other_side[kept]
        numbers = np.concatenate([kept, backs[backs >= 0]])
        result = Patches(
            self.vertices[used],
            corners.reshape(-1, 4),
            reflectance=self.reflectance[numbers],
            emission=self.emission[numbers],
            ids=self.front[faces],
            two_sided=backs >= 0,
            sky=self.sky,
            numbers=self.numbers[faces],
            obstacles=np.flatnonzero(self.front[faces] < 0),
            rings=None if self.rings is None else self.rings.some(faces),
        )
        result._name_as(self, numbers)
        if result.shapes is not None:  # without those of which no patch is chosen
            used = np.unique(result.shapes[result.shapes >= 0])
            result.shapes = np.where(result.shapes < 0, -1, np.searchsorted(used, result.shapes))
            result.shape_names = tuple(result.shape_names[k] for k in used)
        return result, numbers

    def with_properties(
        self, reflectance: ArrayLike | None = None, emission: ArrayLike | None = None, sky: ArrayLike | None = None
    ) -> Patches:
        """The same patches with another reflectance, emission or sky, such as those of another band or hour. Stored
        lines (:class:`Segments`) and form factors remain valid for them. Raises :class:`PatchError`."""
        result = object.__new__(Patches)
        result.__dict__.update(self.__dict__)
        result._set_properties(
            self.reflectance if reflectance is None else reflectance,
            self.emission if emission is None else emission,
            self.sky if sky is None else sky,
        )
        return result


def _vertices(values: ArrayLike) -> Array:
    try:
        vertices = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise PatchError("vertices are an array of numbers, (v, 3)") from None
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise PatchError(f"vertices are an array (v, 3), not one of shape {vertices.shape}")
    broken = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(broken):
        raise PatchError(
            f"{len(broken)} of {len(vertices)} vertices are not finite, first {broken[0]}; repair the mesh"
        )
    warn_of_rounded("patches", np.asarray(values))
    return vertices


def warn_of_rounded(name: str, vertices: NDArray[Any]) -> None:
    """Warn if ``vertices`` (v, 3) have single precision, whose steps are large for their distances."""
    if len(vertices) and vertices.dtype == np.float32:
        size = float(np.linalg.norm(np.ptp(vertices.astype(np.float64), axis=0))) / 2
        warn_of_steps(name, float(np.abs(vertices).max()), size, "give vertices of double precision")


def _faces_with_area(vertices: Array, faces: Index, rows: Index) -> tuple[Array, Array]:
    vectors, is_flat_point = face_vectors(vertices, faces)
    if is_flat_point.any():
        first = int(rows[np.argmax(is_flat_point)])
        raise PatchError(
            f"{np.count_nonzero(is_flat_point)} of {len(faces)} faces have no area, the first is face {first}; name "
            "them as left_out (read_patches and scene_patches do)"
        )
    length = np.linalg.norm(vectors, axis=1)
    return length / 2, vectors / length[:, None]


def _whole(name: str, given: ArrayLike, count: int) -> Index:
    values = np.asarray(given)
    if values.shape != (count,) or values.dtype.kind not in "iu":
        raise PatchError(f"{name} are whole numbers, one for each of {count} faces, not {values.dtype} {values.shape}")
    return values.astype(np.int64)
