"""Sub-paths from both sides, joined by every technique and weighted against all others; with the stored vertices."""
