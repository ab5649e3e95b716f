"""Ambient terms: direct solutions, the remaining light of solutions that stop early, and scenes in parts."""
