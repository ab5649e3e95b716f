"""Markov chains over paths."""
