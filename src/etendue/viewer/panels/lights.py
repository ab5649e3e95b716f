"""Lights of the scene, and lights that are added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from etendue.core import OptionError, SceneError
from etendue.scene import LightEdits, colour, described_lights

from ..protocol import number, numbers, text
from ..refining import Still
from . import Panel

if TYPE_CHECKING:
    from ..clients import Client

#: Kinds of lights that can be added.
_KINDS = ("point", "area", "sky", "image")


class Lights(Panel):
    """Adding and removing lights. The scene is loaded again, since Mitsuba's scenes have a fixed list of them."""

    name: ClassVar[str] = "lights"
    title: ClassVar[str] = "Lights"
    script: ClassVar[str] = "lights.js"

    _own: tuple[str, ...] = ()  #: names of the scene's own lights

    def scene_loaded(self) -> None:
        """Find the lights in the scene's description."""
        asked = self.session.asked
        if self.session.problem is None:  # a picture of a file
            self._own = ()
            return
        try:
            self._own = tuple(described_lights(asked.scene, asked.parameters))
        except SceneError:
            self._own = ()  # a scene in memory has no description

    def state(self) -> dict[str, Any]:
        """The lights of the scene, the added lights, and the kinds that can be added."""
        edits = self.session.asked.lights
        own = [{"name": n, "index": k, "off": k in edits.removed} for k, n in enumerate(self._own)]
        added = [{"name": _named(light), "index": k} for k, light in enumerate(edits.added)]
        return {"own": own, "added": added, "kinds": _KINDS}

    def handle(self, verb: str, message: Mapping[str, Any], client: Client) -> None:
        """``add`` a light; ``remove`` an added light; ``switch`` a light of the scene off or on."""
        if isinstance(self.session.main, Still):
            raise OptionError("this is a picture without a scene; open one first")
        edits = self.session.asked.lights
        if verb == "add":
            # A unique name, kept when other lights are removed, so that changes of parameters find the light.
            fresh = 1 + max((int(one["id"].rpartition("-")[2]) for one in edits.added), default=0)
            light = {"id": f"added-light-{fresh}", **self._light(message)}
            edits = replace(edits, added=(*edits.added, light))
        elif verb == "remove":
            index = self._index(message, len(edits.added))
            edits = replace(edits, added=tuple(one for k, one in enumerate(edits.added) if k != index))
        elif verb == "switch":
            edits = replace(edits, removed=edits.removed ^ {self._index(message, len(self._own))})
        else:
            raise OptionError(f"there is no message 'lights.{verb}'; there are add, remove and switch")
        self._apply(edits)

    def _apply(self, edits: LightEdits) -> None:
        self.session.open(replace(self.session.asked, lights=edits), keep_pose=True)  # refuses a scene in memory
        self.session.changed()

    def _light(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """The plugin that a message describes."""
        import mitsuba as mi

        kind = text(message, "kind")
        shade = colour(numbers(message, "colour", 3))
        strength = number(message, "strength", 1.0)
        if strength <= 0:
            raise OptionError(f"the strength of a light is above zero, not {strength:g}")
        shade["value"] = [strength * v for v in shade["value"]]
        if kind == "sky":
            return {"type": "constant", "radiance": shade}
        if kind == "image":
            return {"type": "envmap", "filename": text(message, "file"), "scale": strength}
        position = np.array(numbers(message, "position", 3))
        if kind == "point":
            return {"type": "point", "position": position.tolist(), "intensity": shade}
        if kind != "area":
            raise OptionError(f"a light is one of {', '.join(_KINDS)}, not '{kind}'")
        size = number(message, "size")
        if size <= 0:
            raise OptionError(f"the size of a light is above zero, not {size:g}")
        target = np.array(numbers(message, "target", 3))
        view = target - position
        if not np.linalg.norm(view) > 0:
            raise OptionError("a light cannot point at its own place; move its target")
        up = np.eye(3)[int(np.argmin(np.abs(view)))]
        look = mi.ScalarTransform4f().look_at(position.tolist(), target.tolist(), up.tolist())
        return {
            "type": "rectangle",
            "to_world": look @ mi.ScalarTransform4f().scale([size / 2, size / 2, 1.0]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}},
            "emitter": {"type": "area", "radiance": shade},
        }

    @staticmethod
    def _index(message: Mapping[str, Any], count: int) -> int:
        index = message.get("index")
        if not isinstance(index, int) or not 0 <= index < count:
            raise OptionError(f"there is no light {index!r}; there are {count}")
        return index


def _named(light: Mapping[str, Any]) -> str:
    if light["type"] == "rectangle":
        return "area"
    place = " ".join(f"{v:.3g}" for v in light["position"]) if "position" in light else ""
    return f"{light['type']} {place}".strip()
