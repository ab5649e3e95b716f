"""The version of étendue; the build of the package reads it here."""

VERSION = "1.0.0"
