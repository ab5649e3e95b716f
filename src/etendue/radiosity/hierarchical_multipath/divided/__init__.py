"""Hierarchical multipath whose boxes live in several processes: what each has, and what they tell each other."""
