"""Ways to sample the rays that lights emit, each in place of ``emit``, and even strata over light paths."""
