"""Pictures by Metropolis sampling: Markov chains over the random numbers of paths."""
