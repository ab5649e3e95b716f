"""Recipes: JSON, and files by content, from which a worker makes the problem and the method of a run."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import ClusterError, Ingredients, Method, optimise_kernels, prepared, use_variant
from etendue.engine import versions

from .content import ContentFile, Offered, Store

#: Prefix of the arrays that are arguments of the method.
_ARGUMENT = "argument/"


@dataclass
class Recipe:
    """The problem and the method of a run."""

    digest: str
    offered: Offered
    #: Whether passes depend on each other.
    carries_on: bool = False


def recipe(
    ingredients: Ingredients,
    method: Method,
    fingerprint: str | None,
    arguments: Mapping[str, NDArray[Any]] | None = None,
    make: str | None = None,
) -> Recipe:
    """The recipe of a prepared method. Workers make it from its settings; if its class takes more than these, ``make``
    names a function ``module:name`` of (settings, problem, **arguments) that makes it. ``fingerprint``: that of the
    problem, ``None`` for one that the client has not loaded. Raises :class:`ClusterError` for
    a method that workers cannot import."""
    offered, kind = Offered(), type(method)
    if kind.__module__ == "__main__":
        raise ClusterError(
            f"'{method.name}' is defined in the script that runs: put it into a module that workers can import"
        )
    arrays = ingredients.arrays | {f"{_ARGUMENT}{name}": array for name, array in (arguments or {}).items()}
    manifest: dict[str, Any] = {
        "versions": versions(),
        "optimise": optimise_kernels(None),  # with those of this process, numbers are the same to the last bit
        "fingerprint": fingerprint,
        "open": ingredients.open,
        "values": ingredients.values,
        "arrays": None,
        "files": {place: asdict(offered.add(path)) for place, path in ingredients.files.items()},
        "method": f"{kind.__module__}:{kind.__qualname__}",
        "make": make,
        "settings": method.settings.to_json(),
    }
    if arrays:
        file = io.BytesIO()
        np.savez(file, **arrays)  # type: ignore[arg-type]
        manifest["arrays"] = asdict(offered.add(file.getvalue()))
    digest = offered.add(json.dumps(manifest, sort_keys=True).encode()).digest
    return Recipe(digest, offered, method.carries_on)


class Lacking(Exception):
    """Files that a worker does not have, by digest."""

    def __init__(self, digests: list[str]) -> None:
        super().__init__(", ".join(digests))
        self.digests = digests


class OpenRecipe:
    """A recipe in a worker: its problem, for which methods are made."""

    def __init__(self, store: Store, digest: str) -> None:
        """Raises :class:`Lacking` if files are to be sent, :class:`ClusterError` if this worker cannot be used, and the
        errors of loading the scene."""
        manifest = json.loads(_found(store, {"": ContentFile(digest, 0)})[""].read_bytes())
        self._manifest, self.digest = manifest, digest
        check_versions(manifest["versions"])
        use_variant(manifest["versions"]["variant"])
        optimise_kernels(manifest["optimise"])
        entries = {place: ContentFile(**entry) for place, entry in manifest["files"].items()}
        files = _found(store, entries)
        self._arrays: dict[str, NDArray[Any]] = {}
        if manifest["arrays"] is not None:
            path = _found(store, {"": ContentFile(**manifest["arrays"])})[""]
            with np.load(path, allow_pickle=False) as archive:
                self._arrays = {name: archive[name] for name in archive.files}
        ingredients = Ingredients(manifest["open"], manifest["values"], self._arrays, files)
        folder = store.tree(digest, files) if files else store.folder
        try:
            self.problem = _named(manifest["open"])(ingredients, folder)
        finally:
            if files:  # they have been read
                shutil.rmtree(folder, ignore_errors=True)
        if manifest["fingerprint"] not in (None, self.problem.fingerprint):
            raise ClusterError("the scene is another one there: its files or plugins differ")
        store.tidy()

    def method(self, seed: int) -> Method:
        """A prepared method."""
        manifest = self._manifest
        kind = _named(manifest["method"])
        settings = kind.Settings.from_json(manifest["settings"])
        given = {k.removeprefix(_ARGUMENT): v for k, v in self._arrays.items() if k.startswith(_ARGUMENT)}
        method: Method
        method = (
            kind(settings) if manifest["make"] is None else _named(manifest["make"])(settings, self.problem, **given)
        )
        return prepared(method, self.problem, seed)


def check_versions(wanted: Mapping[str, str]) -> None:
    """Raise :class:`ClusterError` unless this process has the same versions and can use the variant."""
    here = versions()
    for name in ("etendue", "mitsuba", "drjit"):
        if here[name] != wanted[name]:
            raise ClusterError(f"it has {name} {here[name]}, the client {wanted[name]}; install the same versions")


def _found(store: Store, entries: Mapping[str, ContentFile]) -> dict[str, Path]:
    found = {place: store.find(entry) for place, entry in entries.items()}
    if lacking := sorted({entries[place].digest for place, path in found.items() if path is None}):
        raise Lacking(lacking)
    return {place: path for place, path in found.items() if path is not None}


def _named(name: str) -> Any:
    module, _, inner = name.partition(":")
    found: Any = import_module(module)
    for part in inner.split("."):
        found = getattr(found, part)
    return found
