"""Methods of lines that are prepared for one scene after another, and runs whose last pass was incomplete."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import cube

from etendue.engine import Budget, Runner
from etendue.radiosity import (
    ABuffer,
    CastingSettings,
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    LineCasting,
    Part,
    PartProblem,
)
from etendue.radiosity.problem import PatchProblem


@pytest.mark.parametrize(("given", "sizes"), [(0, (6, 24, 6)), (5, (5, 5, 5))])
def test_each_scene_has_passes_of_its_own_size(monkeypatch, given, sizes):
    """Unless a size was set."""
    monkeypatch.setattr(ABuffer, "piece", lambda engine, count: len(engine.patches))
    method = LineCasting(CastingSettings(lines=200, bundles_per_pass=given))
    for cells, size in zip((1, 2, 1), sizes, strict=True):
        method.prepare(PatchProblem(cube(cells)), 3)
        assert method.samples_per_iteration == method.settings.bundles_per_pass == size
        method.close()


@pytest.mark.parametrize(("most", "size"), [(None, 64), (5000, 64), (40, 3)])
def test_few_bundles_are_passes_enough_for_an_error(monkeypatch, most, size):
    """On a GPU, which casts hundreds of a small scene at once."""
    monkeypatch.setattr("etendue.radiosity.lines.abuffer.uses_cuda", lambda: True)
    method = LineCasting(CastingSettings(lines=200), most=most)
    method.prepare(PatchProblem(cube(1)), 3)
    assert method.samples_per_iteration == size
    method.close()


@pytest.mark.parametrize(("given", "sizes"), [(0, (16 * 2400, 1 << 14)), (5000, (5000, 5000))])
def test_each_scene_of_parts_has_lines_of_its_own_number(given, sizes):
    method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=given))
    for cells, size in zip((20, 2), sizes, strict=True):
        method.prepare(PartProblem(Part(cube(cells, emission=1.0, reflectance=0.5))), 3)
        assert method.samples_per_iteration == method.settings.lines == size


@pytest.mark.usefixtures("compiled_lines")
@pytest.mark.parametrize("replicates", [1, 2])
def test_bundles_that_a_pass_left_out_are_of_no_other_replicate(replicates):
    """Pass 2 has four bundles of eight, pass 3 casts four more: with one sequence those of pass 2, with two others,
    since they count for the other replicate."""
    settings = CastingSettings(lines=200, replicates=replicates)
    method = LineCasting(settings, most=20)
    method.prepare(PatchProblem(cube(1)), 3)
    begun = Runner(method, seed=3, budget=Budget(samples=20)).run()
    method.most = 40
    method.go_on(begun.measurement)
    result = Runner(method, seed=3, budget=Budget(samples=40), start=begun.measurement).run()
    left_out, own = (np.concatenate(list(method.engine.stream(n, first))) for n, first in ((4, 20), (8, 24)))
    method.close()
    assert method.bundles(result.measurement) == 40
    found = result.measurement.records["segments"][0, 3]
    np.testing.assert_array_equal(found[-len(own) :], own)
    rest = found[: -len(own)]
    # Lines of a bundle vary with its direction, by a few per cent in a cube.
    assert len(rest) == pytest.approx(len(left_out), rel=0.2)
    assert np.array_equal(rest, left_out) == (replicates == 1)
