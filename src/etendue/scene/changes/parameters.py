"""The parameters of a scene that can be edited: lights, materials, textures, media, and the places of shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError, suggest

from ..graph import contents, plugin_name
from ..packet import is_spectral
from .transforms import fault, misshapen
from .values import COLOUR, TEXTURE, TRANSFORM, Range, Value, checked, for_scene, kind_of, plain, range_of

if TYPE_CHECKING:
    import mitsuba as mi

#: Parameters that are not to be edited, because they change how a picture is sampled rather than what it shows.
_UNUSED = frozenset({"sampling_weight", "silhouette_sampling_weight"})
#: Groups of parameters.
LIGHT, MATERIAL, MEDIUM, SHAPE = "light", "material", "medium", "shape"


@dataclass(frozen=True)
class SceneParameter:
    """A parameter of a loaded scene."""

    key: str  #: as ``mi.traverse`` names it, such as ``lamp.emitter.radiance.value``
    kind: str  #: see :mod:`.values`
    group: str  #: ``light``, ``material``, ``medium`` or ``shape``
    plugin: str  #: plugin of the object that has it, such as ``diffuse``
    allowed: Range
    value: Value  #: the current value

    @property
    def element(self) -> str:
        """Name of the scene's element that the parameter belongs to."""
        return self.key.split(".", 1)[0]

    @property
    def label(self) -> str:
        """Name of the parameter within the element."""
        return _meant(self.key.split(".", 1)[-1])

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a page; limits that are infinite are left out."""
        limits = {"least": self.allowed.least, "most": self.allowed.most}
        finite = {name: limit for name, limit in limits.items() if abs(limit) != float("inf")}
        plain = {"key": self.key, "kind": self.kind, "group": self.group, "plugin": self.plugin, "value": self.value}
        return plain | {"element": self.element, "label": self.label} | finite


@dataclass
class SceneEditor:
    """Parameters of a loaded scene, and changes of their values in place.

    ``scene`` must have been loaded with a change (such as :func:`name_elements`), so that its elements have names and
    are not merged. The caller prepares methods anew after a change, because their tables of lights are outdated.
    """

    scene: mi.Scene
    fixed: bool = False  #: whether positions cannot be edited, because they are not in the file's coordinates

    def __post_init__(self) -> None:
        import mitsuba as mi

        self._values = mi.traverse(self.scene)
        self._owners = {key: entry[2] for key, entry in self._values.properties.items()}
        self._groups = _groups(self.scene)

    def list(self) -> list[SceneParameter]:
        """All parameters that can be edited, in the scene's order."""
        return [found for key in self._owners if (found := self._parameter(key)) is not None]

    def get(self, key: str) -> SceneParameter:
        """One parameter. Raises :class:`OptionError` for an unknown key."""
        found = self._parameter(key) if key in self._owners else None
        if found is None:
            raise OptionError(f"the scene has no parameter '{key}'; {suggest(key, [p.key for p in self.list()])}")
        return found

    def check(self, key: str, value: Any) -> Value:
        """``value`` as the parameter holds it. Raises :class:`OptionError` for a value that it cannot have."""
        parameter = self.get(key)
        good = checked(key, parameter.kind, parameter.allowed, value)
        if parameter.kind == TRANSFORM:
            transform = for_scene(self._values[key], TRANSFORM, good)
            if why := fault(parameter.plugin, key.rsplit(".", 1)[-1], transform) or misshapen(
                parameter.plugin, transform
            ):
                raise OptionError(f"'{parameter.element}' {why}")
        if key.endswith((".beam_width", ".cutoff_angle")):
            _check_spot(self, key, good)
        return good

    def set(self, values: Mapping[str, Any]) -> None:
        """Change values in place; nothing is changed if one of them is refused. Raises as :meth:`check`, and
        :class:`OptionError` for a texture, which needs the scene to be loaded again."""
        checked = {key: self.check(key, value) for key, value in values.items()}
        for key in checked:
            if self.get(key).kind == TEXTURE:
                raise OptionError(f"the picture of '{key}' is read with the scene; load it again")
        for key, value in checked.items():
            parameter = self.get(key)
            self._values[key] = for_scene(self._values[key], parameter.kind, value)
        self._values.update()

    def _parameter(self, key: str) -> SceneParameter | None:
        owner = self._owners[key]
        name = key.rsplit(".", 1)[-1]
        group = self._groups.get(id(owner))
        if group is None or name in _UNUSED or name.endswith("_sampling_rate") or "_index_" in name:
            return None
        value = self._values[key]
        kind = kind_of(value)
        if kind == COLOUR and is_spectral():  # coefficients of a spectrum, and no colour
            return None
        if kind is None or (group == SHAPE and (name != "to_world" or kind != TRANSFORM)):
            return None
        if group == MEDIUM and (kind == TEXTURE or (self.fixed and name == "scale")):  # per length of the render space
            return None
        if self.fixed and (name in ("to_world", "position") or key.endswith(".intensity.value")):
            return None
        meant = _meant(key).rsplit(".", 1)[-1]
        if meant == "texture" and kind != TEXTURE:  # of a spot light without a texture: a file cannot set it
            return None
        while (plugin := plugin_name(owner)).endswith(("spectrum", "constvolume")):  # name the object that has it
            owner = self._values.hierarchy[owner][0]
        return SceneParameter(key, kind, group, plugin, range_of(meant, group == LIGHT), plain(value, kind))


def _meant(key: str) -> str:
    """A key without the names of the constants that hold its value."""
    return re.sub(r"(\.value)+$", "", key)


def _groups(scene: mi.Scene) -> dict[int, str]:
    """The group of each object of a scene that has parameters, by ``id()``; ``mi.traverse`` keeps the same objects."""
    import mitsuba as mi

    found: dict[int, str] = {}
    seen: dict[int, Any] = {}

    def visit(item: mi.Object, group: str | None) -> None:
        if isinstance(item, (mi.Sensor, mi.Film, mi.Sampler, mi.Integrator)) or id(item) in seen:
            return
        seen[id(item)] = item
        if isinstance(item, mi.Emitter):
            group = LIGHT
        elif isinstance(item, mi.BSDF):
            group = MATERIAL
        elif isinstance(item, mi.Medium):
            group = MEDIUM
        elif isinstance(item, mi.Shape):
            group = SHAPE
        if group is not None:
            found[id(item)] = group
        for _, child in contents(item).objects:
            visit(child, group)

    visit(scene, None)
    return found


def _check_spot(editor: SceneEditor, key: str, value: Value) -> None:
    """A spot light's beam must lie within its cone, or it is black or divides by zero."""
    prefix = key.rsplit(".", 1)[0]
    beam, cutoff = (
        value if key == name else editor.get(name).value for name in (f"{prefix}.beam_width", f"{prefix}.cutoff_angle")
    )
    if not isinstance(beam, float) or not isinstance(cutoff, float) or not beam < cutoff < 180.0:
        raise OptionError(f"'{prefix}' needs a beam_width below its cutoff_angle, not {beam} and {cutoff}")
