"""`etendue form-factors` and `etendue radiosity`: options of both commands, and their execution."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import OptionError, logger

from . import options as opt
from .console import command_line, error_console, note
from .settings import settings_in, with_settings

FactorFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "-o",
        "--output",
        help=".npz, .nc (arrays), .csv (a table by names), .vf (View3D), .idf, .epjson (EnergyPlus), .i (MOOSE); or "
        "by name vfsparse.inp.NNN, svf.inp.NNN, vf.nc.inp.NNN (uDALES), ViewFactors.dat (Elmer), F, globalFaceFaces "
        "(OpenFOAM); repeatable. By default factors.npz.",
        metavar="FILE",
    ),
]
SolutionPaths = Annotated[
    list[Path] | None,
    typer.Option(
        "-o",
        "--output",
        help=".vtu (ParaView), .ply, .glb, .gltf (vertex colours), .npz, .nc (arrays); .exr, .png (a picture); .html "
        "(a page); repeatable. By default solution.vtu.",
        metavar="FILE",
    ),
]
Bundles = Annotated[
    int | None,
    typer.Option(
        "--bundles",
        help="Directions of parallel lines; a power of two is best. 1024, if no budget is given.",
        min=1,
        metavar="N",
    ),
]
CheckpointFile = Annotated[
    Path | None,
    typer.Option(
        "--checkpoint",
        help="Checkpoint for `etendue resume`; by default beside the first output. Of lines, which take much room, it "
        "is written only if the run ends early, unless it is named here.",
        metavar="FILE",
    ),
]
MaxArea = Annotated[float | None, typer.Option("--max-area", help="Subdivide faces larger than this.", metavar="AREA")]
Reflectance = Annotated[
    str | None,
    typer.Option(
        "--reflectance",
        help="Of a mesh: a number, one for each channel as 0.7,0.5,0.2, or an array of the file for its faces "
        "('emissivity' counts as one minus it). 0 if not given.",
        metavar="X|NAME",
    ),
]
Ids = Annotated[
    str | None,
    typer.Option(
        "--ids",
        help="Of a mesh: array of the file; faces of equal number are one patch. groups for its named groups, file for "
        "one patch of each file.",
        metavar="NAME",
    ),
]
TwoSided = Annotated[
    bool, typer.Option("--two-sided", help="Faces of a mesh are sheets: their backs are patches, too.")
]
More = Annotated[
    list[Path] | None,
    typer.Option("--more", help="Further mesh, whose faces are patches, too; repeatable.", metavar="FILE"),
]
Obstacles = Annotated[
    list[Path] | None,
    typer.Option("--obstacles", help="Mesh whose faces only occlude; repeatable.", metavar="FILE"),
]
Orient = Annotated[
    str | None,
    typer.Option(
        "--orient", help="Turn the faces of a mesh: outward (of solids) or inward (into rooms).", metavar="SIDE"
    ),
]
ZoneName = Annotated[
    str | None,
    typer.Option(
        "--zone", help="Of EnergyPlus, or room of Honeybee: only its surfaces, without other zones.", metavar="NAME"
    ),
]
Periodic = Annotated[
    opt.Lengths | None,
    typer.Option(
        "--periodic",
        help="The mesh is one period, so long in x and y, of a city that repeats without end; 0 for no repetition.",
        parser=opt.parse_lengths,
        metavar="LX,LY",
    ),
]
LineSeed = Annotated[
    int | None, typer.Option("--seed", help="The same seed gives the same lines; 0 if not given.", metavar="N")
]
RowSums = Annotated[bool, typer.Option("--row-sums", help="Every row sums to exactly 1, with the share of the sky.")]
Reciprocal = Annotated[
    bool,
    typer.Option(
        "--reciprocal",
        help="A_i F_ij = A_j F_ji exactly; with --row-sums both hold, by the smallest relative change.",
    ),
]
Repair = Annotated[bool, typer.Option("--repair", help="Both --row-sums and --reciprocal.")]
Threshold = Annotated[
    float,
    typer.Option(
        "--threshold",
        help="Drop smaller form factors; --row-sums returns their share to the row, otherwise it is missing.",
        metavar="X",
    ),
]
Groups = Annotated[
    bool,
    typer.Option(
        "--groups",
        help="Write the factors between groups instead of patches: shapes with a name, or equal numbers of --ids.",
    ),
]
ObjectsBy = Annotated[
    str | None,
    typer.Option(
        "--objects",
        help="What makes an object, for spheres, boxes and sub-scenes: shapes (of a scene), components (connected "
        "surfaces), labels (those of --ids), or an array of the mesh file that numbers objects, negative for walls.",
        metavar="NAME",
    ),
]
Hierarchy = Annotated[
    str | None, typer.Option("--hierarchy", help="Earlier name of -m spheres and -m boxes.", hidden=True)
]


def _factor_methods() -> dict[str, Any]:
    from etendue.products import FACTORS, find

    return {name: find(name).Settings for name in FACTORS}


def _solution_methods() -> dict[str, Any]:
    from etendue.products import SOLUTIONS, find
    from etendue.radiosity import BoxSettings

    return {name: find(name).Settings for name in SOLUTIONS} | {"boxes": BoxSettings}


FactorCommand = with_settings(_factor_methods, "lines")
SolutionCommand = with_settings(_solution_methods, "lines")


def mesh_arguments(
    ids: str | None,
    two_sided: bool,
    orient: str | None,
    more: list[Path] | None,
    obstacles: list[Path] | None,
    zone: str | None,
    periodic: opt.Lengths | None = None,
    **named: Any,
) -> dict[str, Any]:
    """Arguments of ``read_patches``, with further files where a checkpoint finds them again."""
    files = {"more": more, "obstacles": obstacles}
    further = {name: [str(path.absolute()) for path in some] if some else None for name, some in files.items()}
    given = {"ids": ids, "two_sided": two_sided, "orient": orient, "zone": zone}
    return {**given, "periodic": periodic and tuple(periodic), **further, **named}


def form_factors(
    mesh: Annotated[
        str,
        typer.Argument(
            help="Mesh (PLY, OBJ, STL, VTU, glTF and others), Mitsuba XML file, or bundled scene.", metavar="SCENE"
        ),
    ],
    method: Annotated[
        str,
        typer.Option(
            "--method",
            "-m",
            help="lines through the whole scene; spheres, lines also in spheres around objects; exact, by integrals, "
            "for some thousand patches; rays, from each patch; or auto, exact or lines.",
            metavar="NAME",
        ),
    ] = "lines",
    output: FactorFiles = None,
    bundles: Bundles = None,
    time: opt.Time = None,
    error: opt.Error = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator", help="F1, F2, F3, F4, reciprocal or pooled; F1, or F4 with spheres.", metavar="NAME"
        ),
    ] = None,
    row_sums: RowSums = False,
    reciprocal: Reciprocal = False,
    repair: Repair = False,
    threshold: Threshold = 0.0,
    groups: Groups = False,
    up: Annotated[
        str | None,
        typer.Option("--up", help="Axis that is up, y or z: the ground is then apart from the sky.", metavar="AXIS"),
    ] = None,
    north: opt.North = 0.0,
    sky_patches: Annotated[
        int | None,
        typer.Option(
            "--sky-patches",
            help="Also the shares of the sky's patches: of Tregenza's 145 with 1, of 144 M^2 + 1 with M.",
            metavar="M",
        ),
    ] = None,
    rows: Annotated[
        list[Path] | None,
        typer.Option(
            "--rows",
            help="With -m rays: only the rows of this file, one of those named, such as a tile of a city; repeatable. "
            "`etendue join-factors` joins the rows of all.",
            metavar="FILE",
        ),
    ] = None,
    objects: ObjectsBy = None,
    walls: Annotated[
        str | None,
        typer.Option(
            "--walls", help="Names of objects that are walls, separated by commas; '' for none.", metavar="NAMES"
        ),
    ] = None,
    define: opt.Define = None,
    reflectance: Reflectance = None,
    ids: Ids = None,
    max_area: MaxArea = None,
    two_sided: TwoSided = False,
    more: More = None,
    obstacles: Obstacles = None,
    orient: Orient = None,
    zone: ZoneName = None,
    periodic: Periodic = None,
    exact: Annotated[bool, typer.Option("--exact", help="Earlier name of -m exact.", hidden=True)] = False,
    hierarchy: Hierarchy = None,
    seed: LineSeed = None,
    checkpoint: CheckpointFile = None,
    no_checkpoint: opt.NoCheckpoint = False,
    save_every: opt.SaveEvery = 60.0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the form factors (view factors) of a mesh or scene, each face a patch, by lines through all of it.

    The front of a face is the side from which its corners are counterclockwise. Stops at the first of --bundles, --time
    and --error that is reached, or by Ctrl-C, and writes the form factors from the lines so far. Those of points:
    `etendue point-factors`.
    """
    from etendue.products.patches import FactorRun, without_hierarchy

    from .lines import run_on_patches

    files = tuple(output or [Path("factors.npz")])
    run = FactorRun(
        source=mesh,
        method="exact" if exact else method,
        settings=settings_in(define),
        limits=opt.limits(time, error, bundles=bundles),
        estimator=estimator,
        row_sums=row_sums or repair,
        reciprocal=reciprocal or repair,
        threshold=threshold,
        groups=groups,
        up=up,
        north=north,
        sky_patches=sky_patches,
        rows=_rows(rows or (), [Path(mesh), *(more or ())]),
        objects=objects,
        walls=None if walls is None else tuple(name for name in walls.split(",") if name),
        outputs=files,
        seed=seed or 0,
        max_area=max_area,
        mesh=mesh_arguments(ids, two_sided, orient, more, obstacles, zone, periodic, reflectance=quantity(reflectance)),
        parameters=opt.parse_pairs(param, "-P"),
        checkpoint=checkpoint,
        checkpoint_beside=opt.checkpoint_beside(files[0], checkpoint, no_checkpoint),
        save_every=save_every,
        tell=lambda text: note(error_console(), text),
        is_watched=error_console().is_terminal,
    )
    without_hierarchy(run, hierarchy if hierarchy != "" else True)
    if exact:
        logger.warning("--exact is now -m exact, and goes with the next version")
    return run_on_patches(run.task(), opt.Device(variant, threads, cluster, workers))


def _rows(asked: Sequence[Path], files: Sequence[Path]) -> tuple[str, ...]:
    """The names of the files whose rows are asked for, as those of patches."""
    known = {path.resolve(): path.stem for path in files}
    for path in asked:
        if path.resolve() not in known:
            raise OptionError(f"--rows '{path}' is none of the files of this run: {', '.join(map(str, files))}")
    return tuple(known[path.resolve()] for path in asked)


def radiosity(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file, bundled scene, or mesh (PLY, OBJ, VTU, glTF and others).")
    ],
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            "-m",
            help="lines (default), which are stored and solved; multipath, along single lines, of which none are "
            "stored; boxes, multipath in boxes around groups of objects or around instances; or ambient, "
            "without lines.",
            metavar="NAME",
        ),
    ] = None,
    output: SolutionPaths = None,
    photometric: Annotated[
        bool,
        typer.Option(
            "--photometric",
            help="Also illuminance in lx and luminous exitance (683 lm/W): arrays of .vtu, .npz and .nc, in the page; "
            "a .png is of illuminance in false colours.",
        ),
    ] = False,
    colour_range: opt.ColourRange = None,
    bundles: Bundles = None,
    points: Annotated[
        int | None,
        typer.Option("--points", help="Of multipath: lines; 4194304, if no budget is given.", min=1, metavar="N"),
    ] = None,
    passes: Annotated[
        int | None, typer.Option("--passes", help="Of boxes: passes; 16, if no budget is given.", min=1, metavar="N")
    ] = None,
    time: opt.Time = None,
    error: opt.Error = None,
    max_area: MaxArea = None,
    solver: Annotated[
        str | None,
        typer.Option(
            "--solver",
            help="Of lines: conjugate-gradient (default), jacobi, gauss-seidel, southwell or direct.",
            metavar="NAME",
        ),
    ] = None,
    ambient: Annotated[
        str | None,
        typer.Option(
            "--ambient",
            help="All light by an ambient term, at once and without lines: classic, crisp or fuzzy, which it is "
            "without NAME. With --bounces, what a solution by lines has left.",
            metavar="[NAME]",
        ),
    ] = None,
    bounces: Annotated[
        int | None,
        typer.Option(
            "--bounces",
            help="Iterations of the solver, jacobi if none is named; light of more is ambient.",
            min=1,
            metavar="N",
        ),
    ] = None,
    sub_scenes: Annotated[
        str | None,
        typer.Option(
            "--sub-scenes",
            help="With --ambient: light spreads in parts of the scene first: objects, or boxes around groups of them.",
            metavar="NAME",
        ),
    ] = None,
    objects: ObjectsBy = None,
    factors: Annotated[
        Path | None,
        typer.Option(
            "--factors",
            help="Form factors of these patches to solve, without lines: .npz or .nc of form-factors, .vf of View3D.",
            metavar="FILE",
        ),
    ] = None,
    define: opt.Define = None,
    reflectance: Reflectance = None,
    emission: Annotated[
        str | None,
        typer.Option("--emission", help="Of a mesh: power per area, in the same forms.", metavar="X|NAME"),
    ] = None,
    temperature: Annotated[
        str | None,
        typer.Option("--temperature", help="Of a mesh: in kelvin, for grey bodies that emit.", metavar="X|NAME"),
    ] = None,
    sky: Annotated[
        str | None, typer.Option("--sky", help="Of a mesh: power per area from the surroundings.", metavar="X")
    ] = None,
    ids: Ids = None,
    two_sided: TwoSided = False,
    more: More = None,
    obstacles: Obstacles = None,
    orient: Orient = None,
    zone: ZoneName = None,
    periodic: Periodic = None,
    seed: LineSeed = None,
    hierarchy: Hierarchy = None,
    divide: Annotated[
        bool,
        typer.Option(
            "--divide",
            help="With boxes and workers: each worker has some of the boxes and their lines, and all make a pass "
            "together; otherwise each makes whole passes.",
        ),
    ] = False,
    sensor: opt.Sensor = 0,
    size: opt.PictureSize = None,
    gather: Annotated[
        int,
        typer.Option(
            "--gather",
            help="Paths per pixel of a picture with final gathering; 0 shows the patches.",
            min=0,
            metavar="N",
        ),
    ] = 0,
    spp: Annotated[
        int, typer.Option("--spp", help="Rays per pixel of a picture without --gather.", min=1, metavar="N")
    ] = 16,
    flat: Annotated[
        bool, typer.Option("--flat", help="In pictures and lightmaps, patches have one colour each: no smoothing.")
    ] = False,
    error_picture: Annotated[
        bool, typer.Option("--error-picture", help="Beside a .png, its relative standard error in false colours.")
    ] = False,
    lightmap: Annotated[
        int | None,
        typer.Option(
            "--lightmap",
            help="Write a lightmap of at most this many texels a side, and its mesh.",
            min=16,
            metavar="SIZE",
        ),
    ] = None,
    uv: Annotated[
        str | None,
        typer.Option(
            "--uv",
            help="Coordinates of the lightmap: a .glb or .gltf file with TEXCOORD_1, or 'scene' for the scene's own; "
            "without this an atlas is made.",
            metavar="FILE",
        ),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Beside the output, a page (.html): pictures of the mesh, errors, tables.")
    ] = False,
    solution: Annotated[
        Path | None,
        typer.Option(
            "--solution", help="A solution of this scene, .npz or .nc, to write in other formats.", metavar="FILE"
        ),
    ] = None,
    checkpoint: CheckpointFile = None,
    no_checkpoint: opt.NoCheckpoint = False,
    save_every: opt.SaveEvery = 60.0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the radiosities of a scene's or mesh's surfaces, each face a patch; all materials are treated as diffuse.

    Stops at the first of --bundles (or --points, --passes), --time and --error that is reached, or by Ctrl-C, and
    writes the solution from the lines so far.
    """
    from etendue.products.patches import SolutionFiles, SolutionRun, files_and_lightmap, without_hierarchy

    from .lines import run_on_patches, write_again

    device = opt.Device(variant, threads, cluster, workers)
    named = output or [Path("solution.vtu")]
    files, map_file = (tuple(named), None) if lightmap is None else files_and_lightmap(named)
    if page and (beside := named[0].with_suffix(".html")) not in files:
        files = (*files, beside)
    groups, settings = _split(settings_in(define))
    run = SolutionRun(
        source=scene,
        method=method,
        settings=settings,
        limits=opt.limits(time, error, bundles=bundles, points=points, passes=passes),
        solver=solver,
        ambient=ambient,
        bounces=bounces,
        sub_scenes=sub_scenes,
        factors=factors,
        objects=objects,
        groups=groups,
        divide=divide,
        outputs=SolutionFiles(
            files=files,
            photometric=photometric,
            scale=colour_range or (None, None),
            command=command_line() if any(path.suffix == ".html" for path in files) else "",
            size=size,
            sensor=sensor,
            gather=gather,
            spp=spp,
            smooth=not flat,
            error_picture=error_picture,
            lightmap=map_file,
            lightmap_size=lightmap or 1024,
            uv=uv,
        ),
        seed=seed or 0,
        max_area=max_area,
        mesh=mesh_arguments(
            ids,
            two_sided,
            orient,
            more,
            obstacles,
            zone,
            periodic,
            reflectance=quantity(reflectance),
            emission=quantity(emission),
            temperature=quantity(temperature),
            sky=sky_of(sky),
        ),
        parameters=opt.parse_pairs(param, "-P"),
        checkpoint=checkpoint,
        checkpoint_beside=opt.checkpoint_beside(named[0], checkpoint, no_checkpoint),
        save_every=save_every,
        is_watched=error_console().is_terminal,
    )
    without_hierarchy(run, hierarchy if hierarchy != "" else True)
    if divide and device.is_alone:
        raise OptionError("boxes are divided among workers: give --workers or --cluster with --divide")
    if solution is not None:
        if checkpoint is not None or not device.is_alone:
            raise OptionError("--solution is there already and casts no lines: leave out checkpoint and workers")
        return write_again(run, solution, {} if seed is None else {"seed": seed}, device)
    return run_on_patches(run.task(), device)


def _split(settings: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of the grouping to boxes, and of the method."""
    from etendue.radiosity import GroupSettings

    return {name: settings.pop(name) for name in GroupSettings.names() if name in settings}, settings


def quantity(text: str | None) -> float | str | list[list[float]] | None:
    """A number, a row of numbers for channels, or a name."""
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        return text
    return numbers[0] if len(numbers) == 1 else [numbers]


def sky_of(text: str | None) -> float | list[float] | None:
    """A number, or one for each channel."""
    light = quantity(text)
    if isinstance(light, str):
        raise OptionError(f"--sky is a number, or one for each channel as 1,0.8,0.5, not '{text}'")
    return light[0] if isinstance(light, list) else light
