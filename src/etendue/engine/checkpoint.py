"""Checkpoints: a run in one file, from which it continues as if it had not been interrupted.

A checkpoint is a NumPy ``.npz`` archive without pickled objects: the sums, squares and products of the measurement as
float64 arrays, and a JSON header with everything else. Sums remain float64, so a resumed run adds the same numbers in
the same order as an uninterrupted one. Records of the measurement are in a folder beside the file, see
``recordfiles``.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from etendue.core import CheckpointError, Iterations, Measurement, OptionError, Settings, Weight, checked_path
from etendue.film import replacing

from .recordfiles import read_records, remove_others, write_records

#: Version of the layout of the file.
FORMAT = 3
_MAGIC = "etendue checkpoint"
_HEADER = "header"
# Exceptions of reading a damaged archive.
_DAMAGE = (ValueError, EOFError, KeyError, MemoryError, NotImplementedError, zipfile.BadZipFile, zlib.error)


@dataclass
class Checkpoint:
    """A measurement, and the method, settings and scene that it belongs to."""

    measurement: Measurement
    method: str
    #: Settings of the method as JSON text, see ``Settings.to_json``.
    settings: str
    seed: int
    #: Digest of the scene's parameters, sensor and film size.
    fingerprint: str
    #: State of the method after the last pass of the measurement.
    state: dict[str, Any] = field(default_factory=dict)
    #: How to find the scene again: the arguments of ``scene.load`` that are plain values.
    scene: dict[str, Any] = field(default_factory=dict)
    #: The budget of the run, see ``Budget.to_dict``.
    budget: dict[str, Any] = field(default_factory=dict)
    #: What ended the run, see ``stopping.StoppedBy``.
    stopped_by: str = "running"
    #: Versions of étendue, Mitsuba and Dr.Jit, and the variant.
    versions: dict[str, str] = field(default_factory=dict)
    #: Seconds of this run, as its budget counts them.
    elapsed: float = 0.0
    #: Seconds of earlier runs, if this one was resumed.
    earlier: float = 0.0
    #: Plain values of the caller.
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def colours(self) -> str:
        """Colours of the run's variant, for ``core.use_variant``."""
        return self.versions.get("variant", "").rpartition("_")[2] or "rgb"

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file atomically: a process that is killed leaves the complete old or new file.

        Rows of records are written once, by the first save that has them; after it the measurement reads them from the
        files. Raises :class:`OutputError` if something cannot be written; an existing checkpoint then remains.
        """
        records = write_records(self.measurement.records, path)
        arrays: dict[str, Any] = {}
        m = self.measurement
        for kind, table in (("sum", m.sums), ("square", m.squares), ("product", m.products)):
            for name, array in table.items():
                arrays[f"{kind}/{name}"] = np.asarray(array, dtype=np.float64)
        header = {
            "magic": _MAGIC,
            "format": FORMAT,
            "weights": _numbers(m.weights),
            "squared_weights": _numbers(m.squared_weights),
            "counters": m.counters,
            "iterations": m.iterations.to_json(),
            "records": records,
            "state": _pack(self.state, arrays),
            **{k: v for k, v in vars(self).items() if k not in ("measurement", "state")},
        }
        arrays[_HEADER] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        with replacing(path) as part, open(part, "wb") as file:
            np.savez(file, **arrays)
        remove_others(records, path)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Checkpoint:
        """Read a file. Raises :class:`CheckpointError` if it is missing, damaged, or not a checkpoint."""
        path = checked_path(path, "a checkpoint")
        try:
            with open(path, "rb") as file:
                arrays = _load(file)
        except FileNotFoundError:
            raise CheckpointError(f"there is no checkpoint {path}; check the name") from None
        except OSError as error:
            raise CheckpointError(f"cannot read checkpoint {path}: {error.strerror or error}") from error
        except _DAMAGE as error:
            raise CheckpointError(
                f"{path} is not an étendue checkpoint, or it is damaged ({error}); render again or use another one"
            ) from error
        try:
            header = json.loads(arrays.pop(_HEADER).tobytes())
            if header.pop("magic") != _MAGIC:
                raise KeyError("magic")
            version = header.pop("format")
            if version != FORMAT:
                raise CheckpointError(
                    f"checkpoint {path} has format {version}, this étendue reads format {FORMAT}; "
                    f"resume it with étendue {header.get('versions', {}).get('etendue', 'of its version')}"
                )
            measurement = Measurement(
                sums=_select(arrays, "sum/"),
                weights=_weights(header.pop("weights")),
                iterations=Iterations.from_json(header.pop("iterations")),
                squares=_select(arrays, "square/"),
                counters=header.pop("counters"),
                squared_weights=_weights(header.pop("squared_weights")),
                products=_select(arrays, "product/"),
                records=read_records(header.pop("records"), path),
            )
            return cls(measurement=measurement, state=_unpack(header.pop("state"), arrays), **header)
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise CheckpointError(
                f"{path} is not an étendue checkpoint, or it is damaged ({error}); render again or use another one"
            ) from error

    def settings_of(
        self, method: type[Any], given: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> Settings:
        """The saved settings, of the class ``method``.

        ``given`` are settings and ``seed`` is a seed that are requested now. Raises :class:`CheckpointError` unless
        method, settings and seed are those of the saved run.
        """
        if method.name != self.method:
            raise CheckpointError(
                f"the checkpoint was made by method '{self.method}', not '{method.name}'; resume it with {self.method}"
            )
        try:
            settings: Settings = method.Settings.from_json(self.settings)
        except OptionError as error:
            raise CheckpointError(f"{self._made_elsewhere()} ({error}); resume it with that one") from error
        saved, here = json.loads(self.settings), settings.to_dict()
        here = {name: here.get(name) for name in saved}  # the default of a newer setting is what was done before it
        if saved != here:
            raise CheckpointError(f"{self._made_elsewhere()} ({_differences(saved, here)}); resume it with that one")
        asked = settings.from_mapping(saved | dict(given or {}), owner=f"method '{self.method}'")
        if asked != settings:
            raise CheckpointError(
                f"the checkpoint was made with other settings ({_differences(saved, asked.to_dict())}); "
                "resume it with its own, or render anew"
            )
        if seed is not None and seed != self.seed:
            raise CheckpointError(f"the checkpoint was made with seed {self.seed}, not {seed}; resume it with its own")
        return settings

    def require_scene(self, fingerprint: str) -> None:
        """Raise :class:`CheckpointError` unless the rendered scene has this fingerprint."""
        if fingerprint != self.fingerprint:
            raise CheckpointError(
                "the scene is not the one the checkpoint was made with: its parameters, sensor or size have changed; "
                "restore the scene, or start a new render"
            )

    def _made_elsewhere(self) -> str:
        version = self.versions.get("etendue", "of another version")
        return f"the checkpoint was made by étendue {version}, whose '{self.method}' has other settings"


def _load(file: BinaryIO) -> dict[str, NDArray[Any]]:
    if not zipfile.is_zipfile(file):
        raise ValueError("not an archive, or cut off")
    file.seek(0)
    archive = np.load(file, allow_pickle=False)
    return {name: archive[name] for name in archive.files}


def _select(arrays: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _pack(value: Any, arrays: dict[str, Any]) -> Any:
    """``value`` for JSON; arrays in it are moved to ``arrays`` and replaced by references."""
    if isinstance(value, np.generic):
        return value.item()
    if hasattr(value, "__array__"):  # an array of NumPy or of the device
        key = f"state/{len(arrays)}"
        arrays[key] = np.asarray(value)
        return {"__array__": key}
    if isinstance(value, Mapping):
        return {str(k): _pack(v, arrays) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_pack(v, arrays) for v in value]
    return value


def _unpack(value: Any, arrays: dict[str, Any]) -> Any:
    """Inverse of :func:`_pack`; tuples come back as lists."""
    if isinstance(value, dict):
        if value.keys() == {"__array__"}:
            return arrays[value["__array__"]]
        return {k: _unpack(v, arrays) for k, v in value.items()}
    if isinstance(value, list):
        return [_unpack(v, arrays) for v in value]
    return value


def _differences(saved: dict[str, Any], asked: dict[str, Any]) -> str:
    names = [name for name in sorted(saved.keys() | asked.keys()) if saved.get(name) != asked.get(name)]
    return ", ".join(f"{name} was {saved.get(name)}, is {asked.get(name)}" for name in names)


def _numbers(weights: Mapping[str, Weight]) -> dict[str, Any]:
    """Weights as plain numbers, and as lists of those of channels."""
    return {name: np.asarray(weight).tolist() for name, weight in weights.items()}


def _weights(numbers: Mapping[str, Any]) -> dict[str, Weight]:
    """Inverse of :func:`_numbers`."""
    return {name: np.array(own) if isinstance(own, list) else own for name, own in numbers.items()}
