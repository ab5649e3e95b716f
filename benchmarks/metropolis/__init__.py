"""Pictures by Metropolis sampling beside independent paths."""
