"""Maps: irradiance at points of the surfaces of a scene, from particles, solutions, photon maps and caches."""
