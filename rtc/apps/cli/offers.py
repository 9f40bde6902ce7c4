"""Completion of names: which names of the cell may follow the words typed so far. It does not know the grammar."""

from __future__ import annotations

from rtc.model.cells.cell import Cell
from rtc.spatial.axis_names import AXES

#: verbs of a hand: the name of a graspable object follows the verb or the hand
HANDLING = {
    *("GRASP", "APPROACH", "RELEASE", "LIFT", "PUSH", "PULL", "PLACE", "INSERT", "EXTRACT", "ALIGN"),
    *("CARRY", "HANDOFF"),
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
    "AFTER": "none",
    "TOGETHER-WITH": "none",
    "TRY": "none",
    "VIA": "cameras",
    "LOAD": "none",
}


class CellNames:
    """Call it with the words so far (in capitals); it returns the names that may come next."""

    def __init__(self, cell: Cell) -> None:
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
            "all": sorted({*cell.names(), *(p for points in self._points.values() for p in points)}),
        }

    def __call__(self, words: list[str]) -> list[str]:
        given = [word for word in words if word != "TEST"]
        if len(given) < 1:
            return self._kinds["all"]
        verb, last = given[0], given[-1]
        if last == "VIA" and verb not in LOOKING:
            return []
        if last in NAME_KIND_AFTER:
            return self._kinds[NAME_KIND_AFTER[last]]
        if last == "TO":
            return self._kinds["seats" if verb == "ALIGN" else "places"]
        if last in self._points:  # an object: one of its grasp points may follow
            return self._points[last]
        if last == "AT":
            return self._points.get(given[-2], []) if verb != "VERIFY" else self._kinds["arms"] + self._kinds["seats"]
        if verb in HANDLING and (len(given) == 1 or last in self._hands):
            return self._kinds["graspable"]
        if len(given) == 1 and verb in LOOKING:
            return self._kinds["objects" if verb == "VERIFY" else "tagged"]
        return self._kinds["all"]
