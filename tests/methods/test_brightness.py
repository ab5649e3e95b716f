"""The mean luminance of pictures by chains against Mitsuba's own ``path``, on scenes of the agreement table, which has
all of them at a lower precision."""

from __future__ import annotations

import itertools

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_images, replicas

from etendue.film import LUMINANCE

CHAINS = {
    "pssmlt": ("pssmlt", {}),
    "pssmlt bidirectional": ("pssmlt", {"estimator": "bidirectional"}),
    "mmlt": ("mmlt", {}),
}
#: Without those that have light which neither finds, from points by mirrors and glass on both ends; one in five, which
#: turns through the groups.
SCENES = [
    (emitter, group)
    for emitter, group in itertools.product(scenes.EMITTERS, scenes.GROUPS)
    if group != "specular" or emitter not in scenes.DELTA_EMITTERS
][::5]


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES, ids=" ".join)
def test_mean_luminance_over_twenty_seeds(scene: tuple[str, str]) -> None:
    """Within three standard errors, which are at most 1 %."""
    problem = scenes.room(*scene)
    integrator = mi.load_dict({"type": "volpath" if scene[1] == "transparent" else "path"})
    truth = _luminance(mitsuba_images(problem, integrator, passes=16, samples=2048, seed=77000))
    for name, (method, settings) in CHAINS.items():
        settings = settings | {"bootstrap": 1 << 14}
        found = _luminance(replicas(scenes.room(*scene), method, 20, 2, samples=256, seed=500, **settings))
        error, own = (x.std(ddof=1) / np.sqrt(len(x)) for x in (found, truth))
        assert error <= 0.01 * truth.mean(), name
        assert abs(found.mean() - truth.mean()) <= 3.0 * np.hypot(error, own), name


def _luminance(images: np.ndarray) -> np.ndarray:
    """Of each picture."""
    return images.mean(axis=(1, 2)) @ np.array(LUMINANCE)
