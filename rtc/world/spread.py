"""Pose uncertainty: arithmetic on spreads. Pure.

A spread is six half-widths [x y z roll pitch yaw] (m, rad), along and about the axes of the pose's own frame. The true
pose is within them. They are bounds, not standard deviations, so they add up. Angles are small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

Spread = Sequence[float]

EXACT: tuple[float, ...] = (0.0,) * 6
AXES = ("x", "y", "z", "roll", "pitch", "yaw")


def even(metres: float, radians: float) -> list[float]:
    """The same half-width along all axes, and about all axes."""
    return [metres] * 3 + [radians] * 3


def widened(spread: Spread, by: Spread) -> list[float]:
    return [a + b for a, b in zip(spread, by, strict=True)]


def narrowest(a: Spread, b: Spread) -> list[float]:
    """The narrower of two bounds that both hold, per axis."""
    return [min(pair) for pair in zip(a, b, strict=True)]


def exceeded(spread: Spread | None, within: Spread) -> list[str]:
    """The axes where a spread exceeds `within`, as text: "x 35 mm (4 mm needed)". None counts as exact."""
    known = spread or EXACT
    rows = zip(AXES, known, within, strict=True)
    return [f"{axis} {shown(n, axis)} ({shown(m, axis)} needed)" for axis, n, m in rows if n > m + 1e-12]


def shown(half_width: float, axis: str) -> str:
    return f"{half_width * 1e3:.3g} mm" if axis in AXES[:3] else f"{math.degrees(half_width):.2g} deg"


def in_words(spread: Spread | None) -> str:
    """Text for people: "x 2 y 0.5 z 35 mm, roll 0.5 pitch 0.5 yaw 1 deg"; equal values are merged; None gives ""."""
    if spread is None:
        return ""
    metres = _together(AXES[:3], [f"{1e3 * n:.3g}" for n in spread[:3]])
    angles = _together(AXES[3:], [f"{math.degrees(n):.2g}" for n in spread[3:]])
    return f"{metres} mm, {angles} deg"


def _together(names: Sequence[str], figures: list[str]) -> str:
    if len(set(figures)) == 1:
        return figures[0]
    return " ".join(f"{name} {figure}" for name, figure in zip(names, figures, strict=True))
