"""Walks that end before the light does: in maps of irradiance, or in an ambient term."""
