"""Photon mapping: with the nearest photons of two maps, progressive, and stochastic progressive."""
