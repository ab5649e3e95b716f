"""Particles: their codecs, and the experiments of a thesis on their compression (Leeson, Trinity College Dublin,
2001)."""
