"""Viewer: a scene live in the browser."""
