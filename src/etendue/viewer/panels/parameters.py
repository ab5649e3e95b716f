"""Parameters of the scene: lights, materials, textures and places of shapes, edited while it is rendered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.core import EtendueError, OptionError
from etendue.scene import ParameterChanges, SceneEditor, is_described

from ..protocol import text
from . import Panel

if TYPE_CHECKING:
    import mitsuba as mi

    from ..clients import Client


class Parameters(Panel):
    """Values are changed in place and the picture starts anew; a texture is read with the scene, which is loaded
    again."""

    name: ClassVar[str] = "parameters"
    title: ClassVar[str] = "Scene"
    script: ClassVar[str] = "parameters.js"

    def __init__(self, session: Any, changes: Mapping[str, Any] | None = None) -> None:
        """``changes``: made when the scene of the session is loaded."""
        super().__init__(session)
        self._changes: dict[str, Any] = dict(changes or {})
        self._editor: SceneEditor | None = None
        self._own: dict[str, Any] = {}  # values before the first change
        #: (changes, values before them) of the scene that is being loaded; loading may fail.
        self._next: tuple[dict[str, Any], dict[str, Any]] = {}, {}
        self._late: list[str] = []  # changes that are made once the scene is built

    def loading(self, state: mi.parser.ParserState, same: bool) -> None:
        """Make the changes again whose elements still exist."""
        changes = dict(self._changes) if same else {}
        self._next, self._late = (changes, self._own if same else {}), []
        for key in changes:
            try:
                ParameterChanges({key: changes[key]})(state)
            except EtendueError:  # the element is built already, or is gone
                self._late.append(key)

    def scene_loaded(self) -> None:
        """Take the parameters of the new scene, and make the late changes."""
        problem, asked = self.session.problem, self.session.asked
        self._editor, self._changes, self._own = None, {}, {}
        if problem is None or not is_described(asked.scene):
            return
        self._changes, self._own = self._next  # of this scene, since `loading` was called for it
        self._editor = editor = SceneEditor(problem.scene, fixed=not problem.space.is_own)
        for key in self._late:
            try:
                editor.set({key: self._changes[key]})
            except EtendueError as error:
                del self._changes[key]
                self.session.broadcast("note", text=f"the change of '{key}' is dropped: {error}")

    def state(self) -> dict[str, Any]:
        """The parameters, the changes, and the values before them."""
        found = [] if self._editor is None else [parameter.to_dict() for parameter in self._editor.list()]
        return {"parameters": found, "changes": self._changes, "own": self._own}

    def handle(self, verb: str, message: Mapping[str, Any], client: Client) -> None:
        """``set`` a value, ``reset`` one value or (without ``key``) all."""
        if self._editor is None:
            raise OptionError("a scene in memory is changed by mi.traverse; open its file to edit it here")
        if verb == "set":
            self._set({text(message, "key"): message.get("value")})
        elif verb == "reset":
            keys = [text(message, "key")] if "key" in message else list(self._changes)
            self._set({key: self._own[key] for key in keys if key in self._changes}, back=True)
        else:
            raise OptionError(f"there is no message 'parameters.{verb}'; there are set and reset")

    def _set(self, values: Mapping[str, Any], back: bool = False) -> None:
        assert self._editor is not None
        editor, before = self._editor, (dict(self._changes), dict(self._own))
        parameters = {key: editor.get(key) for key in values}
        textures = {key for key, parameter in parameters.items() if parameter.kind == "texture"}
        good = {key: value if back and key in textures else editor.check(key, value) for key, value in values.items()}
        if not textures:  # otherwise the scene is loaded again with all changes, or remains as it is
            editor.set(good)
        for key, value in good.items():
            self._own.setdefault(key, parameters[key].value)
            if back:
                self._changes.pop(key, None)
            else:
                self._changes[key] = value if textures else editor.get(key).value
        # The presets of metals hold both constants of the material: a file with one of them needs the other.
        for key in [] if back else list(values):
            for one, other in ((".eta.value", ".k.value"), (".k.value", ".eta.value")):
                if key.endswith(one) and (pair := key.removesuffix(one) + other) not in self._changes:
                    self._own[pair] = self._changes[pair] = editor.get(pair).value
        if textures:
            try:
                self.session.open(self.session.asked, keep_pose=True)
            except Exception:
                self._changes, self._own = before
                raise
        else:
            self.session.scene_edited()
        self.session.changed()

    def describe(self, state: mi.parser.ParserState) -> None:
        """Write the changes to the file."""
        ParameterChanges(self._changes)(state)

    def is_edited(self) -> bool:
        """Whether something was changed."""
        return bool(self._changes)

    def close(self) -> None:
        """Release the scene."""
        self._editor = None
