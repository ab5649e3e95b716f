"""The experiments of a thesis on global lines (Castro, UPC Barcelona, 2002) with lines at the level of the scene, made
again."""
