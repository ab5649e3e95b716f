"""Passes by an earlier state of the library, in a process of its own that is told what to do line by line.

Run as a script, this file is that process; it imports nothing but the package on its path.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


class Earlier:
    """The methods of the library in ``checkout`` on one scene: a file, or the name of a bundled scene."""

    def __init__(self, checkout: Path, variant: str, source: Any, size: tuple[int, int]) -> None:
        package = checkout / "src"
        if not (package / "etendue").is_dir():
            raise SystemExit(f"'{checkout}' is no checkout of the library: it has no folder src/etendue")
        self._process = subprocess.Popen(
            [sys.executable, __file__, variant, str(source), *map(str, size)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(package)},
        )

    def ask(self, *words: Any) -> float:
        """CPU seconds of what was asked for: ``begin``, ``pass`` or ``picture``, with a method and more."""
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(words) + "\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise SystemExit("the process of the earlier library has ended; what it says is above")
        return float(answer)

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def revision(checkout: Path) -> str:
    """The commit of a checkout."""
    asked = subprocess.run(["git", "-C", checkout, "rev-parse", "--short", "HEAD"], capture_output=True, text=True)
    return asked.stdout.strip() or str(checkout)


def _main(variant: str, source: str, width: int, height: int) -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the library prints is no answer
    from etendue import methods, scene
    from etendue.core import Replica, use_variant

    use_variant(variant)
    problem = scene.load(source, size=(width, height))
    runs: dict[str, list[Any]] = {}

    def begin(method: str, seed: int) -> Replica:
        kind = methods.get(method)
        estimator = kind(kind.Settings(max_depth=problem.max_depth))
        estimator.prepare(problem, seed)
        return Replica(estimator, seed)

    for line in sys.stdin:
        what, method, *more = json.loads(line)
        start = time.process_time()
        if what == "begin":
            seed, warm = more
            begin(method, warm).step(0)  # compiles
            start = time.process_time()
            runs[method] = [begin(method, seed), 0, None]
        elif what == "pass":
            replica, passes, total = runs[method]
            made = replica.step(passes)
            runs[method][1:] = passes + 1, made if total is None else total + made
        else:
            replica, _, total = runs[method]
            np.save(more[0], replica.develop(total).image)
        answers.write(f"{time.process_time() - start}\n")
        answers.flush()


if __name__ == "__main__":
    _main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
