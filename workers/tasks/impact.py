"""Impact force of a hand on a rigid body, and the speed at which a promised force is kept. Pure.

An arm stops in the servo tick that measures a contact, but within that tick the contact absorbs the hand's momentum:
effective mass times speed. Neither a lower threshold nor a softer arm can reduce this force; a lower speed can.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import causes
from rtc.protocol.messages import ScriptContext
from rtc.protocol.outcomes import RefusalReason, Refused, StopReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from workers.conditions.stop_conditions import Values
from workers.planning import axes
from workers.planning.motion.plan import Motion
from workers.planning.motion.timing import Timed, slower
from workers.planning.segments import Target
from workers.tasks.bind_task import BindTask, RuledTask

ASIDE = 0.02  # of a way back: how far it may lead aside (share of its length), and turn (rad)
WRIST_M = 0.12  # from the tool centre point back to the wrist: the hand and its flange are that long
CHECKED = 9  # times of a motion at which its impact is computed


class Impact(NamedTuple):
    """Impact of a motion with a promised force."""

    limit_n: float
    felt_n: float  # force (N) on a rigid body at the motion's speed
    safe_speed_m_s: float  # maximum speed that keeps the force within `limit_n`


class Promise(NamedTuple):
    """A force that a command promises for a contact."""

    limit_n: float
    faster: str  # what would allow more speed


class Keeping(NamedTuple):
    """How a motion keeps a promised force."""

    speed_m_s: float
    limit_n: float = math.inf  # what it keeps
    carried_kg: float = 0.0
    remark: str = ""  # for the result, if the force has reduced the speed, or is not kept


def promise_of(context: ScriptContext, values: Values) -> Promise | None:
    """The lowest force that the command promises for a contact; None without one.

    FORCE-LIMIT and UNLESS FORCE EXCEEDS name it. GUARDED promises the force limit of the step, which it has tightened.
    STIFFNESS expects a contact, and without a named force promises the same.
    """
    conditions = [reflex.condition for reflex in context.reflexes]
    named_n = [c.quantity.value for c in conditions if c.measure == "FORCE" and c.bound == "above" and c.quantity]
    if context.limits.force_n is not None:
        named_n.append(context.limits.force_n)
    promises = [Promise(limit_n, "a higher force allows more speed") for limit_n in named_n]
    step_n = values.get("force_n")
    if step_n is not None and context.guarded:
        promises.append(Promise(step_n, "without GUARDED it is faster"))
    if step_n is not None and context.limits.stiffness_n_m is not None and not promises:
        promises.append(Promise(step_n, "a FORCE-LIMIT above it allows more speed"))
    return min(promises, key=lambda promise: promise.limit_n, default=None)


def impact(
    arm: ArmModel,
    joints: Floats,
    way_m: Floats,
    carried_kg: float,
    contact_s: float,
    speed_m_s: float,
    limit_n: float,
    least_kg: float = 0.0,
) -> Impact | None:
    """Impact of the tcp moving by `way_m` (world frame, m) from `joints` (rad); None for a zero displacement.

    `least_kg`: effective mass counted at least. Where the wrist gives way, the force rises while the hand brakes.
    """
    way = np.asarray(way_m, dtype=float)
    length_m = float(np.linalg.norm(way))
    if length_m < 1e-6:
        return None
    mass_kg = max(least_kg, arm.effective_mass_kg(joints, way / length_m)) + carried_kg
    force_per_speed = mass_kg / contact_s  # N per m/s
    return Impact(limit_n, force_per_speed * speed_m_s, limit_n / force_per_speed)


def keeping(task: RuledTask, target: Target, *, touches: bool) -> Keeping:
    """The speed at which this motion keeps what the command promises, and meets what it is to meet well within the
    force limit of the step: the lowest one of these and of the speed in force.

    A path on which no touch is possible (not `touches`) is not slowed: there a force limit is a collision stop. Raises
    Refused if the slowest motion does not keep a promise.
    """
    keep, limit_n = _keeping_promise(task, target, touches=touches), _meeting_n(task)
    if limit_n >= keep.limit_n or (hit := _impact(task, target, keep.speed_m_s, limit_n)) is None:
        return keep
    slow_m_s = min(keep.speed_m_s, max(hit.safe_speed_m_s, task.values["slowest_m_s"]))
    return Keeping(slow_m_s, limit_n, _carried_kg(task), keep.remark)


def approach_m_s(task: RuledTask, axis: str, press_n: float) -> float:
    """Speed at which a hand that presses along `axis` with `press_n` meets what it presses on: blow and press together
    stay within the share of the force limit that a touch may take."""
    values = task.values
    fastest_m_s, blow_n = values["press_m_s"], values["met_share"] * values["force_n"] - press_n
    hit = _impact_along(task, axes.direction(task.query.tcp(task.arm), axis), fastest_m_s, blow_n)
    return min(fastest_m_s, max(hit.safe_speed_m_s, values["slowest_m_s"])) if hit else fastest_m_s


def _meeting_n(task: RuledTask) -> float:
    """The greatest force (N) with which this step is to meet something with what is in the hand; inf if it is not.

    A step with `touch_s` begins in contact."""
    expected = StopReason.CONTACT in task.data.step.expect and "touch_s" not in task.values
    return task.values["met_share"] * task.values["force_n"] if task.held and expected else math.inf


def _carried_kg(task: BindTask) -> float:
    load = task.query.load(task.arm) if task.held else None
    return load.mass_kg if load else 0.0


def _impact(task: RuledTask, target: Target, speed_m_s: float, limit_n: float) -> Impact | None:
    """Impact at the beginning of the way to `target`."""
    return _impact_along(task, _way_m(task, task.query.model.arms[task.arm], target), speed_m_s, limit_n)


def _impact_along(task: RuledTask, way_m: Floats, speed_m_s: float, limit_n: float) -> Impact | None:
    arm, joints, values = task.query.model.arms[task.arm], task.query.joints(task.arm), task.values
    return impact(arm, joints, way_m, _carried_kg(task), values["impact_s"], speed_m_s, limit_n, values["least_kg"])


def _keeping_promise(task: RuledTask, target: Target, *, touches: bool) -> Keeping:
    """How a motion keeps the force that the command promises."""
    values = task.values
    speed_m_s, promise = values["speed_m_s"], promise_of(task.data.context, values)
    if promise is None:
        return Keeping(speed_m_s)
    limit_n, carried_kg = promise.limit_n, _carried_kg(task)
    hit = _impact(task, target, speed_m_s, limit_n)
    if hit is None or hit.felt_n <= limit_n:
        return Keeping(speed_m_s, limit_n if touches else math.inf, carried_kg)
    felt = f"at {speed_m_s * 1e3:.3g} mm/s the first millisecond on a rigid body is felt with {hit.felt_n:.0f} N"
    if not touches:
        return Keeping(speed_m_s, remark=f"{limit_n:g} N is a collision stop on this free way: {felt}")
    slowest_m_s = values["slowest_m_s"]
    if hit.safe_speed_m_s * values["kept_factor"] < slowest_m_s:
        raise _refused(task, limit_n, slowest_m_s, limit_n * slowest_m_s / hit.safe_speed_m_s)
    slow_m_s = max(hit.safe_speed_m_s, slowest_m_s)
    most = f"{limit_n:g} N is kept up to {hit.safe_speed_m_s * 1e3:.3g} mm/s; {promise.faster}"
    return Keeping(slow_m_s, limit_n, carried_kg, f"slowed to {slow_m_s * 1e3:.3g} mm/s: {felt}; {most}")


def kept(task: RuledTask, motion: Motion, keep: Keeping) -> Motion:
    """The motion, slowed further if the effective mass grows along it."""
    if keep.limit_n == math.inf:
        return motion
    arms, least_kg = task.query.model.arms, task.values["least_kg"]
    momenta = _momenta(arms[task.arm], motion.timed, keep.carried_kg, least_kg)
    if motion.partner is not None:
        momenta = momenta + _momenta(arms[task.data.context.partner], motion.partner, 0.0, least_kg)
    excess = float(momenta.max()) / task.values["impact_s"] / keep.limit_n
    if excess <= 1.0:
        return motion
    partner = slower(motion.partner, excess) if motion.partner is not None else None
    return replace(motion, timed=slower(motion.timed, excess), partner=partner)


def goes_back(task: BindTask, space: str, target: Target) -> bool:
    """Whether the hand goes back in a straight line against its approach direction, no farther than its own wrist."""
    if space != "move_task" or target.pose is None:
        return False
    here = task.query.tcp(task.arm)
    x, y, z = geometry.relative(here, target.pose)[:3].tolist()
    straight = math.hypot(x, y) < ASIDE * -z and geometry.angle(here, target.pose) < ASIDE
    return straight and -z <= WRIST_M


def _way_m(task: BindTask, arm: ArmModel, target: Target) -> list[float]:
    """The displacement of the tcp (world frame, m); of a curve the direction in which it begins."""
    goal: Floats = arm.fk(target.joints or task.query.joints(task.arm)) if target.pose is None else target.pose
    if target.poses is not None:
        goal = target.poses[1]
    return [there - here for there, here in zip(goal[:3], task.query.tcp(task.arm)[:3], strict=True)]


def _momenta(arm: ArmModel, timed: Timed, carried_kg: float, least_kg: float) -> Array:
    """Momentum (N.s) of the tcp and of what it carries, at `CHECKED` times."""
    found = []
    positions, velocities, _ = timed.sampled()
    for n in np.linspace(0, len(positions) - 1, CHECKED).round().astype(int):
        q, v = positions[n], velocities[n]
        rate = arm.jacobian(q)[:3] @ v
        speed = float(np.linalg.norm(rate))
        own_kg = arm.effective_mass_kg(q, rate / speed) if speed > 0.0 else 0.0
        found.append((max(least_kg, own_kg) + carried_kg) * speed)
    return np.array(found)


def _refused(task: BindTask, limit_n: float, slowest_m_s: float, felt_n: float) -> Refused:
    least_n = math.ceil(felt_n)
    return Refused.because(
        RefusalReason.INFEASIBLE,
        f"{limit_n:g} N cannot be kept: a rigid body is felt with {felt_n:.2g} N at {1e3 * slowest_m_s:g} mm/s",
        clears=f"a force of at least {least_n} N",
        cause=causes.ForceExceeded(limit_n=limit_n, value_n=felt_n, arm=task.arm),
    )
