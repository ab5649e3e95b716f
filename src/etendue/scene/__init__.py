"""Room scene."""
