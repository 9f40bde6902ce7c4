"""The control law of a step: position control, or a spring whose figures the step and its stop class state. Pure."""

from __future__ import annotations

from typing import Literal

from rtc.protocol import causes
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.primitive import Compliance, ControlLaw, ForceProfile, HandMotion, Load, Trajectory
from rtc.spatial.axis_names import AXES
from workers.conditions.stop_conditions import Values
from workers.planning import axes, suggestions
from workers.planning.step_target import axis_of
from workers.tasks import impact
from workers.tasks.bind_task import BindTask, RuledTask, refused_program


def control_law(task: RuledTask, trajectory: Trajectory, load: Load | None) -> ControlLaw:
    """M: the law of the stop class, or impedance if the command or the step names a stiffness. While only the hand
    moves, its arm complies if the step names one.

    `press_n` of the step is a force set-point along its axis, approached as slowly as its force limit demands.
    `centre_share` puts the centre of compliance between the tcp (0) and the centre of mass of the load (1). `spin_m`
    replaces `turn_m` about the axis of the step.

    Its spring pulls with a share of the force and torque limits, so a blocked arm leans on the obstacle within them.
    Raises Refused for impossible figures, and for those that would have no effect.
    """
    _refuse_press(task)
    _refuse_spring(task, load)
    stop_class, values = task.stop_class, task.values
    gains = {"wn": values["laden_wn_rad_s"]} if load else {}
    step, stiffness_n_m = task.data.step, values.get("stiffness_n_m")
    axis = axis_of(step)
    only_hand = isinstance(trajectory, HandMotion) and not step.complies
    if stiffness_n_m is None or stop_class.rigid or only_hand:
        return ControlLaw(name=stop_class.control_law, load=load, gains=gains)
    factor, share = values["spring_factor"], values.get("centre_share", 0.0)
    frame: Literal["tool", "world"] = "tool"
    wrench: list[float | None] = []
    profile: ForceProfile | None = None
    approach_m_s = values["press_m_s"]
    if "press_n" in values:
        owner, direction = AXES[axis]
        frame = "tool" if owner == "tool" else "world"
        most_n = max(values["press_n"], values.get("press_from_n", 0.0)) if "press_s" in values else values["press_n"]
        wrench = [most_n * n if n else None for n in direction] + [None] * 3
        profile = _press_profile(values, most_n)
        approach_m_s = impact.approach_m_s(task, axis, most_n)
    turning = [values["turn_m"] ** 2 * stiffness_n_m] * 3
    if "spin_m" in values:
        turning[_spin_axis(task)] = values["spin_m"] ** 2 * stiffness_n_m
    compliance = Compliance(
        stiffness=[stiffness_n_m] * 3 + turning,
        most_n=factor * values["force_n"],
        most_nm=factor * values["torque_nm"],
        frame=frame,
        centre=[share * x for x in load.com_m] if load and share else [],
        wrench=wrench,
        profile=profile,
        approach_m_s=approach_m_s,
    )
    return ControlLaw(name="impedance", load=load, gains=gains, compliance=compliance)


def _press_profile(values: Values, most_n: float) -> ForceProfile | None:
    """The press from `press_from_n` (0 without it) to `press_n` in `press_s`; None if it is constant."""
    if "press_s" not in values:
        return None
    shares = [values.get("press_from_n", 0.0) / most_n, values["press_n"] / most_n]
    return ForceProfile(time_s=[0.0, values["press_s"]], share=shares)


def _refuse_press(task: RuledTask) -> None:
    """Refuse a force set-point that would have no effect, or would trip the step's own force limit."""
    values = task.values
    if "press_n" not in values:
        alone = [name for name in ("press_s", "press_from_n") if name in values]
        if alone:
            raise refused_program(f"{alone[0]} needs press_n", "the force at the end of the press")
        return
    axis = axis_of(task.data.step)
    if axis not in AXES:
        raise suggestions.unknown("axis", axis, AXES)
    if "stiffness_n_m" not in values or task.stop_class.rigid:
        raise refused_program("press_n needs a compliant step", "stiffness_n_m of the step, and another stop class")
    if "press_from_n" in values and "press_s" not in values:
        raise refused_program("press_from_n needs press_s", "the time in which the press changes")
    if not values.get("press_s", 1.0) > 0.0:
        raise refused_program(f"a press cannot change in {values['press_s']:g} s", "press_s above 0")
    for press_n, least_n in ((values["press_n"], 1e-9), (values.get("press_from_n", 0.0), 0.0)):
        if not least_n <= press_n < values["force_n"]:
            raise Refused.because(
                RefusalReason.INFEASIBLE,
                f"a press with {press_n:g} N is asked for; the force limit is {values['force_n']:g} N",
                clears=f"a press with less than {values['force_n']:g} N",
                cause=causes.ForceExceeded(limit_n=values["force_n"], value_n=press_n, arm=task.arm),
            )


def _refuse_spring(task: RuledTask, load: Load | None) -> None:
    """Refuse figures of a spring that would have no effect."""
    values = task.values
    share = values.get("centre_share", 0.0)
    named = [name for name in ("centre_share", "spin_m") if name in values]
    if not named:
        return
    if "stiffness_n_m" not in values or task.stop_class.rigid:
        raise refused_program(f"{named[0]} needs a compliant step", "stiffness_n_m, and another stop class")
    if "spin_m" in values and "press_n" in values:
        raise refused_program("spin_m and press_n both act along the axis of the step", "one of them")
    if not 0.0 <= share <= 1.0:
        raise refused_program(f"centre_share {share:g} is not a share", "a share of 0 to 1")
    if share and load is None:
        raise refused_program("centre_share needs an object in the hand, without a hinge", "a step after the grasp")


def _spin_axis(task: BindTask) -> int:
    """Number of the tool axis nearest to the `axis` of the step."""
    along = axes.in_tool(task.query.tcp(task.arm), axis_of(task.data.step))
    return max(range(3), key=lambda n: abs(along[n]))
