"""What installed packages add, by the groups of their entry points. `docs/plugins.md` has a section for each group.

A package that cannot be loaded is not used, and stops no process: what it would add is unknown then. `rtc doctor` names
it with the error.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple

from rtc.plugins import guard

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
FILLERS = "rtc.fillers"
MECHANISMS = "rtc.mechanisms"
#: group -> what one of it is called in messages
GROUPS = {
    CONTROL_LAWS: "control law",
    REPORT_ITEMS: "report item",
    PLANNERS: "planner",
    IK: "IK solver",
    TIMING: "timing",
    GRASP_PLANNERS: "grasp planner",
    EVALUATORS: "evaluator",
    TRIMMERS: "trimmer",
    SENSORS: "sensor",
    PHASES: "phase",
    FILLERS: "table filler",
    MECHANISMS: "mechanism",
}


#: of one call, where it is not `guard.LIMIT_S`. The arms wait for a control law in every tick.
LIMITS_S = {CONTROL_LAWS: 0.02}


LOAD_LIMIT_S = 60.0  # for the import of a package


class Loaded(NamedTuple):
    found: Mapping[str, Any]  # by name, in the order of the names
    failed: Mapping[str, str]  # name -> why it cannot be loaded


def guarded(group: str, name: str) -> AbstractContextManager[None]:
    """The guard round a use of this entry point; see `rtc.plugins.guard`."""
    return guard.guarded(f"{GROUPS[group]} {name}", _file(group, name), LIMITS_S.get(group, guard.LIMIT_S))


def _file(group: str, name: str) -> str:
    """The file of its module; before that is loaded, module:function."""
    value = next((entry.value for entry in _entries(group) if entry.name == name), "")
    return getattr(sys.modules.get(value.partition(":")[0]), "__file__", None) or value


@functools.cache
def _entries(group: str) -> Sequence[EntryPoint]:
    """In the order of their names. They are read from the disk once in a process."""
    return sorted(entry_points(group=group), key=lambda one: one.name)


def look_again() -> None:
    """Forget what was found: packages have been installed since."""
    _entries.cache_clear()
    loaded.cache_clear()


@functools.cache
def loaded(group: str) -> Loaded:
    """All entry points of a group. Each is imported once in a process."""
    found: dict[str, Any] = {}
    failed: dict[str, str] = {}
    for entry in _entries(group):
        try:
            with guard.guarded(f"import of {GROUPS[group]} {entry.name}", limit_s=LOAD_LIMIT_S):
                found[entry.name] = entry.load()
        except guard.PluginError as error:
            failed[entry.name] = f"{entry.value} {error.problem}"
    return Loaded(found, failed)


def names(group: str) -> set[str]:
    """The names of the group, without an import of their packages."""
    return {entry.name for entry in _entries(group)}


def installed(group: str) -> Mapping[str, Any]:
    """What the group offers, by name."""
    return loaded(group).found


def why_missing(group: str, name: str) -> str:
    """Why this name cannot be used: no package has it, or its package cannot be loaded. Empty: it can."""
    found, failed = loaded(group)
    return "" if name in found else failed.get(name, "no installed package has it")
