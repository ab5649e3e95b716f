"""A spectral variant in place of the session's, on the same device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mitsuba as mi


@contextmanager
def spectral_variant() -> Iterator[None]:
    backend, _, _ = mi.variant().partition("_")
    with mi.variant_context(f"{backend}_ad_spectral"):
        yield
