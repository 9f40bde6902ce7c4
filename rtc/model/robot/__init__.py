"""Robot models: forward and inverse kinematics, collision checks and trajectory bounds.

Computed from the URDF and SRDF texts of a cell. This package knows neither tasks nor the world database.
"""

import warnings
from functools import cache

KERNEL = 4  # version of the compiled code: as in `_boxes.cpp`


@cache
def compiled() -> bool:
    """Whether the compiled proof of `boxes` is installed. Without it coal alone decides on collisions."""
    try:
        from rtc.model.robot import _boxes
    except ImportError:  # it was installed without a compiler
        return False
    if getattr(_boxes, "VERSION", 1) == KERNEL:
        return True
    words = "the compiled collision checks are of another version and are not used; install rtc again: pip install -e ."
    warnings.warn(words, stacklevel=2)
    return False


def collision_checks(boxes: bool) -> str:
    """What decides on collisions, in words."""
    return "compiled boxes, then coal" if boxes else "coal alone, installed without a C++ compiler"
