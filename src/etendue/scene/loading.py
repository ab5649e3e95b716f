"""Loading scenes: from Mitsuba XML of any version, dictionaries, loaded scenes and bundled scenes to a Problem.

XML and dictionaries pass through Mitsuba's parser in steps, so that the film can be resized before objects are built
and unknown integrators can be left out.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

from etendue.core import EtendueError, OptionError, SceneError, UnsupportedError, logger, suggest, use_variant

from .bounds import centre_of
from .builtin.table import BundledScene, bundled
from .camera import Camera, check_movable
from .capability import check as check_scene, check_light
from .changes.transforms import settle_transforms
from .curves import extend_curves
from .graph import name as element_name
from .instantiating import instantiated
from .lamps.placement import lamps_in_surfaces, remarks_on, warn_of_lamps
from .models.gltf import description
from .models.reading import SUFFIXES, is_model, model
from .moving import Described, moved
from .parsing import (
    Change,
    Size,
    built_integrator,
    check_films,
    give_types,
    merge_meshes,
    resize,
    take_integrator,
    texture_details,
)
from .problem import Problem
from .resizing import resized_sensor
from .space import RenderSpace, warn_of_offsets

if TYPE_CHECKING:
    import mitsuba as mi

MOST_PIXELS = 1 << 30  #: a device array has fewer than 2^32 entries, and a film has four channels
_SCENE_FILE = "scene.xml"  #: of a folder

#: What :func:`load` accepts as a scene.
Source: TypeAlias = "str | os.PathLike[str] | BundledScene | Mapping[str, Any] | mi.Scene"


def load(
    source: Source,
    *,
    size: Size | None = None,
    sensor: int | None = 0,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    camera: Camera | None = None,
    check: bool = True,
    change: Change | None = None,
    lit: bool = True,
) -> Problem:
    """Load a scene; returns the :class:`Problem` of rendering it through one of its sensors.

    ``source`` is the path of a Mitsuba XML file or of a model (OBJ, glTF, PLY, STL, OFF), or the name of a bundled
    scene (see :func:`locate`), a :class:`BundledScene`, a scene dictionary or a loaded ``mi.Scene``. ``size`` (width,
    height) replaces the film's size, and a crop window keeps its proportions; field of view and ``fov_axis`` have the
    same meaning as in a file with that size (a loaded scene does not report its ``fov_axis``: its horizontal field of
    view is kept). A loaded scene is not changed. ``sensor`` is an index into the scene's sensors, ``None`` for any or
    none, where the scene is not looked at through it; ``camera`` moves it, except in loaded scenes. ``parameters``
    gives values to ``$variables`` of an XML file. ``memory`` limits what a method stores, in bytes. The scene's
    integrator is reported, not built. Without ``check`` unsupported elements raise no error; unless ``lit``, the scene
    needs no emitter. ``change`` (such as :class:`LightEdits`) changes the parsed scene before its objects are built;
    equivalent elements and meshes are then not merged.

    Sets a Mitsuba variant if none is set: see :func:`use_variant_of`. Raises :class:`SceneError` for a scene that
    cannot be read or is broken, :class:`UnsupportedError` for elements that cannot be rendered, :class:`OptionError`
    for arguments out of range.
    """

    use_variant_of(source)
    if size is not None:
        size = checked_size(size)
    if memory is not None and memory <= 0:
        raise OptionError(f"a memory bound must be above zero bytes, not {memory}")
    if not _is_loaded(source):
        found = described(source, logger.info)
        return _from_parser(found, *_parse(found, parameters), size, sensor, memory, camera, check, change, lit)
    if parameters:
        raise OptionError(_NO_VARIABLES)
    if change is not None:
        raise OptionError("lights of a loaded scene cannot be added or removed; give its file or its dictionary")
    if camera is not None:
        raise OptionError("the camera of a loaded scene cannot be moved; load the scene with that camera")
    return _from_scene(source, size, sensor, memory, check, lit)


def integrator_of(source: Source, parameters: Mapping[str, Any] | None = None) -> str:
    """Plugin name of a scene's integrator, "" if it has none. ``source`` is parsed, but not built.

    Sets a Mitsuba variant if none is set: see :func:`use_variant_of`. Errors as :func:`load`, as far as parsing finds
    them.
    """
    use_variant_of(source)
    if not _is_loaded(source):
        found = described(source, logger.debug)
        return take_integrator(_parse(found, parameters)[-1])[0]
    return "" if source.integrator() is None else built_integrator(source.integrator())[0]


def _is_loaded(source: Source) -> TypeGuard[mi.Scene]:
    return type(source).__name__ == "Scene" and hasattr(source, "sensors")


def locate(name: str | os.PathLike[str], tell: Callable[[str], object] = logger.info) -> Path | BundledScene:
    """The scene file or the bundled scene of a name.

    A file takes precedence over a bundled scene of the same name, and so does a folder with a ``scene.xml``; any other
    folder does not. If both exist, ``tell`` receives a line that says which one is used. Raises :class:`SceneError` if
    there is neither.
    """
    name, path = str(name), Path(name)
    inner = path / _SCENE_FILE
    file = path if path.is_file() else inner if inner.is_file() else None
    if file is not None:
        if file.suffix.lower() not in (".xml", "", *SUFFIXES):
            raise SceneError(
                f"'{name}' is not a scene file; give Mitsuba's .xml, a model ({', '.join(SUFFIXES)}) or a bundled scene"
            )
        if not path.suffix and name in bundled():
            tell(f"'{name}' is read as the file {file}, not as the bundled scene")
        return file
    scenes = bundled()
    if name in scenes:
        if path.is_dir():
            tell(f"'{name}' is read as the bundled scene; the folder of that name has no {_SCENE_FILE}")
        return scenes[name]
    if path.is_dir():
        raise SceneError(f"'{name}' is a folder without a {_SCENE_FILE}; name the scene file in it")
    hint = suggest(name, scenes, "bundled scenes")
    raise SceneError(f"there is no scene file '{name}', and no bundled scene of that name; {hint}")


def colours_of(source: Any) -> str:
    """The colours that a scene needs, for ``core.use_variant``: ``spectral`` if its description names materials that
    disperse light or a film of bands of wavelengths, else ``rgb``. Never raises: what is wrong with a scene is found
    when it is loaded."""
    try:
        scene = locate(source, logger.debug) if isinstance(source, (str, os.PathLike)) else source
        if isinstance(scene, Path) and scene.suffix.lower() in (".gltf", ".glb"):
            is_spectral = "KHR_materials_dispersion" in description(scene).get("extensionsUsed", ())
        elif isinstance(scene, Path):
            is_spectral = scene.suffix.lower() == ".xml" and bool(_SPECTRAL.search(scene.read_text("utf-8", "ignore")))
        else:
            is_spectral = scene.is_spectral if isinstance(scene, BundledScene) else _names_wavelengths(scene)
    except (SceneError, OSError):
        return "rgb"
    return "spectral" if is_spectral else "rgb"


def use_variant_of(source: Any, requested: str | None = None) -> str:
    """As ``core.use_variant``, with the colours that a scene needs: see :func:`colours_of`."""
    import mitsuba as mi

    undecided = requested is None and mi.variant() is None
    return use_variant(requested, colours_of(source) if undecided else "rgb")


_SPECTRAL = re.compile(r"""type\s*=\s*["']((rough)?dispersive|specfilm)["']""")


def _names_wavelengths(described: Any) -> bool:
    if not isinstance(described, Mapping):
        return False
    return described.get("type") in ("dispersive", "roughdispersive", "specfilm") or any(
        map(_names_wavelengths, described.values())
    )


def described(source: Any, tell: Callable[[str], object]) -> Path | BundledScene | Mapping[str, Any]:
    """The scene file, the bundled scene or the dictionary that ``source`` is or names; ``tell`` as for :func:`locate`.
    Raises :class:`SceneError`."""
    if isinstance(source, (str, os.PathLike)):
        return locate(source, tell)
    if isinstance(source, (BundledScene, Mapping)):
        return source
    kind = type(source).__name__
    raise SceneError(f"a scene is a file, a bundled scene, a dictionary or a loaded mi.Scene, not an object of {kind}")


def checked_size(size: Sequence[int]) -> Size:
    """(width, height) as plain numbers. Raises :class:`OptionError` unless that can be the size of a picture."""
    try:
        width, height = (int(v) for v in size)
    except (TypeError, ValueError):
        raise OptionError(f"a size is (width, height) in pixels, not {size!r}") from None
    if width < 1 or height < 1:
        raise OptionError(f"a picture needs at least one pixel a side, not {width}x{height}")
    if width * height > MOST_PIXELS:
        raise OptionError(f"{width}x{height} is too large a picture: at most 2^30 pixels, such as 32768x32768")
    return width, height


_NO_VARIABLES = "parameters replace $variables of an XML file; this scene is not an XML file"


def _parse(
    source: Described, parameters: Mapping[str, Any] | None
) -> tuple[str, mi.FileResolver, mi.parser.ParserConfig, mi.parser.ParserState]:
    """Name of a scene, where its files are searched, and Mitsuba's configuration and state once it is parsed."""
    import mitsuba as mi

    name = "<dict>" if isinstance(source, Mapping) else str(source)
    if is_model(source):
        source = model(source)
    path = source if isinstance(source, Path) else None
    if path is None and parameters:
        raise OptionError(_NO_VARIABLES)
    config = mi.parser.ParserConfig(mi.variant())
    config.parallel = False  # a node that fails while others load in parallel can crash the process (Mitsuba 3.9.1)
    folders = mi.FileResolver(mi.file_resolver())
    if path is not None:
        folders.prepend(str(path.parent))
    with _resolving(folders), _mitsuba_errors(name):
        if not isinstance(source, Path):
            described = source.build() if isinstance(source, BundledScene) else dict(source)
            state = mi.parser.parse_dict(config, described)
        else:
            state = mi.parser.parse_file(config, str(source), **{str(k): str(v) for k, v in (parameters or {}).items()})
        mi.parser.transform_upgrade(config, state)
        mi.parser.transform_resolve(config, state)
        give_types(state)
        folders = mi.FileResolver(mi.file_resolver())  # with those of the file's <path> elements
    if state.root.type != mi.ObjectType.Scene:
        raise SceneError(f"{name} describes a '{state.root.props.plugin_name()}', not a scene")
    return name, folders, config, state


def _from_parser(
    source: Described,
    name: str,
    folders: mi.FileResolver,
    config: mi.parser.ParserConfig,
    state: mi.parser.ParserState,
    size: Size | None,
    sensor: int | None,
    memory: int | None,
    camera: Camera | None,
    check: bool,
    change: Change | None,
    lit: bool,
) -> Problem:
    import mitsuba as mi

    from .immersion import check_media
    from .meters import with_own_meter

    with _resolving(folders), _mitsuba_errors(name):
        if change is not None:
            change(state)
        settle_transforms(state, name, check)
        integrator, depth, options = take_integrator(state)
        if size is not None:
            resize(state, size)
        if camera is not None:
            camera.move_sensors(state)
        check_films(state, name)
        details = texture_details(state)
        if change is None:
            mi.parser.transform_merge_equivalent(config, state)
        unmerged = mi.parser.ParserState(state)
        if change is None:
            merge_meshes(state)
        scene = instantiated(config, state)

    def checked(test: Callable[[mi.Scene, mi.Sensor], None]) -> None:
        try:
            test(scene, chosen)
        except SceneError as error:
            # Merged meshes have lost their names: check again without merging, so that the error names the element.
            try:
                with _resolving(folders), _mitsuba_errors(name):
                    named = instantiated(config, unmerged)
            except SceneError:  # arrays in a description can be taken only once
                raise error from None
            test(named, _sensor(named, sensor, name))
            raise

    chosen = _sensor(scene, sensor, name)
    if camera is not None:
        check_movable(chosen, name)
    if check:
        checked(partial(check_scene, lit=lit))
        if lit and change is None:
            check_light(scene)
    space = RenderSpace.of(scene, chosen)
    if not space.is_own:
        with _resolving(folders), _mitsuba_errors(name):
            scene, space = moved(scene, chosen, space, source, name, config, unmerged)
        chosen = _sensor(scene, sensor, name)
    if check:
        checked(check_media)
    if not integrator and scene.integrator() is not None:
        # The type of a Python plugin is not known before it is built.
        integrator, depth, options = built_integrator(scene.integrator())
    found = lamps_in_surfaces(scene) if check else []
    if change is None and space.is_own and not all(element_name(shape) for _, shape in found):
        with _resolving(folders), _mitsuba_errors(name):
            named = instantiated(config, unmerged)  # for the names of merged meshes
        found = lamps_in_surfaces(named)
    remarks = remarks_on(found)
    made = _problem(scene, chosen, integrator, depth, options, name, memory, details, space, remarks)
    return with_own_meter(made)


@contextmanager
def _resolving(folders: mi.FileResolver) -> Iterator[None]:
    """Let Mitsuba search textures and meshes in ``folders``, inside the block."""
    import mitsuba as mi

    before = mi.file_resolver()
    mi.set_file_resolver(mi.FileResolver(folders))  # a copy, because <path> elements of a file change it
    try:
        yield
    finally:
        mi.set_file_resolver(before)


@contextmanager
def _mitsuba_errors(name: str) -> Iterator[None]:
    """Convert Mitsuba's exceptions to errors of étendue, with a remedy."""
    try:
        yield
    except EtendueError:
        raise
    except (RuntimeError, ValueError, TypeError, KeyError) as error:
        # The error of a Python plugin contains its traceback: keep only the message in its last line.
        text = re.sub(r"Traceback \(most recent call last\):\n(?:\s+.*\n)*(?:\w+\.)*\w+: ", "", str(error))
        text = re.sub(r"\[\w+\.(cpp|h|inl):\d+\]\s*", "", text)
        text = re.sub(r"\s+", " ", text).strip().rstrip(".")
        if "needs wavelengths" in text:
            raise UnsupportedError(f"{name}: {text[text.index('material ') :]}") from error
        if "unused parameters" in text:
            raise OptionError(f"{name} has no such $variable: {text.split(':', 1)[-1].strip(' -')}") from error
        raise SceneError(f"{text if name in text else f'{name}: {text}'}; {_remedy(text)}") from error


def _remedy(text: str) -> str:
    if variable := re.search(r"undefined parameter: \$(\w+)", text):
        return f"give it a value (-P {variable[1]}=VALUE, or `parameters`), or add a <default> to the file"
    for pattern, remedy in (
        ("unresolved reference", "correct the reference"),
        ("not found!|No such file|does not exist", "correct the name, or put the file there"),
        ("unreferenced propert", "correct or remove it"),
        ("Parsing of XML|could not parse|tags mismatch", "correct the file there"),
    ):
        if re.search(pattern, text):
            return remedy
    return "correct the scene"


def _from_scene(
    scene: mi.Scene, size: Size | None, sensor: int | None, memory: int | None, check: bool, lit: bool
) -> Problem:
    import mitsuba as mi

    from .immersion import check_media
    from .meters import with_own_meter

    if scene.variant_name() != mi.variant():
        raise SceneError(
            f"the scene was loaded under '{scene.variant_name()}' but '{mi.variant()}' is set; load it again"
        )
    extend_curves(scene)
    chosen = _sensor(scene, sensor, "the scene")
    warn_of_offsets(scene, chosen, "the scene")
    if size is not None and size != tuple(int(v) for v in chosen.film().size()):
        chosen = resized_sensor(chosen, size)
    if check:
        check_scene(scene, chosen, lit)
        check_media(scene, chosen)
    integrator = scene.integrator()
    name, depth, options = ("", -1, {}) if integrator is None else built_integrator(integrator)
    remarks = remarks_on(lamps_in_surfaces(scene)) if check else ()
    return with_own_meter(_problem(scene, chosen, name, depth, options, "<scene>", memory, "", remarks=remarks))


def _sensor(scene: mi.Scene, index: int | None, name: str) -> mi.Sensor:
    sensors = scene.sensors()
    if index is None:
        return sensors[0] if sensors else _stand_in(scene)
    if not sensors:
        raise SceneError(f"{name} has no sensor, so there is nothing to render; add a 'perspective' sensor")
    if not 0 <= index < len(sensors):
        raise OptionError(f"{name} has no sensor {index}; choose one of 0 to {len(sensors) - 1}")
    return sensors[index]


def _stand_in(scene: mi.Scene) -> mi.Sensor:
    """A camera in the middle of a scene that has none."""
    import mitsuba as mi

    place = mi.ScalarTransform4f().translate(list(centre_of(scene)))
    return mi.load_dict(
        {"type": "perspective", "to_world": place, "film": {"type": "hdrfilm", "width": 1, "height": 1}}
    )


def _problem(
    scene: mi.Scene,
    sensor: mi.Sensor,
    integrator: str,
    depth: int,
    options: dict[str, Any],
    name: str,
    memory: int | None,
    details: str,
    space: RenderSpace | None = None,
    remarks: tuple[tuple[str, str], ...] = (),
) -> Problem:
    width, height = (int(v) for v in sensor.film().crop_size())
    if not 1 <= width * height <= MOST_PIXELS:
        raise SceneError(f"the film of {name} has {width}x{height} pixels; it has at least one and at most 2^30")
    warn_of_lamps(remarks, name)
    return Problem(
        scene=scene,
        sensor=sensor,
        size=(width, height),
        spp=int(sensor.sampler().sample_count()),
        max_depth=depth,
        hide_emitters=bool(options.pop("hide_emitters", False)),
        integrator=integrator,
        integrator_options=options,
        source=name,
        memory=memory,
        details=details,
        space=space or RenderSpace(),
        remarks=remarks,
    )
