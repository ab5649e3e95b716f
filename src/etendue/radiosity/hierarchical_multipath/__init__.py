"""Hierarchical transmittance-based Multipath: parts of a scene in virtual boxes, copies of which share one preprocess
[Castro 2002, ch. 5]."""
