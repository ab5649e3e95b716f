"""Photon mapping: by a map of the nearest, progressive, and stochastic progressive."""
