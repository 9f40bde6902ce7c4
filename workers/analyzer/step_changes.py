"""What a report changes about arms, and about what they have touched. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace

from rtc.programs.schema import OutcomeClass
from rtc.protocol.messages import EndReport, HandStep, Limits, OperateStep, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.spatial.geometry import Floats
from workers.planning import scenes, segments
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask, Changes

NEAR_M = 0.03  # an arm at full speed rests at most this far from the place of a touch
THIN_M = 0.002  # fingers closer together than this hold nothing


def arm_changes(task: AnalyzeTask) -> Changes:
    """The facts of the arm of the step."""
    step = task.step
    commanded = isinstance(step, HandStep) and not (isinstance(step, OperateStep) and not step.operator_has)
    return _reported(task, task.report, task.evaluation.arm, hand_commanded=commanded)


def _reported(task: AnalyzeTask, report: EndReport, arm: str, *, hand_commanded: bool) -> Changes:
    """Joints and hand width as reported; suspect and unchanged, like what it holds, if the report has no joints.

    The width of a hand that has opened or closed without a command is suspect: the fingers may still move. A hand that
    was commanded also has the force with which it grips.
    """
    if not arm:
        return []  # a stated or observed fact moves no arm
    if len(report.joints) != len(task.query.cell.arm(arm).joints):
        changing = ("joints", "hand_width", "holding", *(["hand"] if task.query.cell.arm(arm).hands else []))
        return [
            WorldChange(key=f"{arm}.{attribute}", keep_value=True, validity=Validity.SUSPECT) for attribute in changing
        ]
    coupled = _coupled(task.query, report.hand, arm)
    width_m = max(0.0, report.hand_width_m)
    moves = not (hand_commanded or coupled) and abs(width_m - task.query.hand_width(arm)) > task.values["unforeseen_m"]
    force_n = report.hand_force_n if report.hand_force_n >= task.values["pressing_n"] else 0.0
    grip = [WorldChange(key=f"{arm}.hand_force", value=force_n)] if hand_commanded else []
    return [
        *coupled,
        *grip,
        WorldChange(key=f"{arm}.joints", value=list(report.joints)),
        WorldChange(key=f"{arm}.hand_width", value=width_m, validity=Validity.SUSPECT if moves else Validity.VALID),
    ]


def _coupled(query: WorldQuery, hand: str | None, arm: str) -> Changes:
    """The hand that the coupler of an arm reads, if that is another one than was believed, or believed in doubt."""
    key = f"{arm}.hand"
    if hand is None or (hand == query.hand(arm) and query.trusts(key)):
        return []
    return [WorldChange(key=key, value=hand)]


def partner_changes(task: AnalyzeTask) -> Changes:
    """The same for the second arm of a primitive; unchanged if nothing was started."""
    partner, report = task.context.partner, task.report
    if not partner or task.step.space != segments.BOTH:
        return []  # only one arm moves in this step, or a camera looks
    if report.partner is None and report.reason in (StopReason.REFUSED, StopReason.BLOCKED):
        return []
    second = report.partner or replace(report, joints=[])
    return _reported(task, second, partner, hand_commanded=False)


def pressed_on(task: AnalyzeTask) -> Changes:
    """A close step without an object that presses on something: objects near the hand become suspect.

    They may move with the hand, so their frames are not trusted.
    """
    evaluation, report = task.evaluation, task.report
    if evaluation.step.op != "close" or evaluation.context.object or evaluation.held:
        return []
    if report.hand_force_n < task.values["pressing_n"] or report.hand_width_m < THIN_M:
        return []
    query, names = task.query, [thing.name for thing in task.query.cell.objects]
    near = [n for n in names if query.off_hand_m(n, query.frame(n), report.tcp_pose) < task.values["in_hand_m"]]
    return [WorldChange(key=f"{name}.frame", keep_value=True, validity=Validity.SUSPECT) for name in near]


def touched_object_changes(task: AnalyzeTask, failure: OutcomeClass) -> Changes:
    """After a failure the touched object is suspect until it is sensed again (R151)."""
    thing = task.context.object
    if not thing or thing == task.evaluation.held or task.seen_as_believed:
        return []
    pressed = task.report.peak_force_n > task.values["touched_n"] or not task.query.seat(thing)
    if "object" in failure.suspect or ("if_touched" in failure.suspect and pressed):
        doubtful = ("frame", "grasp") if task.query.held_by(thing) else ("frame",)
        return [WorldChange(key=f"{thing}.{name}", keep_value=True, validity=Validity.SUSPECT) for name in doubtful]
    return []


def nearby_changes(task: AnalyzeTask) -> Changes:
    """The frames of the objects near the arms of the step where they stopped, as suspect (R151).

    A touch in a path that was planned free contradicts the world, and the report does not name the body."""
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


def target_changes(task: AnalyzeTask) -> Changes:
    """The seat may not be where it is believed to be: an object did not meet it as expected."""
    seat = task.context.target
    if not seat:
        return []
    return [WorldChange(key=f"{seat}.frame", value=task.query.seat_frame(seat).tolist(), validity=Validity.SUSPECT)]


def merged(changes: Changes) -> Changes:
    """One change per fact. A later change that only sets the validity keeps the value of an earlier one."""
    merged: dict[str, WorldChange] = {}
    for change in changes:
        earlier = merged.get(change.key)
        if change.keep_value and earlier is not None and not earlier.keep_value:
            change = replace(earlier, validity=change.validity)
        merged[change.key] = change
    return list(merged.values())
