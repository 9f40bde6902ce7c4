"""The part of a second arm in a primitive of two arms that hold one object. Pure.

The first arm leads under position control. The second one complies, so an error of a grasp or of a path does not pull
at the object. Each carries half of the load.
"""

from __future__ import annotations

import msgspec

from rtc.programs.schema import BinderProgram, StopClass
from rtc.protocol.messages import BinderInput, BoundStep
from rtc.protocol.primitive import Compliance, ControlLaw, Load, Partner, StopFunction, TcpTurned, TimeAbove
from workers.conditions import stop_conditions
from workers.conditions.stop_conditions import Line, Values
from workers.planning.motion.timing import Timed
from workers.planning.world_query import WorldQuery


def with_partner(
    program: BinderProgram,
    query: WorldQuery,
    data: BinderInput,
    bound: BoundStep,
    motion: Timed,
    stop_class: StopClass,
    values: Values,
    line: Line,
    kept: list[StopFunction],
) -> BoundStep:
    """The bound step of the leading arm, with the part of the second one. `values`: in force for the leading arm.
    `line`: about which the step turns. `kept`: of MAINTAIN; an attitude is that of the first hand. The reflexes of the
    command are those of both arms."""
    made, context = bound.primitive, data.context
    assert made is not None
    own = {**values, "held_width_m": query.hand_width(context.partner)}
    limit_s = next(stop.when.limit_s for stop in made.stop_functions if isinstance(stop.when, TimeAbove))
    rows = [*stop_class.stops, *program.holding]
    own["time_limit_s"] = limit_s
    requested = stop_conditions.from_command(data, query, own, rows, context.partner)
    stops = stop_conditions.stop_functions(rows, own, None, requested, line)
    stops += [stop for stop in kept if not isinstance(stop.when, TcpTurned)]
    stiffness_n_m = values.get("stiffness_n_m", values["partner_n_m"])
    compliance = Compliance(
        stiffness=[stiffness_n_m] * 3 + [values["turn_m"] ** 2 * stiffness_n_m] * 3,
        most_n=values["spring_factor"] * values["force_n"],
        most_nm=values["spring_factor"] * values["torque_nm"],
        until_rest=True,
    )
    gains = {"wn": values["laden_wn_rad_s"]}
    law = ControlLaw(name="impedance", gains=gains, load=_half(query.load(context.partner)), compliance=compliance)
    partner = Partner(performer=context.partner, trajectory=motion.trajectory(), control_law=law, stop_functions=stops)
    leads = msgspec.structs.replace(made.control_law, load=_half(made.control_law.load))
    whole = msgspec.structs.replace(made, control_law=leads, partner=partner)
    return msgspec.structs.replace(bound, primitive=whole)


def _half(load: Load | None) -> Load | None:
    if load is None:
        return None
    inertia = [0.5 * value for value in load.inertia_kg_m2]
    return msgspec.structs.replace(load, mass_kg=0.5 * load.mass_kg, inertia_kg_m2=inertia)
