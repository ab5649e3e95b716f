"""Form factors, segments and solutions in files."""
