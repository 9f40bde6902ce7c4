"""The space that a motion may need: boxes that planners and the Decision Unit compare (decision 0071)."""

from __future__ import annotations

from collections.abc import Sequence

Box = tuple[int, int, int, int, int, int]  # low corner x y z, high corner x y z (mm, world)


def apart(boxes: Sequence[Box], others: Sequence[Box]) -> bool:
    """Whether no box touches any of the others. Nothing is apart from a space that is not known, which has no boxes."""
    if not boxes or not others:
        return False
    for x, y, z, x_end, y_end, z_end in boxes:
        for box in others:
            if x <= box[3] and box[0] <= x_end and y <= box[4] and box[1] <= y_end and z <= box[5] and box[2] <= z_end:
                return False
    return True
