"""The version of étendue."""

from importlib import metadata

try:
    VERSION = metadata.version("etendue")
except metadata.PackageNotFoundError:  # run from a source tree
    VERSION = "unknown"
