"""Lights: power, light selection and point sampling, as tables that kernels read; their textures and places."""
