"""Room density."""
