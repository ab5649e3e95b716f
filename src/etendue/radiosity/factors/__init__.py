"""Form factors: counted from lines, by local rays, and exact."""
