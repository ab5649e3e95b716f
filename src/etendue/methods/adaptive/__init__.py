"""Path tracing whose random numbers adapt: densities after VEGAS, and recursive stratification."""
