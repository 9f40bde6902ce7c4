"""The AprilTag family 36h11: the pattern of each tag as cells. Pure but for its table, which is a file."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TABLE = Path(__file__).with_name("tag36h11.txt")
COUNT = 587  # number of tags; ids begin with 0
BITS = 6  # cells per row and column of the code
BLACK = 8  # cells along the black square, whose edge is the size of a tag
WHOLE = 10  # cells along the whole tag with its white border


def cells(tag: int) -> NDArray[np.bool_]:
    """The 10 x 10 cells of a tag, row by row from the upper left; true is white. IndexError for an unknown id."""
    if not 0 <= tag < COUNT:
        raise IndexError(f"the family 36h11 has the ids 0 to {COUNT - 1}, not {tag}")
    whole = np.ones((WHOLE, WHOLE), dtype=np.bool_)
    whole[1:-1, 1:-1] = False
    code = [_codes()[tag] >> shift & 1 for shift in reversed(range(BITS * BITS))]
    whole[2:-2, 2:-2] = np.array(code, dtype=np.bool_).reshape(BITS, BITS)
    return whole


@functools.cache
def _codes() -> list[int]:
    lines = TABLE.read_text(encoding="ascii").splitlines()
    return [int(word, 16) for line in lines if not line.startswith("#") for word in line.split()]
