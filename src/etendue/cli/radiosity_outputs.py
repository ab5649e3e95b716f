"""What `etendue radiosity` writes: files of the solution, pictures of it, lightmaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from etendue.core import BackendError, OptionError

from . import options as opt
from .console import error_console, note, say

if TYPE_CHECKING:
    from etendue.core import Array
    from etendue.radiosity import Solution, TexturedMesh
    from etendue.scene import Problem

#: Scale of pictures of errors: relative standard errors that are black and yellow.
_LOW, _HIGH = 1e-3, 1.0
#: What stands for the scene's own texture coordinates.
OWN = "scene"

Gather = Annotated[
    int,
    typer.Option(
        "--gather",
        help="Paths per pixel of a picture that gather light at what is seen; 0 shows patches.",
        min=0,
        metavar="N",
    ),
]
Samples = Annotated[int, typer.Option("--spp", help="Rays per pixel without --gather.", min=1, metavar="N")]
Flat = Annotated[
    bool, typer.Option("--flat", help="In pictures and lightmaps, patches have one colour each: no smoothing.")
]
ErrorPicture = Annotated[
    bool, typer.Option("--error-picture", help="Beside a .png, its relative standard error in false colours.")
]
LightmapSize = Annotated[
    int | None,
    typer.Option(
        "--lightmap",
        help="Write a lightmap of at most this many texels a side, and a mesh that fits.",
        min=16,
        metavar="SIZE",
    ),
]
TextureCoordinates = Annotated[
    str | None,
    typer.Option(
        "--uv",
        help="Coordinates of the lightmap: a .glb or .gltf file with TEXCOORD_1, or 'scene' for the scene's own; "
        "without this an atlas is made.",
        metavar="FILE",
    ),
]


Solved = Annotated[
    Path | None,
    typer.Option(
        "--solution", help="A solution of this scene, .npz or .nc, to be written in another way.", metavar="FILE"
    ),
]


@dataclass(frozen=True)
class SolutionOutput:
    """What is to be written of a solution, and how."""

    path: Path
    size: opt.Size | None = None
    sensor: int = 0
    gather: int = 0
    samples: int = 16
    flat: bool = False
    error_picture: bool = False
    lightmap: int | None = None
    uv: str | None = None

    @property
    def is_picture(self) -> bool:
        """Whether the scene is to be seen through a sensor."""
        return self.lightmap is None and self.path.suffix.lower() in (".exr", ".png")

    @property
    def files(self) -> tuple[Path, ...]:
        """All that is written."""
        if self.lightmap is not None:
            texture = self.path.with_suffix(".exr")
            if self.uv is not None:
                return (texture,)
            return texture, self.path if self.path != texture else self.path.with_suffix(".glb")
        return (self.path, self._errors) if self.error_picture else (self.path,)

    @property
    def _errors(self) -> Path:
        return self.path.with_name(f"{self.path.stem}-error.png")

    def check(self) -> None:
        """Before any work: raises :class:`OptionError` for options that do not belong together, ``RadiosityError`` for
        a suffix, ``BackendError`` for a missing library, ``OutputError`` for a place that cannot be written to."""
        from etendue.film import check_writable
        from etendue.radiosity import LIGHTMAP_MESHES, PICTURE_FILES, SOLUTION_FILES, check_file

        known = SOLUTION_FILES | PICTURE_FILES if self.lightmap is None else {".exr": "lightmap"} | LIGHTMAP_MESHES
        check_file(self.path, known)
        only_pictures = {"--gather": self.gather, "--size": self.size, "--sensor": self.sensor}
        given = next((name for name, value in only_pictures.items() if value), None)
        if given and not self.is_picture:
            raise OptionError(f"{given} is for pictures; write .exr or .png, without --lightmap")
        if self.error_picture and self.path.suffix.lower() != ".png":
            raise OptionError("--error-picture is for .png; in .exr the error is a layer, in other files an array")
        if self.uv is not None and self.lightmap is None:
            raise OptionError("--uv is for lightmaps; give the size of one, as --lightmap 1024")
        if self.uv is None and self.lightmap is not None and find_spec("xatlas") is None:
            raise BackendError(
                "an atlas takes xatlas, which is not here: pip install 'etendue[lightmap]', or give --uv"
            )
        for path in self.files:
            check_writable(path)

    def load(self, found: Any, parameters: Mapping[str, str]) -> Problem:
        """The scene, seen by the sensor that is asked for."""
        from etendue.scene import load

        return load(found, parameters=parameters, size=self.size, sensor=self.sensor)

    def check_source(self, problem: Problem | None) -> None:
        """Texture coordinates are looked at before the work. Raises :class:`OptionError` for what takes a scene where
        there is none, but a mesh."""
        from etendue.radiosity import check_coordinates

        if problem is None and (self.is_picture or self.uv == OWN):
            what = "a picture takes a scene, for its camera" if self.is_picture else "--uv scene takes a scene"
            raise OptionError(f"{what}; of a mesh file write one of the other kinds of files")
        if self.lightmap is not None and self.uv is not None:
            check_coordinates(self._mesh(problem), (self.lightmap, self.lightmap))

    def write(
        self, problem: Problem | None, solution: Solution, error: Array | None, metadata: Mapping[str, Any]
    ) -> None:
        """Write all files."""
        from etendue.radiosity import save_solution

        if self.lightmap is not None:
            self._write_lightmap(problem, solution, dict(metadata))
        elif self.is_picture:
            assert problem is not None  # see check_source
            self._write_picture(problem, solution, error, dict(metadata))
        else:
            save_solution(self.path, solution, irradiance_error=error, metadata=metadata)

    def write_again(self, problem: Problem | None, solved: Path) -> int:
        """Write a solution that is in a file. Returns the exit status."""
        from etendue.radiosity import read_solution

        solution, error = read_solution(solved)
        self.write(problem, solution, error, {"source": str(solved)})
        self.say()
        return 0

    def say(self) -> None:
        """Name the files on standard output, one a line."""
        say("\n".join(map(str, self.files)))

    def _write_picture(
        self, problem: Problem, solution: Solution, error: Array | None, metadata: dict[str, Any]
    ) -> None:
        from etendue.core import Result
        from etendue.outputs import save_result
        from etendue.radiosity import picture

        if self.error_picture and error is None:
            raise OptionError("--error-picture needs two bundles at least, whose difference tells the error")
        with error_console().status("rendering the picture") as status:
            made = picture(
                solution,
                problem,
                samples=self.samples,
                gather=self.gather,
                smooth=not self.flat,
                irradiance_error=error,
                on_pass=lambda done, of: status.update(f"rendering the picture: pass {done} of {of}"),
            )
        save_result(self.path, Result(made.layers, made.metadata | metadata))
        if self.error_picture:
            self._write_errors(made)

    def _write_errors(self, made: Any) -> None:
        from etendue.display import false_colour, write_png
        from etendue.film import LUMINANCE

        shown, error = (made.layers[name] @ np.array(LUMINANCE) for name in ("image", "error"))
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(shown > 0, error / shown, np.nan)
        write_png(self._errors, false_colour(relative, _LOW, _HIGH))
        note(error_console(), f"{self._errors.name}: relative standard error, black {_LOW:.1%} to yellow {_HIGH:.0%}")

    def _mesh(self, problem: Problem | None) -> TexturedMesh:
        """The mesh that ``--uv`` asks for."""
        from etendue.radiosity import gltf_mesh, scene_mesh

        assert self.uv is not None
        if self.uv != OWN:
            return gltf_mesh(self.uv)
        assert problem is not None  # see check_source
        return scene_mesh(problem)

    def _write_lightmap(self, problem: Problem | None, solution: Solution, metadata: dict[str, Any]) -> None:
        from etendue import radiosity

        assert self.lightmap is not None
        size = (self.lightmap, self.lightmap)
        with error_console().status("making the lightmap"):
            if self.uv is not None:
                mesh = self._mesh(problem)
            else:
                mesh, size = radiosity.atlas(solution.patches, self.lightmap)
            made = radiosity.lightmap(solution, mesh, size, smooth=not self.flat)
            texture = self.files[0]
            radiosity.save_lightmap(texture, made, metadata)
            if self.uv is None:
                radiosity.save_textured_mesh(self.files[1], mesh, texture.name)
        note(error_console(), f"lightmap of {size[0]} x {size[1]}, {made.covered.mean():.0%} covered by surfaces")
