"""The errors of radiosity."""

from __future__ import annotations

from etendue.core import OptionError
from etendue.surfaces import Patches


class RadiosityError(OptionError):
    """Lines, form factors or a solution that cannot be computed as requested. The message is one line with the reason
    and a remedy."""


def check_no_period(patches: Patches, what: str) -> None:
    """Raise :class:`RadiosityError` if patches are repeated without end, for what would see one period alone."""
    if patches.period is not None:
        raise RadiosityError(
            f"{what} cannot repeat a periodic domain: cast lines (method lines), or leave out the period"
        )


def check_up(patches: Patches, up: str) -> None:
    """Raise :class:`RadiosityError` if the axis ``up`` is not that of a periodic domain."""
    if patches.period is not None and up != "z":
        raise RadiosityError(f"a periodic domain repeats along x and y, and z is up, not {up}: turn the mesh")
