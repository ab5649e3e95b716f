"""Scenes that nobody made for these tests: each renders with each method, without a NaN."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.running import run
from support.tables import RGB_SCENES, thinned

from etendue import methods
from etendue.scene import load

PUBLIC = ("cornell-box", "cbox-spheres", "veach-bidir", "water-caustic", "soda-shoppe")
#: Switches that the methods' defaults leave alone.
SWITCHES = {
    "bpt path": ("bpt", {"light_source": "path"}),
    "vcm pixel": ("vcm", {"radius": 2.0, "radius_unit": "pixel", "heuristic": "power", "merge_first": False}),
    "vcm counts": ("vcm", {"connections": 3, "next_events": 2, "light_paths": 0.5}),
}


def render(problem, method, samples=4, **settings):
    result = run(problem, method, passes=2, samples=samples, **settings)
    assert result.measurement.counters["nonfinite"] == 0
    assert np.isfinite(result.mean).all()
    assert result.mean.mean() > 0.0


#: Methods of every kind, each scene once or twice.
FAST = [
    *(("cornell-box", "auto"), ("cbox-spheres", "bpt"), ("cbox-spheres", "film_metropolis")),
    *(("veach-bidir", "sppm"), ("water-caustic", "pssmlt"), ("soda-shoppe", "vcm")),
]


@pytest.mark.parametrize(("name", "method"), thinned(itertools.product(PUBLIC, methods.table()), FAST))
def test_public_scenes(name, method, scenes_dir):
    render(load(scenes_dir / name / "scene.xml", size=(32, 32)), method)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "switch"), zip(RGB_SCENES, itertools.cycle(SWITCHES), strict=False))
def test_bundled_scenes_with_other_switches(name, switch):
    method, settings = SWITCHES[switch]
    # In `gaps` few paths find light.
    render(load(name, size=(32, 32)), method, samples=64 if name == "gaps" else 4, **settings)
