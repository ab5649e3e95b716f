"""Hierarchical multipath with boxes in several processes: the data of each process, and their messages."""
