"""Ambient terms: solutions at once, the rest of solutions that stop early, and scenes in parts."""
