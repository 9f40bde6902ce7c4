"""What installed packages add, by the groups of their entry points. `docs/plugins.md` has a section for each group.

A package that cannot be loaded is not used, and stops no process: what it would add is unknown then. `rtc doctor` names
it with the error.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any, NamedTuple

CONTROL_LAWS = "rtc.control_laws"
REPORT_ITEMS = "rtc.report_items"
PLANNERS = "rtc.planners"
IK = "rtc.ik"
TIMING = "rtc.timing"
GRASP_PLANNERS = "rtc.grasp_planners"
EVALUATORS = "rtc.evaluators"
TRIMMERS = "rtc.trimmers"
SENSORS = "rtc.sensors"
PHASES = "rtc.phases"
GROUPS = (CONTROL_LAWS, REPORT_ITEMS, PLANNERS, IK, TIMING, GRASP_PLANNERS, EVALUATORS, TRIMMERS, SENSORS, PHASES)


class Loaded(NamedTuple):
    found: Mapping[str, Any]  # by name, in the order of the names
    failed: Mapping[str, str]  # name -> why it cannot be loaded


@functools.cache
def loaded(group: str) -> Loaded:
    """All entry points of a group. Each is imported once in a process."""
    found: dict[str, Any] = {}
    failed: dict[str, str] = {}
    for entry in sorted(entry_points(group=group), key=lambda one: one.name):
        try:
            found[entry.name] = entry.load()
        except Exception as error:  # code of others
            failed[entry.name] = f"{entry.value}: {type(error).__name__}: {error}"
    return Loaded(found, failed)


def names(group: str) -> set[str]:
    """The names of the group, without an import of their packages."""
    return {entry.name for entry in entry_points(group=group)}


def installed(group: str) -> Mapping[str, Any]:
    """What the group offers, by name."""
    return loaded(group).found
