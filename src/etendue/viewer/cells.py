"""The running cell of a notebook: running the cell again ends the viewer that it opened before."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple


class Cell(NamedTuple):
    """A cell and its run; both empty outside notebooks that name their cells."""

    cell: str = ""
    run: str = ""

    def is_again(self, before: Cell) -> bool:
        """Whether this is a later run of the same cell. Viewers that one run opens stay beside each other."""
        return bool(self.cell) and self.cell == before.cell and self.run != before.run


def running_cell() -> Cell:
    """The cell of the caller. Frontends such as JupyterLab send the id of a cell with each request to run it."""
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    parent: Any = getattr(getattr(shell, "kernel", None), "get_parent", dict)()
    try:
        header, metadata = parent["header"], parent["metadata"]
        return Cell(str(metadata.get("cellId") or ""), str(header["msg_id"]))
    except (KeyError, TypeError, AttributeError):  # a kernel of another kind
        return Cell()
