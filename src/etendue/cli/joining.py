"""`etendue join-factors`: the form factors of a city from those of its tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options as opt
from .console import error_console, note, say
from .patches import FactorFiles, Groups, Reciprocal, Repair, RowSums, Threshold


def join_factors(
    files: Annotated[
        list[Path],
        typer.Argument(help="Form factors of the rows of some patches (`form-factors --rows`).", metavar="FILE..."),
    ],
    output: FactorFiles = None,
    row_sums: RowSums = False,
    reciprocal: Reciprocal = False,
    repair: Repair = False,
    threshold: Threshold = 0.0,
    groups: Groups = False,
    debug: opt.Debug = False,
) -> int:
    """Join files of form factors, each with the rows of some of the patches, and correct and write them together."""
    from etendue.products.patches import FormFactorProduct

    from .lines import describe_factors

    product = FormFactorProduct(
        row_sums=row_sums or repair,
        reciprocal=reciprocal or repair,
        threshold=threshold,
        groups=groups,
        outputs=tuple(output or [Path("factors.npz")]),
    )
    product.check_files(False)
    factors, correction = product.joined(files)
    if correction is not None:
        note(error_console(), str(correction))
    describe_factors(factors, f"of {len(files)} files")
    say("\n".join(map(str, product.files)))
    return 0
