"""Changes of scenes: values of their parameters, and lights that are added or removed."""
