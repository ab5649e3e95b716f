"""Pictures as files: multi-layer OpenEXR with metadata, and reading of reference pictures.

The layer ``image`` is the file's R, G, B, so that every viewer shows the picture, and ``alpha`` is its A; another
layer ``name`` has channels ``name.R``, ``name.G``, ``name.B`` (``name.X``, ``name.Y``, ``name.Z`` for normals and
positions, ``name.Z`` for a depth, ``name.Y`` for any other single channel); those of a picture with bands of
wavelengths in place of colours have the names of the bands. Metadata are string attributes ``etendue:key``: text
unchanged, anything else as JSON; attributes of a :mod:`.cryptomatte` have the names that compositors know.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import VERSION, OptionError, OutputError, Result, SceneError

from .cryptomatte import ATTRIBUTES
from .layers import ALPHA
from .output import replacing

_PREFIX = "etendue:"
#: Key of the metadata of a picture that has bands of wavelengths in place of colours: their names, in their order.
BANDS = "bands"
#: Layers of directions and positions, whose channels are axes rather than colours.
_VECTOR_LAYERS = frozenset({"normal", "seen_normal", "position", "tangent"})
_DEPTH_LAYERS = frozenset({"depth"})
_CHANNEL_ORDERS = ("RGB", "RGBA", "XYZ", "Y", "Z", "YA")
#: Channels that make up a picture also where others are beside them.
_COLOURS = ("RGBA", "RGB")
_MAGIC = b"\x76\x2f\x31\x01"


def write_exr(path: str | os.PathLike[str], result: Result) -> None:
    """Write every layer of ``result`` as 32-bit floats, and its metadata, to one OpenEXR file.

    The file is written atomically. Raises :class:`OutputError` if it cannot be written or a layer has another
    size than the picture.
    """
    import OpenEXR

    channels: dict[str, NDArray[np.float32]] = {}
    size: tuple[int, ...] | None = None
    for name, layer in result.layers.items():
        values = np.asarray(layer, dtype=np.float32)
        values = values[:, :, None] if values.ndim == 2 else values
        size = size or values.shape[:2]
        if values.ndim != 3 or values.shape[:2] != size:
            raise OutputError(f"cannot write '{path}': layer '{name}' has shape {values.shape}, the picture {size}")
        names = channel_names(name, values.shape[2], path, result.metadata.get(BANDS))
        for index, channel in enumerate(names):
            channels[channel] = np.ascontiguousarray(values[:, :, index])
    if not channels:
        raise OutputError(f"cannot write '{path}': the result has no layers")
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "software": f"etendue {VERSION}",
    }
    for key, value in result.metadata.items():
        header |= {key: value} if key.startswith(ATTRIBUTES) else {_PREFIX + key: _encode(value)}
    with replacing(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:
            raise OutputError(f"cannot write '{path}': {' '.join(str(error).split())}") from None


def write_layers(path: str | os.PathLike[str], result: Result) -> None:
    """Write each layer of ``result`` to its :func:`layer_path`, as the R, G, B (or Y) of that file, with the metadata.

    The metadata ``layer`` is the layer's name. Errors as :func:`write_exr`.
    """
    for name, layer in result.layers.items():
        write_exr(layer_path(path, name), Result({"image": layer}, {**result.metadata, "layer": name}))


def layer_path(path: str | os.PathLike[str], layer: str) -> Path:
    """File of a layer that is not written together with the others: ``path`` itself for ``image``, else
    ``name-LAYER.exr`` for ``name.exr``."""
    path = Path(path)
    return path if layer == "image" else path.with_name(f"{path.stem}-{layer}{path.suffix}")


def read_exr(path: str | os.PathLike[str]) -> Result:
    """Read a file of :func:`write_exr`, or any scan-line OpenEXR file, as layers (height, width, channels), float32.

    Channels without a layer name make up ``image``. A beside R, G and B is the layer ``alpha``, and others, such as Z,
    are layers of their own. Raises :class:`SceneError` if the file is missing or not OpenEXR.
    """
    import OpenEXR

    _check_readable(path)
    if not is_exr(path):
        raise SceneError(f"'{path}' is not an OpenEXR file")
    try:
        file = OpenEXR.File(str(path), separate_channels=True)
        stored = {name: np.asarray(channel.pixels) for name, channel in file.channels().items()}
        header = file.header()
    except (RuntimeError, ValueError) as error:
        # OpenEXR reports a damaged file as one without parts.
        raise SceneError(f"'{path}' is a damaged OpenEXR file: {' '.join(str(error).split())}") from None
    grouped: dict[str, dict[str, NDArray[Any]]] = {}
    for name, pixels in stored.items():
        layer, _, suffix = name.rpartition(".")
        grouped.setdefault(layer or "image", {})[suffix] = pixels
    metadata = {key.removeprefix(_PREFIX): _decode(v) for key, v in header.items() if key.startswith(_PREFIX)}
    metadata |= {key: value for key, value in header.items() if key.startswith(ATTRIBUTES)}
    bands = metadata.get(BANDS, ())
    layers = {}
    if "A" in (colours := grouped.get("image", {})) and colours.keys() > set(bands or "RGB"):
        grouped[ALPHA] = {"A": colours.pop("A")}
    for layer in sorted(grouped, key=lambda name: (name != "image", name)):
        members = grouped[layer]
        order = (
            (bands if set(bands) == members.keys() else "")
            or next((o for o in _CHANNEL_ORDERS if set(o) == members.keys()), "")
            or next((o for o in _COLOURS if set(o) < members.keys()), "")
            or sorted(members)
        )
        layers[layer] = np.stack([members[suffix] for suffix in order], axis=-1).astype(np.float32)
        for suffix in sorted(members.keys() - set(order)):
            own = suffix if layer == "image" else f"{layer}.{suffix}"
            layers[own] = members[suffix][..., None].astype(np.float32)
    return Result(layers=layers, metadata=metadata)


def read_image(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a picture as linear RGB, (height, width, 3), float32: OpenEXR, or whatever Mitsuba reads (PNG, JPEG, HDR).

    Eight-bit files are taken as sRGB, a single channel is repeated, alpha is dropped. Raises :class:`SceneError` if
    the file is missing or not a picture.
    """
    _check_readable(path)
    if is_exr(path):
        read = read_exr(path)
        refuse_bands(read.metadata, f"'{path}'")
        layers = read.layers
        pixels = layers.get("image")
        if pixels is None:
            raise SceneError(f"'{path}' has no R, G, B channels, only layers: {', '.join(layers)}")
    else:
        import mitsuba as mi

        try:
            bitmap = mi.Bitmap(str(path))
            # Conversion to Float32 undoes the sRGB curve where the file has it.
            pixels = np.array(bitmap.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False))
        except RuntimeError:
            raise SceneError(f"'{path}' is not a picture that can be read; use OpenEXR, PNG, JPEG or HDR") from None
        pixels = pixels[:, :, None] if pixels.ndim == 2 else pixels
    if pixels.shape[2] < 3:
        pixels = np.repeat(pixels[:, :, :1], 3, axis=2)
    return np.ascontiguousarray(pixels[:, :, :3], dtype=np.float32)


def refuse_bands(metadata: Mapping[str, Any], what: str) -> None:
    """Raise :class:`OptionError` if the channels of a picture are bands of wavelengths. ``what``: the picture, in
    messages."""
    if (bands := metadata.get(BANDS)) is not None:
        raise OptionError(
            f"{what} has bands of wavelengths ({', '.join(bands)}), not colours; write it as .exr and read its "
            "channels, or render with an 'hdrfilm'"
        )


def channel_names(
    layer: str, count: int, path: str | os.PathLike[str] = "the picture", bands: Sequence[str] | None = None
) -> list[str]:
    """Names of the ``count`` channels of a layer, those of ``bands`` in a picture that has some. Raises
    :class:`OutputError` unless there are 1, 3 or 4 without bands."""
    suffixes: Sequence[str]
    if layer == ALPHA and count == 1:
        return ["A"]
    if bands is not None and count == len(bands):  # coverage, in a file of its own, is no band
        suffixes = bands
    elif count == 1:
        suffixes = "Z" if layer in _DEPTH_LAYERS else "Y"
    elif count == 3:
        suffixes = "XYZ" if layer in _VECTOR_LAYERS else "RGB"
    elif count == 4:
        suffixes = "RGBA"
    else:
        raise OutputError(f"cannot write '{path}': layer '{layer}' has {count} channels; 1, 3 or 4 can be stored")
    return [suffix if layer == "image" else f"{layer}.{suffix}" for suffix in suffixes]


def _encode(value: Any) -> str:
    """Text is stored unchanged unless it could be read as JSON."""
    if isinstance(value, str):
        try:
            json.loads(value)
        except ValueError:
            return value
    return json.dumps(value, sort_keys=True, default=_plain, ensure_ascii=False)


def _decode(text: Any) -> Any:
    if not isinstance(text, str):
        return text
    try:
        return json.loads(text)
    except ValueError:
        return text


def _plain(value: Any) -> Any:
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    return str(value)


def _check_readable(path: str | os.PathLike[str]) -> None:
    if not Path(path).is_file():
        raise SceneError(f"there is no picture '{path}'; check the path")


def is_exr(path: str | os.PathLike[str]) -> bool:
    """Whether a file is one of OpenEXR, by its first bytes. Raises :class:`SceneError` if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError as error:
        raise SceneError(f"'{path}' cannot be read: {error.strerror}") from None
