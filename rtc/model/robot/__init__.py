"""Robot models: forward and inverse kinematics, collision checks and trajectory bounds.

Computed from the URDF and SRDF texts of a cell. This package knows neither tasks nor the world database.
"""

from importlib.util import find_spec


def compiled() -> bool:
    """Whether the compiled proof of `boxes` is installed. Without it coal alone decides on collisions."""
    return find_spec(f"{__name__}._boxes") is not None


def collision_checks(boxes: bool) -> str:
    """What decides on collisions, in words."""
    return "compiled boxes, then coal" if boxes else "coal alone, installed without a C++ compiler"
