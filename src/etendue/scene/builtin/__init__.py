"""The scenes that étendue brings along, built by code."""
