"""Access to the viewer: which requests the server answers, and its address."""
