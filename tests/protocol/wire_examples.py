"""One example of each message, with every key. `python -m tests.protocol.wire_examples` keeps their bytes as files.

It writes a file for each message that has none for this version of the protocol, and changes no other: the files are
what earlier builds of this version send.
"""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Any, get_args

import msgspec
from msgspec import NODEFAULT, inspect

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol import wire
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.protocol.versions import VERSION

FOLDER = Path(__file__).parent / "wire_bytes" / str(VERSION)

#: the unions of all sockets and directions, and what jobs carry
UNIONS = (
    *(m.ClientToBroker, m.BrokerToClient, m.Event, m.WorkerToBroker, m.BrokerToWorker),
    *(m.SubsystemToBroker, m.BrokerToSubsystem, m.FromHalt, m.ToWorld, m.FromWorld, m.ToSim, m.FromSim),
    *(m.SupervisorToBroker, m.BrokerToSupervisor),
)
SINGLE = (
    m.ToHalt,
    m.Telemetry,
    m.Operate,
    m.OperateReply,
    m.ParserInput,
    m.ElaboratorInput,
    m.BinderInput,
    m.AnalyzerInput,
    m.Script,
    m.BoundStep,
)
TYPES = {one.__name__: one for one in (*(each for union in UNIONS for each in get_args(union)), *SINGLE, m.Assessment)}

COMPLIANCE = p.Compliance(
    stiffness=[300.0] * 6, damping=[0.7] * 6, frame="world", centre=[0.0, 0.0, 0.1],
    wrench=[None, None, 5.0, None, 0.5, 0.0],
    profile=p.ForceProfile(time_s=[0.0, 1.0], share=[0.0, 1.0]), most_n=40.0, most_nm=4.0, until_rest=True,
)  # fmt: skip
LAW = p.ControlLaw(
    name="impedance",
    gains={"kp": 100.0},
    load=p.Load(mass_kg=2.0, com_m=[0.0, 0.0, 0.1], inertia_kg_m2=[0.1, 0.1, 0.1, 0.0, 0.0, 0.0]),
    compliance=COMPLIANCE,
)
PATH = p.JointTrajectory(
    space="task", time_s=[0.0, 1.0], positions=[[0.0], [0.1]], velocities=[[0.0], [0.0]], accelerations=[[0.0], [0.0]]
)
STOPS = [
    p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
    p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(5.0)),
    p.StopFunction(
        reason=StopReason.CONTACT,
        when=p.ForceBelow(limit_n=2.0, armed_n=4.0, axis=[0.0, 0.0, 1.0], for_s=0.1),
        reflex=Reflex.BACK_OFF,
        back_off_m=0.01,
    ),
    p.StopFunction(
        reason=StopReason.OUT_OF_RANGE, when=p.ClearanceBelow(limit_m=0.01, except_near=[[0.0, 0.0, 0.0, 0.1]])
    ),
]
PRIMITIVE = p.Primitive(
    id="C-7.1",
    performer="RIGHT-ARM",
    trajectory=PATH,
    stop_functions=STOPS,
    control_law=LAW,
    reporting=p.Reporting(
        items=["FORCES"],
        every_s=0.5,
        when=[p.ReportCondition(n=1, when=p.TorqueAbove(limit_nm=1.0, axis=[1.0, 0.0, 0.0]))],
    ),
    start_after=[p.StartAfter(primitive="C-6.1", path_s=1.0, within_s=9.0)],
    partner=p.Partner(performer="LEFT-ARM", trajectory=PATH, control_law=LAW, stop_functions=STOPS[:2]),
)


def example(kind: Any) -> Any:
    """A value of this type; every key of a message is there and differs from its default."""
    return _value(inspect.type_info(kind), ())


def _value(info: Any, inside: tuple[type, ...], unlike: Any = NODEFAULT) -> Any:
    match info:
        case inspect.StructType(cls=p.Primitive):
            return PRIMITIVE
        case inspect.StructType(cls=cls, fields=fields):
            return cls(**_values(fields, (*inside, cls)))
        case inspect.TypedDictType(fields=fields):
            return _values(fields, inside)
        case inspect.UnionType(types=types):
            known = [one for one in types if not isinstance(one, inspect.NoneType)]
            if isinstance(known[0], inspect.StructType) and known[0].cls in inside:
                return None  # a report of a partner has no partner of its own
            return _value(known[0], inside, unlike)
        case inspect.EnumType(cls=cls):
            return next(one for one in reversed(list[enum.Enum](cls)) if one != unlike)
        case inspect.LiteralType(values=values):
            return next(one for one in reversed(values) if one != unlike)
        case inspect.ListType(item_type=item, min_length=least):
            return [_value(item, inside)] * (least or 1)
        case inspect.DictType(key_type=key, value_type=value):
            return {_value(key, inside): _value(value, inside)}
        case inspect.BoolType():
            return unlike is not True
        case inspect.IntType():
            return 3
        case inspect.FloatType():
            return 0.5
        case inspect.BytesType():
            return b"\x01"
        case inspect.RawType():
            return msgspec.Raw(wire.encode({"opaque": True}))
        case inspect.StrType():
            return "name"
    return 1.5  # Any


def _values(fields: Any, inside: tuple[type, ...]) -> dict[str, Any]:
    found = {field.name: _value(field.type, inside, field.default) for field in fields}
    return {name: value for name, value in found.items() if value is not None}


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, kind in TYPES.items():
        file = FOLDER / f"{name}.msgpack"
        if not file.exists():
            file.write_bytes(wire.encode(example(kind)))
            print(file)


if __name__ == "__main__":
    main()
