"""The router against hostile and faulty peers, with lists in place of sockets.

No message ends it, everything that it keeps is bounded, and no peer can act for another.
"""

from __future__ import annotations

import itertools
import random
from typing import Any

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as tries
from hypothesis import strategies as st

from broker.decisions.state import State
from broker.router.client_messages import QUERIES_PER_S
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.versions import VERSION
from tests.broker.router.bench import ENDPOINTS, MCM, PARSER, SETTINGS, Bench
from tests.campaigns import hostile
from tests.simulation.invariants import violations


@given(seed=st.integers(0, 1 << 32))
@tries(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_no_message_at_any_endpoint_breaks_it(seed: int) -> None:
    bench, rng = Bench(), random.Random(seed)
    bench.send("subsystems", b"MCM", MCM)
    bench.send("workers", b"parser@0", PARSER)
    peers = [*hostile.IDENTITIES, *itertools.chain(*hostile.IMPOSTORS.values())]
    sources = {endpoint: hostile.bad_messages(endpoint, rng) for endpoint in ENDPOINTS}
    for _ in range(150):
        endpoint = rng.choice(ENDPOINTS)
        parts = next(sources[endpoint])
        bench.sockets[endpoint].put(parts if endpoint == "events" else [rng.choice(peers), *parts])
        if rng.random() < 0.3:
            bench.turn()
            bench.now += rng.choice((0.0, 0.1, 5.0))
    bench.turn(100)
    assert not violations(bench.state)
    snapshot = wire.encode(bench.state)
    assert wire.encode(wire.decoder(State)(snapshot)) == snapshot


def test_unreadable_messages_are_counted_by_endpoint(bench: Bench) -> None:
    for endpoint in ("front", "halt", "workers", "subsystems", "supervisor"):
        bench.sockets[endpoint].put([b"x", b"RTC0", b""])
    bench.turn()
    bench.send("supervisor", b"world", m.ProcessHello(name="world", protocol=VERSION))  # as it does at its start
    bench.send("supervisor", b"world", m.UnreadableMessages(counts={"world": 7, "front": 9}))
    counters = bench.send("front", b"ann", m.StatusQuery(request="1"))[0].status.counters
    dropped = {name: n for name, n in counters.items() if name.startswith("dropped_")}
    assert dropped == {
        **{f"dropped_{endpoint}": 1 for endpoint in ("front", "halt", "workers", "subsystems", "supervisor")},
        "dropped_world": 7,
    }


def test_the_heartbeat_of_a_remote_worker_is_returned(bench: Bench) -> None:
    beat = m.Heartbeat(name="parser@16", at_s=7.0)
    assert bench.send("workers", b"parser@16", beat) == [m.HelloWanted()]
    bench.send(
        "workers",
        b"parser@16",
        m.WorkerHello(protocol=VERSION, name="parser@16", node=16, kind=m.WorkerKind.PARSER, pid=7),
    )
    assert bench.send("workers", b"parser@16", beat) == [beat]
    assert bench.send("workers", b"parser@16", m.Heartbeat(name="parser@16")) == []


@pytest.mark.parametrize("in_order", [True, False])
def test_workers_that_take_leave_are_not_a_failure_of_their_jobs(working: Bench, in_order: bool) -> None:
    for _ in range(10):
        working.send("workers", b"parser@0", m.WorkerGone(name="parser@0", in_order=in_order))
        working.send("workers", b"parser@0", PARSER)
    assert ("C-1" in working.state.commands) is in_order


@pytest.mark.parametrize(
    "message",
    [
        m.CommandText(request="1", text="STOW LEFT-ARM", cluster="old"),
        m.ProgramText(request="1", kind=m.WorkerKind.PARSER, name="p.yaml", body=b"", cluster="old"),
    ],
)
def test_messages_for_another_cluster_are_not_obeyed(bench: Bench, message: Any) -> None:
    """Given a line on which something lay for the cluster that was here before."""
    programs = dict(bench.state.programs)
    welcome, declined = bench.send("front", b"ann", message)
    assert welcome.cluster == SETTINGS.run
    assert (declined.request, declined.refusal.reason) == ("1", "state")
    assert (bench.state.accepted, bench.state.programs) == (0, programs)
    assert bench.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM", cluster=SETTINGS.run))
    assert bench.state.accepted == 1


@pytest.mark.parametrize("has_ended", [False, True])
def test_a_known_request_with_another_text_is_declined(working: Bench, has_ended: bool) -> None:
    """Given a client that counts from one again, then it does not get the outcome of its former life."""
    if has_ended:
        refused = m.JobRefused(id="C-1/1", attempt=1, refusal=m.Refusal(reason="sentence", message="no"))
        working.send("workers", b"parser@0", m.ResultBatch(name="parser@0", results=[refused]))
    assert ("C-1" in working.state.ended) is has_ended
    (declined,) = working.send("front", b"ann", m.CommandText(request="1", text="STOW RIGHT-ARM"))
    assert (type(declined), declined.request, working.state.accepted) == (m.Declined, "1", 1)
    accepted, *_ = working.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert accepted == m.Accepted(request="1", command="C-1")


@pytest.mark.parametrize(
    "wrong",
    [{"source": "planner"}, {"text": 7}, {"request": "r" * 250}, {"sent_at_s": -1.0}, {"type": "CommandTexts"}],
)
def test_what_cannot_be_read_is_answered_by_its_name(bench: Bench, wrong: dict[str, Any]) -> None:
    """Otherwise its sender would wait without end."""
    message = {"type": "CommandText", "request": "1", "text": "STOW LEFT-ARM", **wrong}
    (declined,) = bench.send("front", b"ann", message)
    assert (type(declined), declined.request) == (m.Declined, message["request"])


@pytest.mark.parametrize(
    "data", [b"", b"\xc1", wire.encode([1]), wire.encode({"request": 1}), wire.encode({"request": "r" * 9999})]
)
def test_what_has_no_name_is_answered_without(bench: Bench, data: bytes) -> None:
    front = bench.sockets["front"]
    front.put([b"ann", wire.PROTOCOL, data])
    bench.turn()
    assert wire.reader(m.BrokerToClient)(front.sent[-1][1:]).request == ""


def test_after_a_hello_that_cannot_be_read_nothing_counts_until_a_hello_that_can(bench: Bench) -> None:
    front = bench.sockets["front"]
    front.put([b"ann", wire.PROTOCOL, wire.encode({"type": "ClientHello", "protocol": "new", "client": 7})])
    bench.turn()
    read = wire.reader(m.BrokerToClient)
    assert isinstance(read(front.sent[-1][1:]), m.Declined)
    bench.send("front", b"ann", m.CommandText(request="r1", text="STOW RIGHT-ARM"))
    assert isinstance(read(front.sent[-1][1:]), m.Declined)
    assert not bench.state.commands
    bench.send("front", b"ann", m.ClientHello(protocol=VERSION, client="ann"))
    bench.send("front", b"ann", m.CommandText(request="r2", text="STOW RIGHT-ARM"))
    assert bench.state.commands


def test_an_answer_counts_only_from_whom_the_job_was_given_to(working: Bench) -> None:
    forged = m.JobRefused(id="C-1/1", attempt=1, refusal=m.Refusal(reason="sentence", message="forged"))
    working.send("workers", b"parser@9", m.ResultBatch(name="parser@0", results=[forged]))
    assert working.state.commands["C-1"].phase is m.Phase.PARSING
    working.send("workers", b"parser@0", m.ResultBatch(name="parser@0", results=[forged]))
    assert "C-1" not in working.state.commands


@pytest.mark.parametrize(
    ("endpoint", "message"),
    [
        ("workers", PARSER),
        ("subsystems", MCM),
        ("subsystems", m.HaltAtRest(halt="H-1", subsystem="MCM", at_s=1.0, at_rest=True, performers=["LEFT-ARM"])),
        ("supervisor", m.ProcessExited(name="parser@0", pid=7, status=-9)),
        ("supervisor", m.ProcessTable(processes=[])),
        ("supervisor", m.ProcessHello(name="supervisor", protocol=VERSION)),
        ("supervisor", m.UnreadableMessages(counts={"world": 1})),
    ],
)
def test_no_peer_speaks_for_another(working: Bench, endpoint: str, message: Any) -> None:
    before = wire.encode(working.state)
    working.send(endpoint, b"stranger", message)
    assert working.router.core.dropped[endpoint] == 1
    assert wire.encode(working.state) == before
    assert list(working.router.core.registry.workers) == ["parser@0"]


def test_a_table_that_is_none_is_dropped(bench: Bench) -> None:
    good = {"name": "a", "pid": 2, "state": "ready", "since_s": 1.0}
    for rows in ([{}], [{**good, "name": 1}], [{**good, "since_s": ""}]):
        bench.send("supervisor", b"supervisor", {"type": "ProcessTable", "processes": rows})
    assert bench.router.core.dropped["supervisor"] == 3
    bench.now += 1.0
    bench.turn()


def test_one_client_asks_so_often_and_another_is_served(bench: Bench) -> None:
    answers = bench.send("front", b"x", *(m.StatusQuery(request=str(n)) for n in range(QUERIES_PER_S + 5)))
    assert [type(answer) for answer in answers] == [m.StatusReply] * QUERIES_PER_S + [m.Declined] * 5
    assert answers[-1].refusal.reason is RefusalReason.OVERLOAD
    assert type(bench.send("front", b"ann", m.StatusQuery(request="1"))[0]) is m.StatusReply
    bench.now += 1.0
    assert type(bench.send("front", b"x", m.StatusQuery(request="later"))[0]) is m.StatusReply


def test_an_arm_that_moved_without_a_primitive_is_noted_once_and_shown_until_its_next_one(bench: Bench) -> None:
    bench.send("subsystems", b"MCM", MCM)
    arm = MCM.performers[0]
    for how in ("moved without a command; braked, it moves", "moved without a command; braked, it rests"):
        bench.send("subsystems", b"MCM", m.Strayed(arms={arm: how, "ANOTHER": how}))
    status = bench.send("front", b"ann", m.StatusQuery(request="1"))[0].status
    assert [row.strayed for row in status.subsystems] == [[f"{arm} {how}"]]
    assert status.commands_accepted == 1
    bench.send("subsystems", b"MCM", m.Strayed(arms={}))
    status = bench.send("front", b"ann", m.StatusQuery(request="2"))[0].status
    assert [row.strayed for row in status.subsystems] == [[]]


def test_a_sentence_of_a_client_without_a_hello_is_declined(bench: Bench) -> None:
    sentence = m.CommandText(request="1", text="STOW LEFT-ARM")
    (declined,) = bench.send("front", b"eve", sentence)
    assert declined.refusal.reason is RefusalReason.VERSION
    assert bench.state.commands == {}
    answers = bench.send("front", b"eve", m.ClientHello(protocol=VERSION, client="eve", at_s=bench.now), sentence)
    assert any(isinstance(answer, m.Accepted) for answer in answers)


@pytest.mark.parametrize(
    ("verb", "step", "kind"),
    [("GRASP", 2, m.Debugged), ("FLY", 2, m.Declined), ("", 2, m.Declined), ("GRASP", 99, m.Declined)],
)
def test_a_breakpoint_is_a_step_that_a_command_can_reach(bench: Bench, verb: str, step: int, kind: type) -> None:
    points = [m.Breakpoint(verb=verb, step=step)]
    (answer,) = bench.send("front", b"ann", m.SetBreakpoints(request="b", breakpoints=points))
    assert isinstance(answer, kind)
    assert bench.state.breakpoints == (points if kind is m.Debugged else [])


def test_a_step_of_a_command_that_does_not_exist_is_declined_for_its_name(working: Bench) -> None:
    (declined,) = working.send("front", b"ann", m.StepCommand(request="1", command="C-99"))
    assert declined.refusal.reason is RefusalReason.NAME
    working.send("front", b"ann", m.CommandText(request="2", text="STOW LEFT-ARM"))
    (declined,) = working.send("front", b"ann", m.StepCommand(request="3", command="C-1"))
    assert declined.refusal.reason is RefusalReason.STATE
