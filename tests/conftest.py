"""What every test shares: the variant, the scenes, and a tidy Dr.Jit after each file."""

from __future__ import annotations

import gc
import importlib
import os
import pkgutil
import random
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import etendue
from etendue.core import choose_variant, set_threads, threads_for_files, use_variant

ROOT = Path(__file__).resolve().parent.parent
SCENES = ROOT.parent / "shared" / "scenes"
#: Folders whose tests make a scene each, and compile kernels for it.
WITH_SCENES = ("conformance", "docs", "examples", "methods", "plugins", "transport")


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--part k/n``: every n-th test from the k-th on, so that a long suite runs in parts; ``--order SEED``: for what
    one file leaves to the next ones."""
    parser.addoption("--part", metavar="K/N", help="run the k-th of n parts of the tests, which are about equally long")
    parser.addoption("--order", type=int, metavar="SEED", help="run the files in a random order")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keeps the tests of a part, and orders their files; skips tests marked ``gpu`` where CUDA is not usable."""
    if config.getoption("--part"):
        _keep_part(config, items)
    if (seed := config.getoption("--order")) is not None:
        files = sorted({item.path for item in items})
        random.Random(seed).shuffle(files)
        items.sort(key=lambda item: files.index(item.path))
    if not any(item.get_closest_marker("gpu") for item in items):
        return
    from etendue.core.backend import cuda_problem

    problem = cuda_problem()
    if problem is not None:
        for item in items:
            if item.get_closest_marker("gpu"):
                item.add_marker(pytest.mark.skip(reason=problem))


def _keep_part(config: pytest.Config, items: list[pytest.Item]) -> None:
    part = re.fullmatch(r"(\d+)/(\d+)", config.getoption("--part"))
    k, n = (int(part[1]), int(part[2])) if part else (0, 0)
    if not 1 <= k <= n:
        raise pytest.UsageError(f"--part takes k/n with 1 <= k <= n, such as 1/4, not '{config.getoption('--part')}'")
    kept = items[k - 1 :: n]
    config.hook.pytest_deselected(items=[item for i, item in enumerate(items) if i % n != k - 1])
    items[:] = kept


def _threads() -> int:
    """This worker's share of the cores: with two threads each, two workers on two cores took half as long again."""
    return max(1, (os.cpu_count() or 1) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Errors of commands that tests run are not the user's."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session", autouse=True)
def variant() -> str:
    """The Mitsuba variant of this session: ``$ETENDUE_TEST_VARIANT``, else ``llvm_ad_rgb``."""
    # LLVM takes half the time, and tests of rendering are mostly compiling.
    os.environ.setdefault("ETENDUE_OPTIMISE", "never")
    name = use_variant(choose_variant(os.environ.get("ETENDUE_TEST_VARIANT", "llvm_ad_rgb")))
    set_threads(_threads())
    # The tests and all modules stay: the collection of garbage after each test need not look at them again.
    for module in pkgutil.walk_packages(etendue.__path__, "etendue."):
        importlib.import_module(module.name)
    gc.collect()
    gc.freeze()
    return name


@pytest.fixture
def mitsuba_files() -> Iterator[None]:
    """For tests in which Mitsuba itself reads or writes files of OpenEXR: with one thread it would wait for ever."""
    with threads_for_files():
        yield


@pytest.fixture
def compiled_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines are cast by the compiled loops, in passes of their size, under a variant for a GPU, too."""
    for module in ("abuffer", "segments"):
        monkeypatch.setattr(f"etendue.radiosity.lines.{module}.uses_cuda", lambda: False)


@pytest.fixture(scope="module", autouse=True)
def _tidy_drjit(variant: str, request: pytest.FixtureRequest) -> Iterator[None]:
    """Give scenes, memory and kernels back after each file; kernels stay on disk, so nothing is compiled twice.

    A scene that stays alive is a part of later kernels: Dr.Jit compiles the shapes of all scenes there are.
    """
    yield
    import drjit as dr

    for value in vars(request.module).values():
        if hasattr(value, "cache_clear"):
            value.cache_clear()
    gc.collect()
    gc.freeze()  # what files leave behind stays, and would be looked at after every test of those that follow
    dr.sync_thread()
    dr.flush_kernel_cache()
    dr.flush_malloc_cache()
    dr.kernel_history_clear()
    set_threads(_threads())


@pytest.fixture(autouse=True)
def _forget_scenes(request: pytest.FixtureRequest) -> Iterator[None]:
    """One scene at a time: Dr.Jit compiles calls of shapes, and Mitsuba's integrators, for every object alive."""
    yield
    if request.path.parent.name in WITH_SCENES:
        gc.collect()


@pytest.fixture(scope="session")
def scenes_dir() -> Path:
    """The public test scenes, which are not part of the repository; the test is skipped where they are absent."""
    if not SCENES.is_dir():
        pytest.skip("the public scenes are not beside this checkout (../shared/scenes)")
    return SCENES
