"""Room display."""
