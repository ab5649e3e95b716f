"""Commands that list and check: installation, scenes, methods, point sets."""
