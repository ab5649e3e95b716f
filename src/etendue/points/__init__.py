"""Point sequences that fill the hypercube more evenly than independent numbers. Rendering is unknown here."""

from .owen import OwenSobolSource, sobol_2d

__all__ = ["OwenSobolSource", "sobol_2d"]
