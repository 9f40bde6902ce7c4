"""Objects that an arm may have touched where no touch was expected. Pure.

A touch in a path that was planned free contradicts the world. The report does not name the body. So every object that
the arm may reach from where it stopped is doubtful until it is sensed again (R151).
"""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace

from rtc.protocol.messages import Limits, Validity, WorldChange
from rtc.spatial.geometry import Floats
from workers.planning import scenes
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask

NEAR_M = 0.03  # an arm at full speed rests at most this far from the place of a touch


def doubtful(task: AnalyzeTask) -> list[WorldChange]:
    """The frames of the objects near the arms of the step where they stopped, as suspect."""
    partner, report = task.context.partner, task.report
    reports = {task.evaluation.arm: report, **({partner: report.partner} if partner else {})}
    joints = {name: one.joints for name, one in reports.items() if name and one is not None and one.joints}
    rest = {arm.name: task.query.joints(arm.name) for arm in task.query.cell.arms}
    near = dict.fromkeys(name for arm in joints for name in _near(task.query, arm, {**rest, **joints}))
    keys = [f"{name}.frame" for name in near if task.query.trusts(f"{name}.frame")]
    return [WorldChange(key=key, keep_value=True, validity=Validity.SUSPECT) for key in keys]


def _near(query: WorldQuery, arm: str, joints: dict[str, Floats]) -> Iterator[str]:
    """The free objects within `NEAR_M` and their own spread of an arm, or of what it holds."""
    free = {thing.name for thing in query.cell.objects if not thing.fixed and not query.held_by(thing.name)}
    scene = scenes.scene_of(query, arm, Limits())
    pose_tolerance_m = {name: NEAR_M + scene.pose_tolerance_m.get(name, 0.0) for name in free}
    ignore = list(scene.ignore)
    for _ in range(len(query.cell.objects) * (len(query.cell.objects) + 1)):
        here = replace(scene, pose_tolerance_m=pose_tolerance_m, clearance_m=0.0, near=(), ignore=ignore)
        hit = query.model.collision.check(joints, here)
        if hit is None:
            return
        pair = hit.body_a.split()[0], hit.body_b.split()[0]
        yield from (name for name in pair if name in free)
        ignore.append(pair)
