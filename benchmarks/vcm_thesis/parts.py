"""What merging and connecting contribute early and late (table 5.5 of the thesis), and whether pictures of several
radii are better together (section 6.1)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from etendue import film
from etendue.core import Array, Measurement, Replica
from etendue.display import tonemap, write_png

from ..measuring import Record, spread
from ..options import Out, ReferenceSeconds, Seeds, Size
from ..racing import TRIM, Entrant
from .entrants import RADIUS, merging, open_scene
from .options import OUT, SIZE, SPECULAR, Passes, ReferenceMethod, ReferenceRadius, Scenes
from .references import recipe

#: Passes of the early pictures are this share of those of the late ones: the thesis's are of 1 and 60 minutes.
_EARLY = 1 / 60
#: Factors on the radius whose pictures are combined, and the side of the tiles that have weights of their own.
_FACTORS = (0.5, 1.0, 2.0)
_TILE = 16


def measure(
    scenes: Scenes = SPECULAR, size: Size = SIZE, passes: Passes = 240, seeds: Seeds = 3, out: Out = OUT
) -> Record:
    """Two rows for each scene; and pictures of the first seed."""
    record = Record(
        f"Parts of VCM, {size[0]}x{size[1]}",
        ("", "passes", "merging", "splats", "in the 1 % of the pixels that merging lights most"),
    )
    for name in scenes:
        shares: dict[int, list[list[float]]] = {}
        for seed in range(seeds):
            for made, layers in _parts(name, size, passes, seed):
                shares.setdefault(made, []).append(_shares(layers))
                for layer, picture in layers.items() if seed == 0 else ():
                    out.mkdir(parents=True, exist_ok=True)
                    write_png(out / f"parts-{name}-{made}-{layer}.png", tonemap(picture, 0.0))
        for made, found in shares.items():
            record.add(name, f"{made}", *(spread(values, ".3f") for values in zip(*found, strict=True)))
    record.notes += [
        f"share of the luminance of the picture, median (min … max) of {seeds} seeds",
        f"settings of the thesis, first radius {1000 * RADIUS:g} mm, no merging at the first camera vertex; splats: "
        "light paths connected to the camera",
        "thesis: merging finds reflected caustics, and less as the radius shrinks; caustics that are seen directly "
        "come from light tracing",
    ]
    return record


def _parts(name: str, size: tuple[int, int], passes: int, seed: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """(passes, layers) early and late."""
    settings = merging("vcm", merge_first=False, samples_per_pass=1, split_layers=True)
    replica = Replica(Entrant("vcm", "vcm", settings).prepared(open_scene(name, size), seed), seed)
    total: Measurement | None = None
    for number in range(passes):
        total = _and(total, replica.step(number))
        if number + 1 in (max(1, round(passes * _EARLY)), passes):
            yield number + 1, {layer: total.mean(layer).astype(np.float32) for layer in total.sums}


def _shares(layers: Mapping[str, Any]) -> list[float]:
    light = {layer: picture @ np.asarray(film.LUMINANCE) for layer, picture in layers.items()}
    most = light["merge"] >= np.quantile(light["merge"], 0.99)
    whole = light["image"].mean()
    found = [light[layer].mean() / whole for layer in ("merge", "splat")]
    return [*found, light["merge"][most].mean() / light["image"][most].mean()]


def combined(
    scenes: Scenes = SPECULAR,
    size: Size = SIZE,
    passes: Passes = 64,
    seeds: Seeds = 3,
    reference_seconds: ReferenceSeconds = 60.0,
    method: ReferenceMethod = "vcm",
    millimetres: ReferenceRadius = 2.0,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene: pictures of three radii from the same paths, and their combinations."""
    for name in scenes:
        truth = recipe(name, method, millimetres).find(size, out, reference_seconds)
        record = Record(
            f"Pictures of several radii together, {name}, {size[0]}x{size[1]}, {passes} passes",
            ("", "RMS", "to the best alone"),
        )
        rows: dict[str, list[float]] = {}
        weights: dict[str, list[Array]] = {}
        for seed in range(seeds):
            for label, (picture, used) in _combinations(name, size, passes, seed, truth.image).items():
                rows.setdefault(label, []).append(film.luminance_rmse(picture, truth.image, TRIM) ** 2)
                weights.setdefault(label, []).append(used)
        best = min(np.mean(values) for label, values in rows.items() if label.endswith("mm"))
        for label, values in rows.items():
            mean = np.mean(weights[label], axis=0)
            shown = f" ({', '.join(f'{weight:.2f}' for weight in mean)})" if mean.ndim == 1 else ""
            record.add(label + shown, f"{np.mean(values) ** 0.5:.4f}", f"{(np.mean(values) / best) ** 0.5:.3f}")
        record.notes += [
            f"root of the mean of {seeds} seeds, weights of the radii in brackets; vcm with the thesis's settings. "
            "One run makes all pictures, so their noise is correlated",
            "extrapolated: bias in proportion to r² removed from the smaller two. Best: weights of least squares "
            "against the reference itself, which nobody has: a bound on what any choice of weights can gain, for the "
            f"picture and for each tile of {_TILE}x{_TILE} pixels",
            f"reference: {truth.note}",
        ]
        yield record


def _combinations(name: str, size: tuple[int, int], passes: int, seed: int, truth: Any) -> dict[str, tuple[Any, Array]]:
    """Pictures by what they are, each with its weights of the three radii."""
    factors = ",".join(f"{factor:g}" for factor in _FACTORS if factor != 1.0)
    settings = merging("vcm", merge_first=False, radii=factors, samples_per_pass=1)
    replica = Replica(Entrant("vcm", "vcm", settings).prepared(open_scene(name, size), seed), seed)
    total: Measurement | None = None
    for number in range(passes):
        total = _and(total, replica.step(number))
    assert total is not None
    pictures = np.stack([total.mean("image" if f == 1.0 else f"radius_{f:g}") for f in _FACTORS])
    light, exact = pictures @ np.asarray(film.LUMINANCE), truth @ np.asarray(film.LUMINANCE)

    def mixed(weights: Array) -> tuple[Any, Array]:
        return np.tensordot(weights, pictures, axes=1).astype(np.float32), weights

    made = {f"{1000 * RADIUS * f:g} mm": mixed(np.eye(len(_FACTORS))[k]) for k, f in enumerate(_FACTORS)}
    made["mean"] = mixed(np.full(len(_FACTORS), 1.0 / len(_FACTORS)))
    small, large = _FACTORS[0] ** 2, _FACTORS[1] ** 2
    made["extrapolated"] = mixed(np.array([large, -small, 0.0]) / (large - small))
    off = light - exact
    made["best"] = mixed(_least_squares(off.reshape(len(_FACTORS), -1)))
    tiles, of_tile = pictures[0].copy(), []
    for y in range(0, size[1], _TILE):
        for x in range(0, size[0], _TILE):
            inside = np.s_[:, y : y + _TILE, x : x + _TILE]
            of_tile.append(_least_squares(off[inside].reshape(len(_FACTORS), -1)))
            tiles[inside[1:]] = np.tensordot(of_tile[-1], pictures[inside], axes=1)
    made["best of each tile"] = tiles.astype(np.float32), np.array(of_tile)
    return made


def _least_squares(off: Array) -> Array:
    """Weights, of sum 1, of the least mean square of the sum of rows of differences, without the worst pixels."""
    size = np.square(off).sum(axis=0)
    kept = off[:, np.isfinite(size) & (size <= np.nanquantile(size, 1.0 - TRIM))]
    square = kept @ kept.T
    square += 1e-9 * np.trace(square) * np.eye(len(off)) + 1e-30 * np.eye(len(off))
    weights: Array = np.linalg.solve(square, np.ones(len(off)))
    return weights / weights.sum()


def _and(total: Measurement | None, more: Measurement) -> Measurement:
    return more if total is None else total + more
