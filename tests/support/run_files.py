"""The example of the manual's page on run files, in little."""

from __future__ import annotations

import re
from pathlib import Path

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "run-files.md"


def example(size: tuple[int, int], times: str) -> str:
    """The run file of the manual, for a picture of that size, saved at ``times``, as ``"0.1, 0.3"``."""
    found = re.search(r"^```toml\n(.*?)^```$", _PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert found is not None
    text, changed = re.subn(r"^size = .*$", f"size = {list(size)}", found[1], flags=re.MULTILINE)
    text, retimed = re.subn(r"^times = .*$", f"times = [{times}]", text, flags=re.MULTILINE)
    assert (changed, retimed) == (1, 1)
    return text
