"""The part of a second arm in a primitive of two arms that hold one object. Pure.

The first arm leads under position control. The second one complies, so an error of a grasp or of a path does not pull
at the object. Each carries half of the load.
"""

from __future__ import annotations

import msgspec

from rtc.protocol.messages import BoundStep
from rtc.protocol.primitive import Compliance, ControlLaw, Load, Partner, TcpTurned, TimeAbove
from workers.conditions import stop_conditions
from workers.planning.motion.timing import Timed
from workers.tasks import targets
from workers.tasks.bind_task import RuledTask


def with_partner(task: RuledTask, bound: BoundStep, motion: Timed) -> BoundStep:
    """The bound step of the leading arm, with the part of the second one.

    Only the first hand keeps an attitude of MAINTAIN. The reflexes of the command are those of both arms."""
    query, data, values = task.query, task.data, task.values
    made, context = bound.primitive, data.context
    assert made is not None
    own = {**values, "held_width_m": query.hand_width(context.partner)}
    limit_s = next(stop.when.limit_s for stop in made.stop_functions if isinstance(stop.when, TimeAbove))
    rows = [*task.stop_class.stops, *task.program.holding]
    own["time_limit_s"] = limit_s
    requested = stop_conditions.from_command(data, query, own, rows, context.partner)
    stops = stop_conditions.stop_functions(rows, own, None, requested, targets.turn_line(task))
    stops += [stop for stop in stop_conditions.maintained(data, query, values) if not isinstance(stop.when, TcpTurned)]
    stiffness_n_m = values.get("stiffness_n_m", values["partner_n_m"])
    compliance = Compliance(
        stiffness=[stiffness_n_m] * 3 + [values["turn_m"] ** 2 * stiffness_n_m] * 3,
        most_n=values["spring_factor"] * values["force_n"],
        most_nm=values["spring_factor"] * values["torque_nm"],
        until_rest=True,
    )
    gains = {"wn": values["laden_wn_rad_s"]}
    law = ControlLaw(name="impedance", gains=gains, load=_half(query.load(context.partner)), compliance=compliance)
    partner = Partner(
        performer=context.partner,
        trajectory=motion.trajectory(),
        control_law=law,
        stop_functions=stops,
        hand=task.query.hand_planned_with(context.partner),
    )
    leads = msgspec.structs.replace(made.control_law, load=_half(made.control_law.load))
    whole = msgspec.structs.replace(made, control_law=leads, partner=partner)
    return msgspec.structs.replace(bound, primitive=whole)


def _half(load: Load | None) -> Load | None:
    if load is None:
        return None
    inertia = [0.5 * value for value in load.inertia_kg_m2]
    return msgspec.structs.replace(load, mass_kg=0.5 * load.mass_kg, inertia_kg_m2=inertia)
