"""Lightmaps and meshes with their texture coordinates."""
