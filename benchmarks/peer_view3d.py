"""View3D, asked for with ``--view3d``, its program (https://github.com/jasondegraw/View3D).

Build it by ``cmake -DCMAKE_BUILD_TYPE=Release -DCMAKE_C_FLAGS=-fcommon``: plain ``make`` does not optimise, and its
program takes more than twice the time.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from etendue.formats import read_view3d

Program = Annotated[str | None, typer.Option("--view3d", help="The program of View3D.", metavar="PROGRAM")]
HOW = "View3D: --view3d was not given; how to build it stands in benchmarks/peer_view3d.py"


def run(program: str, path: Path) -> tuple[float, np.ndarray]:
    """CPU seconds, and the matrix (n, n) of form factors of a file of View3D; their text has six decimals."""
    with tempfile.TemporaryDirectory(prefix="view3d-") as folder:
        out = Path(folder) / "factors.txt"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        found = shutil.which(program) or os.path.abspath(program)
        subprocess.run([found, str(path.resolve()), out.name], check=True, capture_output=True, cwd=folder)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
        return seconds, read_view3d(out).matrix
