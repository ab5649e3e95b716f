"""Hierarchical form factors by global lines, cast in spheres around groups of objects [Castro 2002, ch. 4]."""
