"""Maps of irradiance: their errors against particles, and what they cost."""
