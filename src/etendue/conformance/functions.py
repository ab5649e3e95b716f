"""Tests whether the values of a function of ``etendue.integration`` are in its declared range."""

from __future__ import annotations

import numpy as np

from etendue.integration import DeviceBackend, HostBackend, Integrand

from .report import Finding, Findings


def check_function(
    function: Integrand, component: str = "function", *, points: int = 65536, seed: int = 0
) -> list[Finding]:
    """Test an :class:`etendue.integration.Integrand` at random points of its domain and at the corners of its first
    twelve dimensions. The test ``range``: values are finite and within the declared range, up to rounding of 1e-5."""
    rng = np.random.default_rng([seed, 0xF0C7])
    findings = Findings(component)
    with findings.trying("interface"):
        dimension = function.dimension
        turned = min(dimension, 12)
        corners = np.zeros((dimension, 1 << turned))
        corners[:turned] = (np.arange(1 << turned) >> np.arange(turned)[:, None]) & 1
        unit = np.concatenate([rng.random((dimension, points)), corners], axis=1)
        backend = DeviceBackend(seed) if function.on == "device" else HostBackend(seed)
        x = backend.points(np.asarray(function.domain.from_unit(unit)))
        parts = [np.asarray(part, np.float64) for part in function.parts(function.evaluate(x))]
        values = np.concatenate([np.broadcast_to(part, unit.shape[1]) for part in parts])
        low, high = function.range
        finite = np.isfinite(values)
        slack = 1e-5 * max([abs(v) for v in (low, high) if np.isfinite(v)] + [1e-30])
        outside = ~finite | (values < low - slack) | (values > high + slack)
        least, most = (f(values[finite]) if finite.any() else np.nan for f in (np.min, np.max))
        findings.judge(
            "range",
            float(outside.mean()),
            0.0,
            f"share of points outside the range [{low:g}, {high:g}]; values are from {least:.4g} to {most:.4g}",
            f"{outside.sum()} of {len(values)} values are outside the declared range [{low:g}, {high:g}] or not finite "
            f"(from {least:.4g} to {most:.4g}), so functions composed of it are wrong; correct the function or "
            "the range",
        )
    return findings.rows
