"""Kernels of density estimation: normalised, positive, and falling off."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from etendue.density import KERNELS


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_integrates_to_pi_over_the_unit_disc(name):
    n = 4096
    radius = (np.arange(n) + 0.5) / n
    values = np.broadcast_to(np.array(KERNELS[name](mi.Float(radius**2)), float), n)
    assert np.sum(values * 2.0 * np.pi * radius) / n == pytest.approx(np.pi, rel=1e-5)
    assert (values >= 0.0).all()
    assert (np.diff(values) <= 1e-6).all()
