"""Limits of the values in a primitive. A larger value is an error of its unit."""

from __future__ import annotations

Vector = list[float]
MAX_S = 1e6  # maximum duration
MAX_FURTHER = 8  # conditions on the way of a motion, for one other motion
HEAVIEST_KG, FARTHEST_M, MAX_INERTIA_KG_M2 = 1000.0, 10.0, 1000.0  # of a load
