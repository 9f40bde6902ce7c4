"""The table of roles: what it permits, and that it has every endpoint and every message."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from rtc.language.parse import default_grammar, parse
from rtc.protocol import messages as m
from rtc.protocol.roles import MAY, Role, admits, may_send, refuse_planner
from rtc.protocol.sentence import ParsedCommand

HALT = m.HaltOrder(halt="H-1")
SENTENCE = m.CommandText(request="r", text="STOW LEFT-ARM")
LOAD = m.ProgramText(request="r", kind=m.WorkerKind.PARSER, name="x", body=b"")
STATUS = m.StatusQuery(request="r")
COMMIT = m.Commit(request="r", lease=m.Lease(job="j", locations=[], signature=b""), changes=[], source="s")


@pytest.mark.parametrize(
    ("endpoint", "message", "roles"),
    [
        ("front", STATUS, {Role.OBSERVER, Role.PLANNER, Role.OPERATOR}),
        ("front", SENTENCE, {Role.PLANNER, Role.OPERATOR}),
        ("front", LOAD, {Role.OPERATOR}),
        ("front", m.Shutdown(), {Role.OPERATOR}),
        ("halt", HALT, {Role.PLANNER, Role.OPERATOR}),
        ("estop", HALT, {Role.PLANNER, Role.OPERATOR}),
        ("world", m.ReadView(request="r"), {Role.OBSERVER, Role.PLANNER, Role.OPERATOR, Role.WORKER}),
        ("world", COMMIT, {Role.WORKER}),
        ("workers", m.Heartbeat(name="binder@18"), {Role.WORKER}),
        ("subsystems", m.Heartbeat(name="MCM2"), {Role.SUBSYSTEM}),
    ],
)
def test_who_may_say_what(endpoint: str, message: object, roles: set[Role]) -> None:
    assert {role for role in Role if may_send(endpoint, role, message)} == roles


def test_only_roles_that_may_send_something_get_access() -> None:
    for endpoint, row in MAY.items():
        assert {role for role in Role if admits(endpoint, role)} == set(row)


def test_no_role_reaches_supervisor_or_simulator_or_a_wrong_endpoint() -> None:
    assert not {"supervisor", "bench"} & MAY.keys()
    assert not may_send("supervisor", Role.OPERATOR, m.Shutdown())
    assert not may_send("workers", Role.WORKER, SENTENCE)


def test_each_role_that_can_move_an_arm_can_stop_it() -> None:
    for role in Role:
        if may_send("front", role, SENTENCE):
            assert may_send("halt", role, HALT)
            assert may_send("estop", role, HALT)


@pytest.mark.parametrize(
    ("endpoint", "union"),
    [
        ("front", m.ClientToBroker),
        ("world", m.ToWorld),
        ("workers", m.WorkerToBroker),
        ("subsystems", m.SubsystemToBroker),
    ],
)
def test_the_table_allows_only_what_the_inner_endpoint_can_read(endpoint: str, union: object) -> None:
    for kinds in MAY[endpoint].values():
        assert set(kinds) <= set(get_args(union))


@pytest.mark.parametrize(
    ("sentence", "allowed"),
    [
        ("STOW LEFT-ARM", True),
        ("SHOW MACS-OLD", True),
        ("HALT ALL", True),
        ("HALT C-99", True),
        ("RESUME C-1", True),
        ("RESUME C-2", False),
        ("ABORT C-2", False),
        ("PAUSE", False),
        ("RESUME LEFT-ARM", False),
        ("LOAD X INTO ELABORATOR", False),
    ],
)
def test_a_planner_controls_its_own_commands_and_halts_all(sentence: str, allowed: bool) -> None:
    parsed = parse(default_grammar(), sentence)
    assert isinstance(parsed, ParsedCommand)
    assert (refuse_planner(parsed, lambda command: command == "C-1") == "") is allowed


def test_the_page_on_security_shows_this_table() -> None:
    page = (Path(__file__).parents[2] / "docs" / "security.md").read_text()

    def cell(socket: str, role: Role) -> str:
        kinds = MAY[socket].get(role)
        if kinds is None:
            return ""
        if socket in ("events", "telemetry"):
            return "receives"
        return ", ".join(f"`{kind.__name__}`" for kind in kinds) or "declined"

    for n, socket in enumerate(MAY):
        row = f"| +{n} | {socket} | " + " | ".join(cell(socket, role) for role in Role) + " |"
        assert row in page
