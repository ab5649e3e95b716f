"""Free memory is what the machine says, unless the process may take less."""

from pathlib import Path

import pytest

from etendue.core import free_memory, memory


def test_free_memory_is_below_that_of_the_machine():
    lines = Path("/proc/meminfo")
    if not lines.is_file():
        pytest.skip("this system has no /proc/meminfo")
    total = 1024 * int(lines.read_text().splitlines()[0].split()[1])
    free = free_memory()
    assert free is not None
    assert 0 < free < total


def test_the_smaller_of_machine_and_control_group(monkeypatch):
    for machine, group, expected in ((5, None, 5), (5, 3, 3), (None, 4, 4), (None, None, None)):
        monkeypatch.setattr(memory, "_machine", lambda value=machine: value)
        monkeypatch.setattr(memory, "_control_group", lambda value=group: value)
        assert free_memory() == expected
