"""The parts of a page. ``assets/parts.html`` has a macro for each, by its ``kind``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from .figures import Figure
from .pyramid import PyramidView
from .tables import Column, FactTable


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Failure:
    """A method whose run has failed, and the reason."""

    kind: ClassVar[str] = "failure"
    name: str
    message: str


@dataclass(frozen=True)
class Figures:
    """Figures side by side."""

    kind: ClassVar[str] = "figures"
    figures: Sequence[Figure]
    failures: Sequence[Failure] = ()


@dataclass(frozen=True)
class Scale:
    """A scale of colours: a CSS gradient, and labels at equal distances."""

    kind: ClassVar[str] = "scale"
    gradient: str
    ticks: Sequence[str]


@dataclass(frozen=True)
class Measures:
    """Pictures, or other things with a name, as rows; measures as columns."""

    kind: ClassVar[str] = "measures"
    names: Sequence[str]
    columns: Sequence[Column]
    what: str = "picture"
    caption: str = ""


@dataclass(frozen=True)
class Facts:
    """Facts as rows, pictures as columns."""

    kind: ClassVar[str] = "facts"
    table: FactTable


@dataclass(frozen=True)
class Plot:
    """The same plot as SVG for wide and for narrow windows."""

    kind: ClassVar[str] = "plot"
    wide: str
    narrow: str


@dataclass(frozen=True)
class Pyramid:
    """The technique pyramid of a picture."""

    kind: ClassVar[str] = "pyramid"
    view: PyramidView


@dataclass(frozen=True)
class Command:
    """Text to be copied: a command, or a file."""

    kind: ClassVar[str] = "command"
    text: str
    about: str = ""


@dataclass(frozen=True)
class Folded:
    """Parts that a reader may open."""

    kind: ClassVar[str] = "folded"
    title: str
    parts: Sequence[Part]
    is_open: bool = False


Part = Text | Failure | Figures | Scale | Measures | Facts | Plot | Pyramid | Command | Folded


@dataclass(frozen=True)
class Section:
    """Parts under a heading."""

    heading: str
    parts: Sequence[Part]


@dataclass
class Page:
    """What the template ``report.html`` shows, from top to bottom. ``verdict``: text and whether it is strong.
    ``viewer``: data of the script, see :mod:`.stacks`; ``None`` for a page without pictures to explore."""

    title: str
    subtitle: str = ""
    verdict: Sequence[tuple[str, bool]] = ()
    failures: Sequence[Failure] = ()
    viewer: dict[str, Any] | None = None
    sections: list[Section] = field(default_factory=list)

    def add(self, heading: str, *parts: Part | None) -> None:
        """Add a section with the parts that are not ``None``; without such parts, no section."""
        if present := [part for part in parts if part is not None]:
            self.sections.append(Section(heading, present))
