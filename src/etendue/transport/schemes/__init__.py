"""Ways to sample the rays that lights emit, as replacements of ``emit``, and stratification of light paths."""
