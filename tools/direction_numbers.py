"""Write the direction numbers that étendue ships from the file of their authors.

python tools/direction_numbers.py new-joe-kuo-6.21201

The file is on https://web.maths.unsw.edu.au/~fkuo/sobol/; a line has the dimension from 2, the degree of its primitive
polynomial, the polynomial's inner coefficients as a number, and the initial numbers.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

TABLE = Path(__file__).resolve().parent.parent / "src" / "etendue" / "points" / "data" / "joe_kuo.npz"
DIMENSIONS = 2048


def main(source: Path, target: Path = TABLE) -> None:
    """Write the first :data:`DIMENSIONS` dimensions."""
    rows = [[int(word) for word in line.split()] for line in source.read_text().splitlines()[1:DIMENSIONS]]
    degrees = [row[1] for row in rows]
    polynomials = np.zeros(DIMENSIONS, np.uint16)  # dimension 1 of the file's count has none
    initial = np.zeros((max(degrees), DIMENSIONS), np.uint16)  # this way round it is packed best
    for row, degree in zip(rows, degrees, strict=True):
        number, inner = row[0] - 1, row[2]
        polynomials[number] = 1 << degree | inner << 1 | 1
        initial[:degree, number] = row[3:]
    np.savez_compressed(target, polynomials=polynomials, initial=initial)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
