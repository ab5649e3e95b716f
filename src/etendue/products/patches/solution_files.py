"""Files of a solution: data for other programs, pictures and lightmaps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import numpy as np

from etendue.core import Array, BackendError, OptionError, Result, is_whole
from etendue.display import check_range, false_colour, write_png
from etendue.film import LUMINANCE
from etendue.radiosity import (
    LIGHTMAP_MESHES,
    SOLUTION_FILES,
    Lightmap,
    Patches,
    RadiosityError,
    Solution,
    TexturedMesh,
    atlas,
    check_coordinates,
    check_file,
    gltf_mesh,
    lightmap,
    save_lightmap,
    save_solution,
    save_textured_mesh,
    scene_mesh,
)
from etendue.scene import Problem

from ..files import Writing
from ..pictures import save_result
from .gathering import PICTURE_FILES, picture
from .illuminance import illuminance_picture
from .page import PAGE_FILES, Making, write_solution_page

#: Scale of error pictures: the relative standard errors shown as black and as yellow.
ERROR_SCALE = (1e-3, 1.0)
#: Value of ``uv`` for the scene's own texture coordinates.
OWN = "scene"
#: Suffixes of files of photometric numbers.
_PHOTOMETRIC = (".vtu", ".npz", ".nc", ".png", *PAGE_FILES)
#: Suffixes of meshes with vertex colours.
_COLOURS = (".ply", ".glb", ".gltf")
#: Suffixes of lightmaps and of their meshes.
_LIGHTMAPS = {".exr": "lightmap"} | LIGHTMAP_MESHES
#: Smallest size of a lightmap in texels.
_LEAST_TEXELS = 16


@dataclass
class Shown:
    """The picture and the lightmap of a solution; ``None`` if not requested."""

    picture: Result | None = None
    lightmap: Lightmap | None = None


@dataclass(frozen=True)
class SolutionFiles:
    """The requested outputs of a solution. ``files`` are solutions, pictures (.exr, .png) or pages (.html), depending
    on their suffixes."""

    files: tuple[Path, ...] = ()
    photometric: bool = False  #: illuminance as arrays, in pages, and as the picture, in false colours
    # Of pictures.
    scale: tuple[float | None, float | None] = (None, None)  #: ends of the false colours of illuminance, in lx
    size: tuple[int, int] | None = None
    sensor: int = 0
    gather: int = 0  #: paths per pixel for final gathering; 0 shows the patches
    spp: int = 16  #: rays per pixel without ``gather``
    smooth: bool = True  #: in pictures and lightmaps
    error_picture: bool = False  #: beside a .png, its relative standard error in false colours
    # Of a lightmap.
    lightmap: Path | None = None  #: an .exr file, or a mesh file with the .exr beside it
    lightmap_size: int = 1024  #: largest number of texels of a side
    command: str = ""  #: a command that makes the page again
    uv: str | None = None  #: a glTF file with TEXCOORD_1, or "scene" for the scene's own; None makes an atlas

    @property
    def pictures(self) -> tuple[Path, ...]:
        """The files that are pictures."""
        return tuple(path for path in self.files if path.suffix.lower() in PICTURE_FILES)

    @property
    def pages(self) -> tuple[Path, ...]:
        """The files that are pages."""
        return tuple(path for path in self.files if path.suffix.lower() in PAGE_FILES)

    @property
    def error_pictures(self) -> tuple[Path, ...]:
        """Paths of error pictures."""
        return tuple(_beside(p) for p in self.pictures if p.suffix.lower() == ".png") if self.error_picture else ()

    @property
    def texture(self) -> Path:
        """Path of the lightmap."""
        assert self.lightmap is not None
        return self.lightmap.with_suffix(".exr")

    @property
    def mesh(self) -> Path:
        """Path of the mesh for the lightmap, if an atlas is made."""
        assert self.lightmap is not None
        return self.lightmap if self.lightmap != self.texture else self.lightmap.with_suffix(".glb")

    @property
    def written(self) -> tuple[Path, ...]:
        """All output files."""
        maps = () if self.lightmap is None else (self.texture,) if self.uv is not None else (self.texture, self.mesh)
        return (*self.files, *self.error_pictures, *maps)

    # ------------------------------------------------------------------ checks

    def check(self) -> None:
        """Checks without the source. Raises :class:`OptionError` for options that exclude each other and for numbers
        out of range, ``RadiosityError`` for an unknown suffix, ``BackendError`` for a missing library."""
        for path in self.files:
            check_file(path, SOLUTION_FILES | PICTURE_FILES | PAGE_FILES)
        if self.lightmap is not None:
            check_file(self.lightmap, _LIGHTMAPS)
        for name, least in (("sensor", 0), ("gather", 0), ("spp", 1), ("lightmap_size", _LEAST_TEXELS)):
            if not is_whole(value := getattr(self, name)) or value < least:
                raise OptionError(f"{name} is a whole number of at least {least}, not {value!r}")
        self._check_photometric()
        given = next((name for name in ("gather", "size", "sensor") if getattr(self, name)), None)
        if given and not self.pictures:
            other = ", without a lightmap" if self.lightmap is not None else ""
            raise OptionError(f"{given} is for pictures; write .exr or .png{other}")
        if self.error_picture and not self.error_pictures:
            raise OptionError("an error picture is for .png; in .exr the error is a layer, in other files an array")
        if self.uv is not None and self.lightmap is None:
            raise OptionError("uv is for lightmaps; ask for one")
        if self.uv is None and self.lightmap is not None and find_spec("xatlas") is None:
            raise BackendError("an atlas needs xatlas, not installed: pip install 'etendue[lightmap]', or give uv")

    def _check_photometric(self) -> None:
        if any(end is not None for end in self.scale):
            check_range(*self.scale)
            if not (self.photometric and any(path.suffix.lower() == ".png" for path in self.files)):
                raise OptionError("a range is that of the false colours of illuminance; write a photometric .png")
        if not self.photometric:
            return
        if other := next((path.name for path in self.files if path.suffix.lower() not in _PHOTOMETRIC), None):
            raise OptionError(f"photometric numbers are written to {', '.join(_PHOTOMETRIC)}, not to '{other}'")
        if wrong := next((name for name in ("gather", "lightmap") if getattr(self, name)), None):
            raise OptionError(f"{wrong} is of radiance, photometric outputs are of illuminance: leave out one of them")

    def check_source(self, patches: Patches, problem: Problem | None) -> None:
        """Checks of the source and of texture coordinates, before lines are cast. Raises :class:`OptionError` for
        outputs that need a scene if there is none, ``RadiosityError`` for channels that cannot be shown."""
        has_camera = problem is not None and bool(problem.scene.sensors())
        if (self.pictures and not has_camera) or (problem is None and self.uv == OWN):
            what = "a picture needs a scene with a camera" if self.pictures else "uv of the scene needs a scene"
            raise OptionError(f"{what}; for a mesh choose another kind of file")
        shown = [path.suffix.lower() for path in self.files if path.suffix.lower() in (*_COLOURS, *PICTURE_FILES)]
        shown += [] if self.lightmap is None else ["a lightmap"]
        if shown and patches.channels not in (1, 3):
            raise RadiosityError(f"{shown[0]} shows one channel or three, not {patches.channels}; write .vtu or .npz")
        if self.photometric and patches.channels not in (1, 3):
            raise RadiosityError(f"luminance is that of one channel or three, not {patches.channels}; no photometric")
        if self.lightmap is not None and self.uv is not None:
            check_coordinates(self._coordinates(problem), (self.lightmap_size, self.lightmap_size))

    def check_errors(
        self, error: Array | None, needed: str = "the standard error, which is unknown; leave it out"
    ) -> None:
        """Raise :class:`OptionError` if an error picture is requested and the errors are unknown; it names what was
        ``needed`` to know them."""
        if self.error_picture and error is None:
            raise OptionError(f"an error picture needs {needed}")

    # ------------------------------------------------------------------ writing

    def write(
        self,
        writing: Writing,
        problem: Problem | None,
        solution: Solution,
        error: Array | None,
        metadata: Mapping[str, Any],
        tell: Callable[[str], object],
        making: Making | None = None,
    ) -> Shown:
        """Write all files. ``error``: of the irradiance, if known. ``tell`` receives a description of the current
        step. ``making``: how the solution was made, for a page."""
        shown = Shown()
        for path in self.files:
            if path not in (*self.pictures, *self.pages):
                with writing.attempt(f"write '{path}'"):
                    save_solution(
                        path, solution, irradiance_error=error, photometric=self.photometric, metadata=metadata
                    )
        if self.pictures:
            with writing.attempt("make the picture"):
                assert problem is not None  # see check_source
                tell("rendering the picture")
                shown.picture = self._picture(problem, solution, error, metadata, tell)
                self._write_pictures(writing, shown.picture, error)
        if self.lightmap is not None:
            with writing.attempt("make the lightmap"):
                tell("making the lightmap")
                shown.lightmap = self._write_lightmap(problem, solution, metadata)
        for path in self.pages:
            with writing.attempt(f"write '{path}'"):
                tell("writing the page")
                made = replace(making or Making(), command=self.command)
                write_solution_page(
                    path,
                    solution,
                    error,
                    metadata,
                    problem,
                    made,
                    shown.picture,
                    photometric=self.photometric,
                    scale=self.scale,
                )
        return shown

    def _picture(
        self,
        problem: Problem,
        solution: Solution,
        error: Array | None,
        metadata: Mapping[str, Any],
        tell: Callable[[str], object],
    ) -> Result:
        made = picture(
            solution,
            problem,
            spp=self.spp,
            gather=self.gather,
            smooth=self.smooth,
            irradiance=self.photometric,
            irradiance_error=error,
            on_pass=lambda done, of: tell(f"rendering the picture: pass {done} of {of}"),
        )
        return Result(made.layers, {**made.metadata, **metadata})

    def _write_pictures(self, writing: Writing, made: Result, error: Array | None) -> None:
        for path in self.pictures:
            with writing.attempt(f"write '{path}'"):
                if self.photometric:
                    write_png(path, illuminance_picture(made, *self.scale))
                else:
                    save_result(path, made)
        for path in self.error_pictures:
            with writing.attempt(f"write '{path}'"):
                self.check_errors(error)
                _write_errors(path, made)

    def _write_lightmap(self, problem: Problem | None, solution: Solution, metadata: Mapping[str, Any]) -> Lightmap:
        size = (self.lightmap_size, self.lightmap_size)
        if self.uv is not None:
            mesh = self._coordinates(problem)
        else:
            mesh, size = atlas(solution.patches, self.lightmap_size)
        made = lightmap(solution, mesh, size, smooth=self.smooth)
        save_lightmap(self.texture, made, dict(metadata))
        if self.uv is None:
            save_textured_mesh(self.mesh, mesh, self.texture.name)
        return made

    def _coordinates(self, problem: Problem | None) -> TexturedMesh:
        """The mesh with the texture coordinates of ``uv``."""
        assert self.uv is not None
        if self.uv != OWN:
            return gltf_mesh(self.uv)
        assert problem is not None  # see check_source
        return scene_mesh(problem)

    # ------------------------------------------------------------------ plain values

    def renamed(self, outputs: Sequence[Path]) -> SolutionFiles:
        """The same outputs with other files; one is the lightmap, if there were no other files than that."""
        if self.files or self.lightmap is None:
            return replace(self, files=tuple(outputs), lightmap=None, uv=None)
        files, lightmap = files_and_lightmap(outputs)
        return replace(self, files=files, lightmap=lightmap)

    def to_dict(self) -> dict[str, Any]:
        """Plain values with absolute paths."""
        plain = asdict(self) | {"files": [str(path.absolute()) for path in self.files]}
        if self.lightmap is not None:
            plain["lightmap"] = str(self.lightmap.absolute())
        if self.uv is not None and self.uv != OWN:
            plain["uv"] = str(Path(self.uv).absolute())
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Self:
        """Inverse of :meth:`to_dict`. Raises :class:`TypeError` or :class:`KeyError` for other values."""
        lightmap, size = plain.get("lightmap"), plain.get("size")
        paths = {"files": tuple(map(Path, plain["files"])), "lightmap": lightmap and Path(lightmap)}
        scale = {"scale": tuple(plain["scale"])} if "scale" in plain else {}
        known = {"spp" if name == "samples" else name: value for name, value in plain.items()}  # an earlier name
        return cls(**{**known, **paths, "size": size and tuple(size), **scale})  # JSON knows no tuples


def files_and_lightmap(outputs: Sequence[Path]) -> tuple[tuple[Path, ...], Path]:
    """The file of a lightmap among ``outputs``, by its suffix, and the others. Raises :class:`OptionError` if several
    files could be that of the lightmap."""
    could = [path for path in outputs if path.suffix.lower() in _LIGHTMAPS]
    if len(outputs) > 1 and len(could) != 1:
        found = "none" if not could else f"{len(could)} of them"
        raise OptionError(
            f"one of {len(outputs)} outputs is the lightmap, {', '.join(_LIGHTMAPS)}, but {found} could be: name one, "
            "and write other files from the solution (.npz) afterwards"
        )
    lightmap = (could or outputs)[0]
    return tuple(path for path in outputs if path != lightmap), lightmap


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.stem}-error.png")


def _write_errors(path: Path, made: Result) -> None:
    shown, error = (made.layers[name] @ np.array(LUMINANCE) for name in ("image", "error"))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(shown > 0, error / shown, np.nan)
    write_png(path, false_colour(relative, *ERROR_SCALE))
