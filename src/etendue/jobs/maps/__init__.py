"""Maps of irradiance: made from particles, and written."""
