"""Changes of scenes: values of their parameters."""
