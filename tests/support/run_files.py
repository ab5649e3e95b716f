"""The example of the manual's page on run files, in little, and a scene file for it and the other examples."""

from __future__ import annotations

import re
from pathlib import Path

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "run-files.md"
#: A glass ball over a floor, with the variable that the example sets.
SCENE = """<scene version="3.0.0">
    <default name="res" value="24"/>
    <integrator type="path"><integer name="max_depth" value="4"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,1,4" target="0,0.4,0" up="0,1,0"/></transform>
        <sampler type="independent"><integer name="sample_count" value="2"/></sampler>
        <film type="hdrfilm"><integer name="width" value="$res"/><integer name="height" value="18"/></film>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere"><bsdf type="dielectric"/></shape>
    <shape type="rectangle">
        <transform name="to_world"><rotate x="1" angle="-90"/><scale value="3"/><translate y="-1"/></transform>
    </shape>
</scene>
"""


def example(size: tuple[int, int], times: str) -> str:
    """The run file of the manual, for a picture of that size, saved at ``times``, as ``"0.1, 0.3"``."""
    found = re.search(r"^```toml\n(.*?)^```$", _PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert found is not None
    text, changed = re.subn(r"^size = .*$", f"size = {list(size)}", found[1], flags=re.MULTILINE)
    text, retimed = re.subn(r"^times = .*$", f"times = [{times}]", text, flags=re.MULTILINE)
    assert (changed, retimed) == (1, 1)
    return text
