"""Polygons of Radiance's scene files, ``.rad``, with diffuse reflectances and emission of their materials."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from etendue.core import Array, format_count, logger

from ..errors import PatchError
from .surfacefiles import MeshFile, Surface, mesh_of

#: Types of Radiance that are no surfaces: materials, then textures, patterns, mixtures and spectra.
_MODIFIER = re.compile(
    r"(plas|met|trans|BRTD|WGMD|tex|color|bright|mix|spec)(func|data|pict|text|file)|(plastic|metal|trans|ashik)2?"
    r"|glow|light|illum|spotlight|mirror|prism[12]|dielectric|interface|glass|mist|antimatter|a?BSDF|spectrum"
)


def read_rad(path: Path) -> MeshFile:
    """The polygons, whose ``material`` is a group, with reflectances and emission (red, green, blue).

    ``plastic`` and ``metal`` reflect as diffuse surfaces of the same albedo, ``glow`` and ``light`` emit pi times their
    radiance, without their patterns, which a warning names. Polygons of other materials, and of those that are in
    another file, are black, with a warning. Raises :class:`PatchError` for other surfaces, and for commands.
    """
    materials: dict[str, tuple[Array, Array] | str] = {"void": (np.zeros(3), np.zeros(3))}
    surfaces = []
    black: Counter[str] = Counter()
    for line, modifier, kind, name, words in _primitives(path):
        where = f"line {line}"
        if kind == "polygon":
            if len(words) % 3:
                raise PatchError(
                    f"{path}, {where}: polygon '{name}' has {len(words)} numbers, not three for each corner"
                )
            outline = _numbers(path, where, name, words).reshape(-1, 3)
            material = materials.get(modifier)
            if material is None or isinstance(material, str):
                black[f"'{modifier}' {'is not in the file' if material is None else f'is {material}'}"] += 1
                material = materials["void"]
            surface = Surface(outline=outline, name=name, where=where, groups={"material": modifier})
            surface.values = dict(zip(("reflectance", "emission"), material, strict=True))
            surfaces.append(surface)
        elif kind == "source":
            logger.warning("%s, %s: the source '%s' is left out: give a sky", path, where, name)
        elif kind == "alias":
            materials[name] = materials.get(words[0], kind)
        elif _MODIFIER.fullmatch(kind):
            materials[name] = _material(path, where, kind, name, words)
            if modifier != "void" and not isinstance(materials[name], str):
                logger.warning("%s, %s: '%s' is taken without its pattern '%s'", path, where, name, modifier)
        else:
            raise PatchError(f"{path}, {where}: {kind} '{name}' is no polygon: approximate it by polygons")
    if not surfaces:
        raise PatchError(f"{path} has no polygons of Radiance")
    for which, count in black.items():
        logger.warning(
            "%s: the material %s; its %s taken as black: put the materials into the file, before them (plastic, metal, "
            "glow and light are known), or give a reflectance (--reflectance)",
            *(path, which, f"{format_count(count, 'polygon')} {'is' if count == 1 else 'are'}"),
        )
    own = {name: np.array([s.values[name] for s in surfaces]) for name in ("reflectance", "emission")}
    return mesh_of(path, surfaces, own)


def _material(path: Path, where: str, kind: str, name: str, words: list[str]) -> tuple[Array, Array] | str:
    """Reflectance and emission, or the name of a kind without them."""
    wanted = {"plastic": 5, "metal": 5, "glow": 4, "light": 3}.get(kind)
    if wanted is None:
        return kind
    if len(words) != wanted:
        raise PatchError(f"{path}, {where}: {kind} '{name}' has {len(words)} numbers, not {wanted}")
    numbers = _numbers(path, where, name, words)
    colour, none = numbers[:3], np.zeros(3)
    if kind in ("glow", "light"):
        return none, np.pi * colour
    # The highlight of plastic has no colour.
    return (colour * (1 - numbers[3]) + numbers[3] if kind == "plastic" else colour), none


def _numbers(path: Path, where: str, name: str, words: list[str]) -> Array:
    try:
        return np.array(words, dtype=np.float64)
    except ValueError:
        raise PatchError(f"{path}, {where}: '{name}' has a word in place of a number") from None


def _primitives(path: Path) -> Iterator[tuple[int, str, str, str, list[str]]]:
    """Line, modifier, kind, name and the last arguments, the numbers, of each primitive; of an alias, what it names."""
    words: list[tuple[int, str]] = []
    for number, text in enumerate(path.read_text("utf-8-sig", errors="replace").splitlines(), 1):
        if text.lstrip().startswith("!"):
            raise PatchError(
                f"{path}, line {number}: commands are not run: write what they make to a file (xform -e of Radiance)"
            )
        words += [(number, word) for word in text.split("#")[0].split()]
    place, line = 0, 1
    try:
        while place < len(words):
            line = words[place][0]
            modifier, kind, name = (word for _, word in words[place : place + 3])
            place += 3
            arguments: list[str] = []
            for _ in range(1 if kind == "alias" else 3):
                count = 0 if kind == "alias" else int(words[place][1])
                arguments = [word for _, word in words[place + 1 : place + 1 + count]]
                if kind == "alias":
                    arguments = [words[place][1]]
                if len(arguments) < count:
                    raise ValueError
                place += 1 + count
            yield line, modifier, kind, name, arguments
    except (ValueError, IndexError):
        raise PatchError(
            f"{path}, line {line}: the primitive is incomplete, or has a word in place of a count"
        ) from None
