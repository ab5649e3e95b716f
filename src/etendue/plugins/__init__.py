"""Room plugins."""
