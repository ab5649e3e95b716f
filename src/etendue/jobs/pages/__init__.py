"""Pages of solutions, and what results show of themselves in a notebook."""
