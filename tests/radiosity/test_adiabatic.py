"""Patches of reflectance 1, such as adiabatic walls: where their light can be absorbed, and where it cannot."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, cube, joined, opposite

import etendue
from etendue.core import EtendueError
from etendue.radiosity import (
    SOLVERS,
    STEFAN_BOLTZMANN,
    ABuffer,
    Patches,
    RadiosityError,
    RayScene,
    ambient_solution,
    breadth_first,
    exact_form_factors,
    form_factors,
    multipath_bundles,
    solve,
    thermal,
)


@pytest.mark.parametrize("solver", SOLVERS)
def test_heat_between_two_black_walls_by_way_of_adiabatic_ones(solver):
    """q = sigma (T_1^4 - T_2^4) (F_12 + (1 - F_12) / 2): half of what adiabatic walls reflect goes to either wall."""
    patches = cube(1)
    hot = thermal(patches, [400, 300, 0, 350, 200, 100], [1, 1, 0, 0, 0, 0])
    solution = solve(hot, exact_form_factors(patches), solver, tolerance=1e-10)
    q = STEFAN_BOLTZMANN * (400**4 - 300**4) * (1 + opposite(1, 1)) / 2
    np.testing.assert_allclose(solution.net_power[:, 0], [q, -q, 0, 0, 0, 0], rtol=1e-6, atol=1e-6 * q)


@pytest.mark.parametrize("options", [{}, {"solver": "jacobi"}, {"method": "multipath", "points": 1 << 17}])
def test_adiabatic_walls_in_a_run(options):
    patches = cube(1, reflectance=[0.2, 0.2, 1, 1, 1, 1], emission=[1, 0, 0, 0, 0, 0])
    solution = etendue.solve_radiosity(patches, **({"bundles": 512} if "points" not in options else {}), **options)
    exact = solve(patches, exact_form_factors(patches), "direct").radiosity
    assert abs(solution.solution.radiosity - exact).sum() < 0.02 * exact.sum()


def test_light_that_leaves_an_open_room_needs_no_absorber():
    vertices, faces = box((0, 0, 0), (1, 1, 1), 2, inward=True)
    patches = Patches(vertices, faces[:-4], reflectance=1.0, emission=np.r_[np.ones(4), np.zeros(16)])
    segments = ABuffer(patches).cast(256)
    for solution in (solve(patches, segments, "conjugate-gradient"), solve(patches, form_factors(segments), "direct")):
        assert solution.power["to_sky"].sum() == pytest.approx(1, rel=0.02)
        assert solution.power["absorbed"].sum() == 0
    assert multipath_bundles(ABuffer(patches), 256).to_sky.sum() == pytest.approx(1, rel=0.02)


def chamber(**properties):
    """A closed chamber of reflectance 1 in a room; its patches are the last six."""
    vertices, faces = joined(box((0, 0, 0), (3, 3, 3), inward=True), box((1, 1, 1), (2, 2, 2), inward=True))
    return Patches(vertices, faces, reflectance=np.repeat([0.5, 1.0], 6), **properties)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_closed_part_without_absorber_must_be_dark(solver):
    patches = chamber(emission=np.repeat([1.0, 0.0], 6))
    factors = form_factors(ABuffer(patches).cast(128), "pooled")
    solution = solve(patches, factors, solver)
    assert (solution.radiosity[:6] > 1).all() and not solution.radiosity[6:].any()
    lit = patches.with_properties(emission=np.repeat([1.0, 0.0, 2.0], [6, 4, 2]))
    with pytest.raises(RadiosityError, match=r"^patch 10 and 1 more send .*all reflectances are 1.*absorbed") as error:
        solve(lit, factors, solver)
    assert "\n" not in str(error.value)


def test_a_channel_of_its_own_is_refused():
    patches = chamber(emission=[[1.0, 1.0]] * 6 + [[0.0, 0.0]] * 6)
    segments = ABuffer(patches).cast(64)
    solve(patches, segments, "conjugate-gradient")
    with pytest.raises(RadiosityError, match="patch 11 sends light"):
        solve(patches.with_properties(emission=[[1.0, 1.0]] * 6 + [[0.0, 0.0]] * 5 + [[0.0, 1.0]]), segments)


def test_a_closed_room_without_absorber_is_refused_before_lines_are_cast():
    room = cube(2, reflectance=1.0, emission=1.0)
    for call in (
        lambda: etendue.solve_radiosity(room, bundles=20000),
        lambda: etendue.solve_radiosity(room, "multipath", points=1 << 40),
        lambda: ambient_solution(room),
        lambda: breadth_first(RayScene(room), 8),
    ):
        with pytest.raises(EtendueError) as error:
            call()
        assert "absorbed" in str(error.value) or "absorbs" in str(error.value) or "near to 1" in str(error.value)
