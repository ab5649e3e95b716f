"""Trees of boxes for ray casting: they are never deeper than the stacks of the compiled loops."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import cube, square

from etendue.radiosity import Part, Patches, RadiosityError, joined
from etendue.radiosity.hierarchical_multipath import casting, rays
from etendue.radiosity.hierarchical_multipath.firstshot import FirstShots
from etendue.radiosity.hierarchical_multipath.lists import PartRays
from etendue.radiosity.hierarchical_multipath.parts import Tree


def depths(links):
    """Depth of each node."""
    found = np.zeros(len(links), int)
    for node in np.flatnonzero((links[:, 1] == 0) & (links[:, 0] > 0)):  # a parent is before its children
        found[[node + 1, links[node, 0]]] = found[node] + 1
    return found


def test_sheets_ever_closer_to_each_other_fit_on_the_stack():
    """Each split takes one sheet away, so that a tree of 200 sheets would have a depth of nearly as many."""
    sheets = joined(*(square((20.0**-k, 0, 0), (0, 1, 0), (0, 0, 1)) for k in range(200)))
    made = PartRays(Part(Patches(*sheets, reflectance=0.5)))
    depth = depths(made.links)
    assert made.depth == depth.max() == casting._DEPTH - 1
    leaves = made.links[made.links[:, 1] > 0]
    assert leaves[:, 1].sum() == 200 and leaves[:, 1].max() > 4
    assert np.array_equal(np.sort(made.order), np.arange(200))
    assert PartRays(Part(cube(3))).depth < 10


def test_boxes_too_deep_inside_each_other_are_refused(monkeypatch):
    """Each needs more room on the stack of a ray than the one around it."""
    small = np.diag([0.1, 0.1, 0.1, 1.0])
    small[:3, 3] = 0.45
    part = Part(cube(3, emission=1.0, reflectance=0.5))
    for _ in range(4):
        part = Part(cube(3, reflectance=0.5), [(part, small)])
    parts = {inner: PartRays(inner) for inner in part.distinct}
    FirstShots(Tree(part), parts)
    monkeypatch.setattr(rays, "STACK", 8)
    with pytest.raises(RadiosityError, match="too many boxes of parts are inside each other") as error:
        FirstShots(Tree(part), parts)
    assert "\n" not in str(error.value)
