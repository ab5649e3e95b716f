"""Commands that show and check what is there: installation, scenes, methods, point sets."""
