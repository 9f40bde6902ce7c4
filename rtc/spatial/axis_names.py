"""The axes that a sentence may name (`ALONG X`, `ALONG TOOL-Z`). Pure data."""

from __future__ import annotations

#: name -> (frame: tool or world, unit vector in that frame)
AXES: dict[str, tuple[str, tuple[float, float, float]]] = {
    "TOOL-X": ("tool", (1.0, 0.0, 0.0)),
    "TOOL-Y": ("tool", (0.0, 1.0, 0.0)),
    "TOOL-Z": ("tool", (0.0, 0.0, 1.0)),
    "X": ("world", (1.0, 0.0, 0.0)),
    "Y": ("world", (0.0, 1.0, 0.0)),
    "Z": ("world", (0.0, 0.0, 1.0)),
    "UP": ("world", (0.0, 0.0, 1.0)),
    "DOWN": ("world", (0.0, 0.0, -1.0)),
    "LEFT": ("world", (0.0, 1.0, 0.0)),
    "RIGHT": ("world", (0.0, -1.0, 0.0)),
    "FORWARD": ("world", (1.0, 0.0, 0.0)),
    "BACK": ("world", (-1.0, 0.0, 0.0)),
}
