"""Completion of names: which names of the cell may follow the words typed so far. It does not know the grammar."""

from __future__ import annotations

from collections.abc import Callable

from rtc.model.cells.cell import Cell
from rtc.spatial.axis_names import AXES

Listing = Callable[[], list[str]]

#: verbs of a hand: the name of a graspable object follows the verb or the hand
HANDLING = {
    *("GRASP", "APPROACH", "RELEASE", "LIFT", "PUSH", "PULL", "PLACE", "INSERT", "EXTRACT", "ALIGN"),
    *("CARRY", "HANDOFF", "MATE", "DEMATE"),
}
LOOKING = {"LOCATE", "TRACK", "VERIFY"}
#: last word typed -> kind of the names that may follow it
NAME_KIND_AFTER = {
    "ALONG": "axes",
    "ABOUT": "axes",
    "SAFE-WORK-RANGE": "regions",
    "AVOID-TASK-REGION": "regions",
    "POSE-DURING-MOTION": "attitudes",
    "ON": "seats",
    "INTO": "seats",
    "FROM": "seats",
    "THROUGH": "places",
    "TO-NEIGHBORHOOD-OF": "objects",
    "TO-GRASP-POINT-OF": "graspable",
    "ARM": "arms",
    "AFTER": "commands",
    "TOGETHER-WITH": "commands",
    "PAUSE": "commands",
    "RESUME": "commands",
    "ABORT": "commands",
    "HALT": "commands",
    "TRY": "none",
    "VIA": "cameras",
    "LOAD": "none",
}


class CellNames:
    """Call it with the words so far (in capitals); it returns the names that may come next.

    `places` and `commands` return those of the running cluster: taught places, numbers and labels of commands.
    """

    def __init__(self, cell: Cell, places: Listing = list, commands: Listing = list) -> None:
        self._places, self._commands = places, commands
        self._points = {thing.name: [point.name for point in thing.grasp_points] for thing in cell.objects}
        self._hands = {arm.end_effector for arm in cell.arms}
        self._kinds = {
            "axes": list(AXES),
            "regions": [region.name for region in cell.regions],
            "attitudes": list(cell.attitudes),
            "seats": [seat.name for seat in cell.seats],
            "places": [place.name for place in cell.places],
            "objects": list(self._points),
            "graspable": [name for name, points in self._points.items() if points],
            "arms": [name for arm in cell.arms for name in (arm.name, arm.end_effector)],
            "cameras": [camera.name for camera in cell.cameras],
            "tagged": list(dict.fromkeys(tag.body for tag in cell.tags)),
            "none": [],
            "commands": [],
            "all": sorted({*cell.names(), *(p for points in self._points.values() for p in points)}),
        }

    def __call__(self, words: list[str]) -> list[str]:
        """The names of the cell that may come next, and those of the running cluster."""
        kind = self._kind(words)
        if isinstance(kind, list):
            return kind
        live = {"commands": self._commands, "places": self._places, "all": self._places}.get(kind, list)
        return [*self._kinds[kind], *live()]

    def _kind(self, words: list[str]) -> str | list[str]:
        """The kind of the names, or the names."""
        given = [word for word in words if word != "TEST"]
        if len(given) < 1:
            return "all"
        verb, last = given[0], given[-1]
        if last == "VIA" and verb not in LOOKING:
            return []
        if last in NAME_KIND_AFTER:
            return NAME_KIND_AFTER[last]
        if last == "TO":
            return "seats" if verb in ("ALIGN", "MATE") else "places"
        if last in self._points:  # an object: one of its grasp points may follow
            return self._points[last]
        if last == "AT":
            return self._points.get(given[-2], []) if verb != "VERIFY" else self._kinds["arms"] + self._kinds["seats"]
        if verb in HANDLING and (len(given) == 1 or last in self._hands):
            return "graspable"
        if len(given) == 1 and verb in LOOKING:
            return "objects" if verb == "VERIFY" else "tagged"
        return "all"
