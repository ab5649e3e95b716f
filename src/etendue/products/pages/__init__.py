"""Pages of solutions, and the display of results in notebooks."""
