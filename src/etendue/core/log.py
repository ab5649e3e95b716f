"""The logger of the library."""

from __future__ import annotations

import logging

logger = logging.getLogger("etendue")
logger.addHandler(logging.NullHandler())
