"""Running a cell of a notebook again ends the viewer that it opened before, and no other."""

import asyncio
import gc
import sys
import threading
from types import ModuleType, SimpleNamespace

import pytest
from support.viewing import Page

from etendue.viewer import Asked, Viewer, opening
from etendue.viewer.cells import Cell, running_cell


@pytest.fixture
def run_cell(monkeypatch):
    """Sets the cell that is running, as a kernel tells it."""
    python = ModuleType("IPython")
    monkeypatch.setitem(sys.modules, "IPython", python)
    monkeypatch.setattr(opening, "_open", set())  # those of this test alone

    def run(cell, number):
        parent = {"header": {"msg_id": f"run {number}"}, "metadata": {"cellId": cell} if cell else {}}
        python.get_ipython = lambda: SimpleNamespace(kernel=SimpleNamespace(get_parent=lambda: parent))

    yield run
    for viewer in list(opening._open):
        viewer.close()


@pytest.fixture
def opened(monkeypatch):
    """Opens viewers whose scene is not there, so that nothing is loaded."""
    return lambda **options: Viewer(Asked(scene="nowhere"), **options)


def test_the_viewer_of_an_earlier_run_is_closed(run_cell, opened):
    run_cell("a", 1)
    first = opened()
    port = first._server.port

    async def visit():
        page = await Page.open(first.url)
        await page.until("state")
        run_cell("a", 2)
        made = await asyncio.to_thread(opened, port=port)  # the same port is free again
        while await page.next() is not None:
            pass
        return made, page.socket.close_code, page.socket.close_reason

    second, code, reason = asyncio.run(visit())
    assert (code, reason) == (1001, "this cell was run again")
    assert first.wait(0) and not second.wait(0) and not first._server._thread.is_alive()
    assert first._repr_html_() == "<p>The viewer has ended: this cell was run again.</p>"
    assert opening._open == {second}


def test_one_that_nobody_holds_is_closed_too(run_cell, opened):
    """As that of ``viewer = view(...)``, whose name has the new one before the old one could be found."""
    before = threading.active_count()
    for number in range(3):
        run_cell("a", number)
        opened()
        gc.collect()
    assert len(opening._open) == 1 and threading.active_count() <= before + 2


@pytest.mark.parametrize(("cell", "number"), [("a", 1), ("b", 2), ("", 2)])
def test_others_stay(run_cell, opened, cell, number):
    """Two viewers of one run; those of other cells; those of kernels that name no cells."""
    run_cell("a" if cell else "", 1)
    first = opened()
    run_cell(cell, number)
    second = opened()
    assert not first.wait(0) and opening._open == {first, second}


def test_outside_notebooks_there_is_no_cell(monkeypatch):
    assert running_cell() == Cell()
    for shell in (None, SimpleNamespace(), SimpleNamespace(kernel=SimpleNamespace(get_parent=lambda: {}))):
        python = ModuleType("IPython")
        python.get_ipython = lambda shell=shell: shell
        monkeypatch.setitem(sys.modules, "IPython", python)
        assert running_cell() == Cell() and not running_cell().is_again(Cell())
