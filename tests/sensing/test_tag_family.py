"""The patterns of the family 36h11, read back by the detector."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.cells import tag_family
from rtc.sensing.detector import TagDetector

PER_CELL, PER_ROW = 5, 25
PITCH = PER_CELL * (tag_family.WHOLE + 2)


def sheet(tags: range) -> np.ndarray:
    """A white picture with these tags in rows."""
    rows = -(-len(tags) // PER_ROW)
    image = np.full((rows * PITCH, PER_ROW * PITCH), 255, np.uint8)
    for n, tag in enumerate(tags):
        y, x = divmod(n, PER_ROW)
        cells = np.kron(tag_family.cells(tag), np.ones((PER_CELL, PER_CELL)))
        image[y * PITCH :, x * PITCH :][: cells.shape[0], : cells.shape[1]] = 255 * cells
    return image


def test_every_tag_is_read_where_it_is() -> None:
    tags = range(tag_family.COUNT)
    found = {mark.tag: mark.corners for mark in TagDetector().find(sheet(tags))}
    assert found.keys() == set(tags)
    for tag, corners in found.items():
        y, x = divmod(tag, PER_ROW)
        left, top = x * PITCH + PER_CELL, y * PITCH + PER_CELL
        right, bottom = left + PER_CELL * tag_family.BLACK, top + PER_CELL * tag_family.BLACK
        assert np.allclose(corners, [(left, bottom), (right, bottom), (right, top), (left, top)], atol=0.5), tag


def test_a_tag_that_appears_twice_is_left_out() -> None:
    twice = np.vstack([sheet(range(3)), sheet(range(1, 2))])
    assert {mark.tag for mark in TagDetector().find(twice)} == {0, 2}


def test_an_id_outside_of_the_family_is_an_error() -> None:
    with pytest.raises(IndexError):
        tag_family.cells(tag_family.COUNT)
