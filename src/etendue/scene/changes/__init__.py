"""Changes of scenes: values of their parameters, and corrections of their transforms."""
