"""Clusters: how far they scale, by the executors' own policies under a simulated clock, and the experiments of a thesis
on parallel tracing (Leeson, Trinity College Dublin, 2001)."""
