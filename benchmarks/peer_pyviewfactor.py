"""pyViewFactor on a mesh, run by ``benchmarks.view_factors`` with a Python that has it; étendue is not needed.

``python peer_pyviewfactor.py IN.npz OUT.npz`` prints one JSON object of CPU seconds.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import pyvista
from pyviewfactor import compute_viewfactor_matrix


def mesh(vertices: np.ndarray, faces: np.ndarray) -> pyvista.PolyData:
    return pyvista.PolyData(vertices, np.column_stack([np.full(len(faces), 4), faces]).ravel())


def factors(vertices: np.ndarray, faces: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """F_ij; the walls of a room stand before nothing."""
    matrix = compute_viewfactor_matrix(mesh(vertices, faces), obstacles=mesh(vertices, faces[~walls]))
    return matrix.T  # theirs is of j to i


def main(given: str, out: str) -> None:
    with np.load(given) as arrays:
        vertices, faces, walls = arrays["vertices"], arrays["faces"], arrays["walls"]
        radiosity, reflectance, emission = arrays["radiosity"], arrays["reflectance"], arrays["emission"]
    clock = [time.process_time()]
    some = np.r_[0:40, len(faces) - 18 : len(faces)]
    factors(vertices, faces[some], walls[some])  # compiles
    clock.append(time.process_time())
    matrix = factors(vertices, faces, walls)
    gathered = matrix @ radiosity
    clock.append(time.process_time())
    solved = emission
    while True:
        irradiance = matrix @ solved
        after = emission + reflectance * irradiance
        if np.abs(after - solved).max() <= 1e-4 * np.abs(after).max():
            break
        solved = after
    clock.append(time.process_time())
    np.savez(out, gathered=gathered, irradiance=irradiance)
    print(json.dumps(dict(zip(("first", "factors", "solution"), np.diff(clock).tolist(), strict=True))))


if __name__ == "__main__":
    main(*sys.argv[1:])
