"""The bytes of one frame of poses: which sets it has, its times, then seven float32 for each body. Pure.

 0  uint32   number of the frame
 4  uint32   flags: 1 the first set is the truth of a simulator
 8  float64  when the arms were measured (CLOCK_MONOTONIC of the gateway's machine, s)
16  float64  when the frame was made (the same clock, s)
24  float32  the sets: as shown, as believed; each 7 per body
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence

TRUE = 1
HEADER = struct.Struct("<IIdd")


def pack(
    number: int,
    measured_at_s: float,
    made_at_s: float,
    shown: Sequence[float],
    believed: Sequence[float],
    *,
    true: bool,
) -> bytes:
    """One frame. The sets have equal lengths."""
    values = array("f", shown)
    values.extend(believed)
    return HEADER.pack(number & 0xFFFFFFFF, TRUE if true else 0, measured_at_s, made_at_s) + values.tobytes()
