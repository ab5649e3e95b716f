"""Path tracing with adaptive random numbers: learned densities (VEGAS), and recursive stratification."""
