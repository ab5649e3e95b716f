"""Run files with their records, and comparisons of methods."""
