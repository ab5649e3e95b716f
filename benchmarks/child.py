"""What must be measured in a fresh process: the first pass, and peak memory. Run by the other modules.

``python -m benchmarks.child COMMAND JSON`` prints one JSON object.
"""

from __future__ import annotations

import itertools
import json
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

_START = time.perf_counter()


def _peak() -> float:
    """Largest resident memory of this process so far, in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)


def _open(options: dict[str, Any]) -> tuple[Any, dict[str, float]]:
    """A replica of the prepared method, and the seconds of each step on the way."""
    from etendue import methods, scene
    from etendue.core import Replica, use_variant

    use_variant(options["variant"])
    clock = [time.perf_counter()]
    problem = scene.load(options["scene"], size=tuple(options["size"]), memory=options.get("memory"))
    clock.append(time.perf_counter())
    loaded = _peak()
    method = methods.get(options["method"])
    estimator = method(method.Settings(**options["settings"]))
    estimator.prepare(problem, 0)
    clock.append(time.perf_counter())
    seconds = {"import": clock[0] - _START, "load": clock[1] - clock[0], "prepare": clock[2] - clock[1]}
    return Replica(estimator, 0), seconds | {"loaded_bytes": loaded}


def first_pass(options: dict[str, Any]) -> dict[str, Any]:
    """Seconds of the first pass and of those after it, and how many kernels the later ones compiled."""
    import drjit as dr

    replica, outcome = _open(options)
    seconds = []
    for iteration in range(options["passes"]):
        start = time.perf_counter()
        replica.step(iteration)
        seconds.append(time.perf_counter() - start)
    # Two passes more, with the history on, as it costs time: the kernels that are not found in memory.
    dr.kernel_history_clear()
    new = launched = 0
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for iteration in range(options["passes"], options["passes"] + 2):
            replica.step(iteration)
        for kernel in dr.kernel_history():
            if kernel["type"] == dr.KernelType.JIT:
                launched += 1
                new += not kernel["cache_hit"]
    return outcome | {"passes": seconds, "compiled": new, "launched": launched}


def memory(options: dict[str, Any]) -> dict[str, Any]:
    """Peak resident memory after each pass."""
    replica, outcome = _open(options)
    peaks = []
    total = None
    for iteration in range(options["passes"]):
        measured = replica.step(iteration)
        total = measured if total is None else total + measured
        peaks.append(_peak())
    return outcome | {"peaks": peaks}


def compiled(options: dict[str, Any]) -> dict[str, Any]:
    """Seconds of compiling, and CPU seconds of passes in turn, without and with a setting of LLVM. A method, or
    Mitsuba's ``path``."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    from etendue import methods, scene
    from etendue.core import Replica, use_variant
    from etendue.core.kernels import optimise_kernels, use_gathers

    use_variant(options["variant"])
    choose = {"gathers": use_gathers, "optimised": optimise_kernels}[options["what"]]
    problem = scene.load(options["scene"], size=tuple(options["size"]))

    def of_mitsuba(number: int) -> Any:
        return np.array(mi.render(problem.scene, sensor=problem.sensor, integrator=own, spp=1, seed=number))

    own = mi.load_dict({"type": "path", "max_depth": 10})
    compiled, tasks = [], list[Callable[[int], Any]]()
    for wanted in (False, True):
        dr.kernel_history_clear()
        choose(wanted)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            if options["method"]:
                method = methods.get(options["method"])
                estimator = method(method.Settings(**options["settings"]))
                estimator.prepare(problem, 0)
                replica = Replica(estimator, 0)
                tasks.append(lambda number, replica=replica: replica.step(number).mean())
            else:
                tasks.append(of_mitsuba)
            tasks[-1](0)
            kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
        compiled.append(sum(kernel["backend_time"] for kernel in kernels if not kernel["cache_hit"]) / 1e3)
    passes: tuple[list[float], list[float]] = ([], [])
    differ = 0.0
    for number in range(1, options["rounds"] + 1):
        pictures = []
        for wanted in (False, True):
            choose(wanted)
            begin = time.process_time()
            pictures.append(tasks[wanted](number))
            passes[wanted].append(time.process_time() - begin)
        differ = max(differ, float(np.abs(pictures[0] - pictures[1]).max() / np.abs(pictures[0]).max()))
    return {"compiled": compiled, "passes": passes, "differ": differ}


def scale(options: dict[str, Any]) -> dict[str, Any]:
    """CPU seconds to load a scene and of passes of a method, or of Mitsuba's ``path``, and peak memory; no kernel is
    cached."""
    import os
    import tempfile

    with tempfile.TemporaryDirectory(prefix="kernels-") as cache:
        os.environ["DRJIT_CACHE_DIR"] = cache
        import drjit as dr
        import mitsuba as mi

        clock = [time.process_time()]
        if options["method"]:
            replica, _ = _open(options)

            def step(number: int) -> None:
                replica.step(number)
        else:
            mi.set_variant(options["variant"])
            scene, integrator = mi.load_file(options["scene"]), mi.load_dict({"type": "path"})

            def step(number: int) -> None:
                dr.eval(mi.render(scene, integrator=integrator, spp=options["spp"], seed=number))

        clock.append(time.process_time())
        for number in range(options["passes"]):
            step(number)
            dr.sync_thread()
            clock.append(time.process_time())
    load, *passes = (after - before for before, after in itertools.pairwise(clock))
    return {"load": load, "first": passes[0], "passes": passes, "bytes": _peak()}


def picture(options: dict[str, Any]) -> dict[str, Any]:
    """A picture after some seconds, written to ``out``; its samples, and what ``auto`` chose."""
    import numpy as np

    from etendue import render
    from etendue.core import use_variant

    use_variant(options["variant"])
    wanted = {name: options[name] for name in ("seconds", "seed", "choice") if name in options}
    rendering = render(options["scene"], options["method"], size=tuple(options["size"]), **wanted)
    np.save(options["out"], rendering.image)
    return {"samples": rendering.metadata["samples"], "chosen": rendering.metadata.get("chosen", options["method"])}


def view_factors(options: dict[str, Any]) -> dict[str, Any]:
    """CPU seconds of a first call, of global lines or integrals (to a ``tolerance``) with F J, and of a solution; those
    are written to ``out``."""
    import numpy as np

    from etendue.radiosity import ABuffer, exact_form_factors, solve

    from .exchanges import room, smooth_radiosity

    clock, tolerance = [time.process_time()], options.get("tolerance")
    for cells, bundles in ((4, 1), (options["cells"], options["bundles"])):
        patches = room(cells)
        if tolerance:
            factors = exact_form_factors(patches, tolerance)
            gathered = factors.matrix @ smooth_radiosity(patches.centres)
        else:
            factors = ABuffer(patches, lines=options["lines"]).cast(bundles)
            gathered = factors.gather(smooth_radiosity(patches.centres))
        if bundles == 1:
            solve(patches, factors, "conjugate-gradient", tolerance=1e-4)
        clock.append(time.process_time())
    solution = solve(patches, factors, "conjugate-gradient", tolerance=1e-4)
    clock.append(time.process_time())
    np.savez(options["out"], gathered=gathered, irradiance=solution.irradiance[:, 0])
    return dict(zip(("first", "factors", "solution"), np.diff(clock).tolist(), strict=True))


if __name__ == "__main__":
    import etendue  # noqa: F401  # before Dr.Jit: it finds the LLVM

    COMMANDS = {
        "first-pass": first_pass,
        "memory": memory,
        "compiled": compiled,
        "scale": scale,
        "picture": picture,
        "view-factors": view_factors,
    }
    print(json.dumps(COMMANDS[sys.argv[1]](json.loads(sys.argv[2]))))
