"""The bundled scenes, built by code."""
