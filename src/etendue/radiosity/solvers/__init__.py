"""Solutions of the radiosity system: solvers, first shot, multipath, particles."""
