"""Metropolis particle tracing beside independent light paths, and ways to sample emission (Leeson's thesis, section
6.2.4 and figure 6.23, made again)."""
