"""Whether a body rests, by what pictures show of its velocity: for the look that waits for it, and for the plan that
needs it. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

MOVES_M_S, MOVES_RAD_S = 0.002, 0.01  # a body that is faster is not there any more when the report is read


def speeds(velocity: Sequence[float] | None) -> tuple[float, float]:
    """m/s and rad/s; 0 if nothing has measured them."""
    return (math.hypot(*velocity[:3]), math.hypot(*velocity[3:])) if velocity is not None else (0.0, 0.0)


def moves(velocity: Sequence[float] | None) -> bool:
    metres, radians = speeds(velocity)
    return metres > MOVES_M_S or radians > MOVES_RAD_S
