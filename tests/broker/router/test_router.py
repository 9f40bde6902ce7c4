"""The router against hostile and faulty peers, with lists in place of sockets.

No message ends it, everything that it keeps is bounded, and no peer can act for another.
"""

from __future__ import annotations

import itertools
import random
import sqlite3
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import msgpack
import msgspec
import pytest
import zmq
from hypothesis import HealthCheck, given
from hypothesis import settings as tries
from hypothesis import strategies as st

from broker.decisions.events import HaltCalled, ProgramInstalled
from broker.decisions.invariants import violations
from broker.decisions.reporting import MOST_PER_S
from broker.decisions.state import ParsedHead, ReportHead, State
from broker.persistence import journal as journals
from broker.persistence.journal import Journal
from broker.persistence.program_loads import MOST_WAITING, ProgramLoads
from broker.persistence.program_store import ProgramStore
from broker.router.client_messages import QUERIES_PER_S
from broker.router.egress import NOTES_PER_S, REFUSALS_PER_S
from broker.router.halts import CALLERS_KEPT, HALTS_OF_CALLER
from broker.router.loop import ORPHAN_LIMIT_S, Router
from broker.router.recent_reports import COMMANDS, REPORTS, RecentReports
from rtc.language.record import Condition, Quantity
from rtc.programs import loader
from rtc.programs.digest import digest
from rtc.programs.sandbox import Asked, Checked
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind, RefusalReason
from rtc.runtime.halt_admission import PER_S
from rtc.runtime.handover import Handed
from rtc.runtime.settings import Settings
from tests.broker.harness import Harness, script
from tests.campaigns import hostile

ENDPOINTS = ("front", "halt", "workers", "subsystems", "supervisor", "events")
SETTINGS = Settings(run_dir="/nowhere", run="this")
SILENT = SimpleNamespace(info=lambda *_: None, warning=lambda *_: None)


class Frame:
    def __init__(self, data: bytes, more: bool) -> None:
        self.bytes, self.more = data, more


class Socket:
    """A ROUTER of which one sees what lies there and what was sent."""

    def __init__(self) -> None:
        self.inbox: deque[Frame] = deque()
        self.sent: list[list[bytes]] = []
        self._parts: list[bytes] = []

    def put(self, parts: list[bytes]) -> None:
        self.inbox.extend(Frame(part, n + 1 < len(parts)) for n, part in enumerate(parts))

    def recv(self, flags: int = 0, copy: bool = True) -> Frame:
        if not self.inbox:
            raise zmq.Again
        return self.inbox.popleft()

    def send(self, part: bytes, flags: int = 0) -> None:
        self._parts.append(part)
        if not flags & zmq.SNDMORE:
            self.sent.append(self._parts)
            self._parts = []

    def send_multipart(self, parts: list[bytes], flags: int = 0) -> None:
        self.sent.append(parts)


class Bench:
    def __init__(self, given: Handed | None = None) -> None:
        self.now = 100.0
        self.sockets: dict[str, Socket] = {}
        db = sqlite3.connect(":memory:", isolation_level=None)
        db.executescript(journals.SCHEMA)
        journal = Journal(db)
        journal.snapshot(State())
        me = SimpleNamespace(socket=self._socket, log=SILENT, stopping=False)
        state = State()
        store = ProgramStore(journal, state.programs)
        self.router = Router(
            me, SETTINGS, journal, state, store, given or Handed(SETTINGS, b"k" * 32), lambda: self.now
        )  # type: ignore[arg-type]
        for kind in m.WorkerKind:
            digest = store.keep(loader.default(kind))
            self.router.enqueue(ProgramInstalled(at_s=self.now, kind=kind, digest=digest))
        self.turn()

    def _socket(self, _: int, endpoint: str, **__: Any) -> Socket:
        made = self.sockets[Path(endpoint).stem] = Socket()
        return made

    def turn(self, times: int = 1) -> None:
        for _ in range(times):
            self.now += 0.001
            self.router.run_once(None)

    def send(self, endpoint: str, peer: bytes, *messages: Any) -> list[Any]:
        """The answers to this peer, after all messages have been handled."""
        socket = self.sockets[endpoint]
        for message in messages:
            socket.put([peer, *wire.frames(message)])
        socket.sent.clear()
        while socket.inbox:
            self.turn()
        self.turn()
        return [wire.reader(ANSWERS[endpoint])(parts[1:]) for parts in socket.sent if parts[0] == peer]

    @property
    def state(self) -> State:
        return self.router.core.state


ANSWERS: dict[str, Any] = {
    "front": m.BrokerToClient, "halt": m.FromHalt, "workers": m.BrokerToWorker, "subsystems": m.BrokerToSubsystem,
    "supervisor": m.BrokerToSupervisor,
}  # fmt: skip
MCM = m.SubsystemHello(name="MCM", pid=1, performers=["RIGHT-ARM", "LEFT-ARM"])
PARSER = m.WorkerHello(name="parser@0", node=0, kind=m.WorkerKind.PARSER, pid=7)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def working(bench: Bench) -> Bench:
    """With a subsystem, a parser, and a sentence that the parser has."""
    bench.send("subsystems", b"MCM", MCM)
    bench.send("workers", b"parser@0", PARSER)
    bench.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert list(bench.router.core.registry.workers["parser@0"].assigned) == ["C-1/1"]
    return bench


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
    bench.send("supervisor", b"world", m.Dropped(counts={"world": 7, "front": 9}))
    counters = bench.send("front", b"ann", m.StatusQuery(request="1"))[0].status["counters"]
    dropped = {name: n for name, n in counters.items() if name.startswith("dropped_")}
    assert dropped == {
        **{f"dropped_{endpoint}": 1 for endpoint in ("front", "halt", "workers", "subsystems", "supervisor")},
        "dropped_world": 7,
    }


def test_the_heartbeat_of_a_remote_worker_is_returned(bench: Bench) -> None:
    beat = m.Heartbeat(name="parser@16", at_s=7.0)
    assert bench.send("workers", b"parser@16", beat) == [m.JobBatch(jobs=[])]  # the request for a hello
    bench.send("workers", b"parser@16", m.WorkerHello(name="parser@16", node=16, kind=m.WorkerKind.PARSER, pid=7))
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
        ("supervisor", m.ProcessExited(name="parser@0", pid=7, status=-9, restarting=False)),
        ("supervisor", m.ProcessTable(processes=[])),
        ("supervisor", m.Dropped(counts={"world": 1})),
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


def test_noise_at_the_event_stream_does_not_cut_listeners_off(bench: Bench) -> None:
    events = bench.sockets["events"]
    for frame in (b"\1", b"junk", b"", b"\0other", b"\0other", b"\xff"):
        events.put([frame])
    bench.turn()
    bench.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert events.sent
    events.put([b"\0"])
    bench.turn()
    events.sent.clear()
    bench.send("front", b"ann", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert not events.sent


def subscribe(bench: Bench) -> None:
    bench.sockets["events"].put([b"\1"])
    bench.turn()


def published(bench: Bench, kind: type) -> list[Any]:
    read = wire.reader(m.Event)
    return [event for parts in bench.sockets["events"].sent if isinstance(event := read(parts), kind)]


def test_a_refused_request_is_published_with_its_sentence(working: Bench) -> None:
    subscribe(working)
    working.send("front", b"ann", m.CommandText(request="1", text="another sentence"))
    (refused,) = published(working, m.RequestRefused)
    assert (refused.request, refused.text, refused.refusal.reason) == ("1", "another sentence", RefusalReason.STATE)


def test_a_flood_of_refused_requests_does_not_drown_the_event_stream(working: Bench) -> None:
    """Given refused sentences above the published rate, the rest is counted, and a command's events are published."""
    subscribe(working)
    again = m.CommandText(request="1", text="another sentence")
    answers = working.send("front", b"ann", *[again] * (REFUSALS_PER_S + 50))
    assert len(answers) == REFUSALS_PER_S + 50  # each sender gets its answer
    assert len(published(working, m.RequestRefused)) == REFUSALS_PER_S
    assert working.router.core.dropped["refusals"] == 50
    working.send("front", b"bob", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert published(working, m.ProgressNote)
    working.now += 1.0
    working.send("front", b"ann", again)
    assert len(published(working, m.RequestRefused)) == REFUSALS_PER_S + 1


def test_a_flood_of_commands_publishes_a_limited_number_of_notes(working: Bench) -> None:
    subscribe(working)

    def flood(how_many: int) -> None:
        for first in range(0, how_many, 100):
            numbers = range(first, first + 100)
            texts = (m.CommandText(request=str(n), text="STOW LEFT-ARM", progress=False) for n in numbers)
            working.send("front", f"ann-{first // 1000}".encode(), *texts)

    flood(NOTES_PER_S + 1000)
    notes = len(published(working, m.ProgressNote))
    assert NOTES_PER_S < notes < NOTES_PER_S + 500
    working.now += 1.0
    working.send("front", b"bob", m.CommandText(request="1", text="STOW LEFT-ARM"))
    working.send("front", b"bob", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert len(published(working, m.ProgressNote)) > notes


def test_one_client_asks_so_often_and_another_is_served(bench: Bench) -> None:
    answers = bench.send("front", b"x", *(m.StatusQuery(request=str(n)) for n in range(QUERIES_PER_S + 5)))
    assert [type(answer) for answer in answers] == [m.StatusReply] * QUERIES_PER_S + [m.Declined] * 5
    assert "times a second" in answers[-1].refusal.message
    assert type(bench.send("front", b"ann", m.StatusQuery(request="1"))[0]) is m.StatusReply
    bench.now += 1.0
    assert type(bench.send("front", b"x", m.StatusQuery(request="later"))[0]) is m.StatusReply


def test_who_calls_halts_without_end_is_obeyed_and_folded(working: Bench) -> None:
    """Given a stream of halts of one caller, when another calls one, it is answered, and the last of the stream too
    has stopped what it meant."""
    calls = [m.HaltOrder(halt=f"H-{n}", scope=("LEFT-ARM", "RIGHT-ARM")[n % 2]) for n in range(PER_S + 50)]
    working.send("halt", b"x", *calls)
    working.now += 0.2
    working.turn()
    passed_on = [wire.reader(m.BrokerToSubsystem)(parts[1:]) for parts in working.sockets["subsystems"].sent]
    assert working.router.core.dropped["halts_folded"] == 50
    assert len(passed_on) == PER_S + 1  # those beyond number together
    assert (passed_on[-1].halt, passed_on[-1].scope) == (calls[-1].halt, "ALL")  # of two scopes
    assert len(working.router.halts.callers[b"x"]) == HALTS_OF_CALLER

    working.send("halt", b"ann", m.HaltOrder(halt="H-ann", scope="LEFT-ARM"))
    rest = m.HaltAtRest(halt="H-ann", subsystem="MCM", at_s=1.0, at_rest=True, performers=["LEFT-ARM"])
    working.send("subsystems", b"MCM", rest)
    assert working.sockets["halt"].sent[-1] == [b"ann", *wire.frames(rest)]


def test_two_callers_of_one_name_each_get_the_answer_to_their_own_halt(working: Bench) -> None:
    for caller, scope in ((b"ann", "LEFT-ARM"), (b"bob", "ALL")):
        working.send("halt", caller, m.HaltOrder(halt="1", scope=scope))
    sent = [wire.reader(m.BrokerToSubsystem)(parts[1:]) for parts in working.sockets["subsystems"].sent]
    of_bob = next(order for order in sent if isinstance(order, m.HaltOrder) and order.scope == "ALL")
    working.sockets["halt"].sent.clear()
    rest = m.HaltAtRest(halt="1", subsystem="MCM", at_s=1.0, at_rest=True, performers=[], call=of_bob.call)
    working.send("subsystems", b"MCM", rest)
    assert working.sockets["halt"].sent == [[b"bob", *wire.frames(msgspec.structs.replace(rest, call=""))]]


def test_a_cluster_that_is_stopped_ends_its_commands_and_takes_no_more(working: Bench) -> None:
    supervisor = working.router.core.supervisor_peer
    for asked in range(2):  # the supervisor asks again until it has the answer
        answers = working.send("supervisor", supervisor, m.Shutdown())
        assert m.AllEnded(commands=["C-1"]) in answers, asked
    (declined,) = working.send("front", b"ann", m.CommandText(request="2", text="STOW LEFT-ARM"))
    assert "is being stopped" in declined.refusal.message
    known = working.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert [type(answer) for answer in known] == [m.Accepted, m.CommandEnded]
    assert known[1].outcome.kind is OutcomeKind.HALTED


def test_without_its_supervisor_it_sends_every_client_an_outcome_in_time(bench: Bench) -> None:
    """Given one command whose subsystem is silent, one that waits for its analyzer and one for its parser."""
    bench.send("subsystems", b"MCM", MCM)
    story = Harness(mcm=False)
    story.state, story.now = bench.state, bench.now
    silent = story.executing()
    done = story.executing(script(resources=("LEFT-ARM",)), hand="LEFT-ARM")
    story.reports(done)
    story.says("X")
    me, began_s = bench.router.core.me, bench.now

    def wait(timeout_s: float) -> tuple[()]:
        bench.now += timeout_s
        return ()

    me.stopping, me.orphaned, me.wait = True, True, wait  # type: ignore[misc, assignment, method-assign]
    bench.router.run()

    ended = {message.command: message.outcome for message in forwarded(bench) if isinstance(message, m.CommandEnded)}
    assert [(name, outcome.kind) for name, outcome in ended.items()] == [
        ("C-3", OutcomeKind.HALTED),
        (done, OutcomeKind.HALTED),
        (silent, OutcomeKind.HALT_NOT_CONFIRMED),
    ]
    assert "until the world database is updated" in ended[done].message
    assert "no report after the supervisor's death" in ended[silent].message
    assert bench.now - began_s == pytest.approx(ORPHAN_LIMIT_S, abs=0.01)


def test_a_broker_that_is_ended_alone_leaves_its_commands_to_the_next(working: Bench) -> None:
    me = working.router.core.me
    me.stopping, me.orphaned = True, False  # type: ignore[misc]
    working.router.run()
    assert list(working.state.commands) == ["C-1"]


def test_callers_are_forgotten_some_time(bench: Bench) -> None:
    for n in range(CALLERS_KEPT + 50):
        bench.sockets["halt"].put([b"c%d" % n, *wire.frames(m.HaltOrder(halt=f"H-{n}"))])
    bench.turn(100)
    assert len(bench.router.halts.callers) == CALLERS_KEPT


def test_the_names_of_the_brokers_own_halts_are_not_for_others(working: Bench) -> None:
    """Otherwise a client could get the rest of C-1 confirmed by a halt of something else."""
    working.send("halt", b"x", m.HaltOrder(halt="stop-C-1", scope="RIGHT-ARM", called_at_s=float("nan")))
    order = wire.reader(m.BrokerToSubsystem)(working.sockets["subsystems"].sent[-1][1:])
    assert (order.halt, order.scope, order.called_at_s) == ("H-stop-C-1", "RIGHT-ARM", 0.0)


# --- who is who ---------------------------------------------------------------------------------------

TOKEN = "0123456789abcdef"
OURS = f"MCM@{TOKEN}".encode()
SUPERVISOR = f"supervisor@{TOKEN}".encode()
HELLO = m.SubsystemHello(name="MCM", pid=7, performers=["LEFT-ARM"])


@pytest.fixture
def supervised() -> Bench:
    bench = Bench(Handed(SETTINGS, b"k" * 32, TOKEN))
    row = {"name": "MCM", "pid": 7, "state": "ready", "since_s": 0.0}
    bench.send("supervisor", SUPERVISOR, {"type": "ProcessTable", "processes": [row]})
    bench.send("subsystems", OURS, HELLO)
    return bench


def test_a_stranger_that_calls_itself_mcm_is_refused_in_words(supervised: Bench) -> None:
    stranger = m.SubsystemHello(name="MCM", pid=8, performers=["LEFT-ARM"])
    (refused,) = supervised.send("subsystems", b"MCM", stranger, m.Heartbeat(name="MCM"))
    assert refused.refusal.message == "this cluster has its own MCM, pid 7"
    assert supervised.state.subsystems["MCM"].pid == 7
    supervised.router.enqueue(HaltCalled(at_s=supervised.now, client="x", halt="H", scope="ALL"))
    assert [type(order) for order in supervised.send("subsystems", OURS, m.Heartbeat(name="MCM"))] == [m.HaltOrder]


def test_a_stranger_that_calls_itself_supervisor_changes_nothing(supervised: Bench) -> None:
    supervised.send("supervisor", b"supervisor", m.ProcessTable(processes=[]))
    assert [row["name"] for row in supervised.router.core.processes] == ["MCM"]


def test_a_subsystem_that_is_lost_although_it_runs_is_started_anew(supervised: Bench) -> None:
    socket = supervised.sockets["supervisor"]
    for _ in range(90):  # 9 s, in which it sends nothing
        supervised.now += 0.099
        supervised.turn()
    asked = [wire.reader(m.BrokerToSupervisor)(parts[1:]) for parts in socket.sent if parts[0] == SUPERVISOR]
    (kill,) = [order for order in asked if isinstance(order, m.KillProcess)]
    assert (kill.name, kill.pid) == ("MCM", 7)
    assert "lost to the broker" in kill.why


# --- REPORT EVERY ------------------------------------------------------------------------------------


@pytest.fixture
def reporting(working: Bench) -> Bench:
    """Ann's command is being executed, and its sentence asks for periodic reports of joints."""
    command = working.state.commands["C-1"]
    command.head = ParsedHead(kind="task", verb="STOW", report=ReportHead(joints=True, every_s=0.5))
    command.primitive, command.subsystem, command.performers = "C-1.1", "MCM", ["LEFT-ARM"]
    working.sockets["front"].sent.clear()
    return working


def progress(primitive: str = "C-1.1") -> m.ProgressReport:
    return m.ProgressReport(primitive=primitive, at_s=1.0, joints=[0.5], wrench=[0.0] * 6, tcp_pose=[0.0] * 7)


def forwarded(bench: Bench) -> list[Any]:
    return [wire.reader(m.BrokerToClient)(parts[1:]) for parts in bench.sockets["front"].sent if parts[0] == b"ann"]


def test_a_periodic_report_goes_to_the_client_and_past_the_journal(reporting: Bench) -> None:
    before = (reporting.router.core.journal.events_since_snapshot, reporting.state.seq)

    reporting.send("subsystems", b"MCM", progress())

    [note] = forwarded(reporting)
    assert (note.seq, note.command, note.measured.joints, note.measured.tcp_pose) == (0, "C-1", [0.5], None)
    assert (reporting.router.core.journal.events_since_snapshot, reporting.state.seq) == before


def test_a_report_that_was_not_requested_is_dropped(reporting: Bench) -> None:
    reporting.send("subsystems", b"MCM", progress("C-1.0"), progress("C-9.1"))
    reporting.state.commands["C-1"].head = ParsedHead(kind="task", verb="STOW", report=ReportHead(joints=True))
    reporting.send("subsystems", b"MCM", progress())
    assert forwarded(reporting) == []


def test_periodic_reports_are_bounded(reporting: Bench) -> None:
    reporting.send("subsystems", b"MCM", *[progress()] * (2 * MOST_PER_S))
    assert len(forwarded(reporting)) == MOST_PER_S
    assert reporting.router.core.dropped["reports"] == MOST_PER_S


def test_a_condition_goes_to_the_client_in_the_words_of_its_sentence(reporting: Bench) -> None:
    force = Condition(measure="FORCE", bound="above", quantity=Quantity(5.0, "N"))
    head = ReportHead(joints=True, when=[Condition(event="CONTACT"), force])
    reporting.state.commands["C-1"].head = ParsedHead(kind="task", verb="STOW", report=head)

    met = {"measured": 6.0, "limit": 5.0}
    reports = [msgspec.structs.replace(progress(), condition=n, **met) for n in (1, 0, 2)]
    reporting.send("subsystems", b"MCM", *reports)

    assert [note.note for note in forwarded(reporting)] == ["FORCE EXCEEDS 5 N: 6 N", "CONTACT: 6"]


def test_the_latest_reports_are_in_the_trace_and_older_ones_counted(reporting: Bench) -> None:
    reporting.send("subsystems", b"MCM", *[progress()] * (REPORTS + 3))
    (reply,) = reporting.send("front", b"bob", m.TraceQuery(request="q", command="C-1"))
    assert (len(reply.record.reports), reply.record.reports_older) == (REPORTS, 3)
    assert reply.record.reports[0].measured.joints == [0.5]


def test_reports_are_kept_of_the_latest_commands_only() -> None:
    kept = RecentReports()
    for n in range(COMMANDS + 1):
        kept.keep(m.ProgressNote(seq=0, at_s=0.0, command=f"C-{n}", phase=m.Phase.EXECUTING))
    records = [
        m.CommandRecord(command=f"C-{n}", text="", source="", request="", accepted_at_s=0.0, phase=m.Phase.ENDED)
        for n in range(COMMANDS + 1)
    ]
    assert [len(kept.add_to(record).reports) for record in records] == [0] + [1] * COMMANDS


def test_the_status_tells_how_old_the_list_of_processes_is(supervised: Bench) -> None:
    supervised.now += 12.0
    (reply,) = supervised.send("front", b"ann", m.StatusQuery(request="q"))
    assert reply.status["supervisor_silent_s"] == pytest.approx(12.0, abs=0.1)


# --- programs -----------------------------------------------------------------------------------------


class Slow:
    """A check that is done when the test says so."""

    started: ClassVar[list[Slow]] = []

    def __init__(self, asked: Asked) -> None:
        self.asked, self.checked = asked, None
        self.started.append(self)

    def result(self, now: float) -> Checked | None:
        return self.checked


@pytest.fixture
def slow(bench: Bench) -> Bench:
    Slow.started = []
    bench.router.core.loads = ProgramLoads(bench.router.core.store, Slow)
    return bench


def program_text(request: str, body: bytes = b"x") -> m.ProgramText:
    return m.ProgramText(request=request, kind=m.WorkerKind.PARSER, name="mine.lark", body=body)


def test_no_one_waits_for_a_program_that_is_checked(slow: Bench) -> None:
    assert slow.send("front", b"ann", program_text("1")) == []
    (reply,) = slow.send("front", b"bob", m.StatusQuery(request="q"))
    assert isinstance(reply, m.StatusReply)
    Slow.started[0].checked = Checked(error="mine.lark: it takes more than 3 s")
    (declined,) = slow.send("front", b"ann", m.ClientHello(client="ann"))[1:]
    assert declined.refusal.message == "mine.lark: it takes more than 3 s"


def test_programs_are_checked_one_after_the_other_each_upon_the_one_before(slow: Bench) -> None:
    slow.send("front", b"ann", program_text("1"), program_text("1"), program_text("2"))
    (first,) = Slow.started
    first.checked = Checked(merged=b"first", changes=["a change"])
    loaded = [a for a in slow.send("front", b"ann", m.Heartbeat(name="ann")) if isinstance(a, m.ProgramLoaded)]
    assert [answer.changes for answer in loaded] == [["a change"]]
    assert Slow.started[1].asked.program == b"first"
    assert slow.state.programs["parser"] == digest(b"first")


def test_too_many_programs_at_once_are_declined(slow: Bench) -> None:
    answers = []
    for n in range(MOST_WAITING + 1):
        slow.now += 1.0
        answers += slow.send("front", b"ann", program_text(str(n)))
    assert [answer.refusal.reason for answer in answers] == [RefusalReason.OVERLOAD]


# --- once per turn ----------------------------------------------------------------------------------------


def bodies(socket: Socket, peer: bytes) -> list[Any]:
    return [msgpack.unpackb(parts[2]) for parts in socket.sent if parts[0] == peer]


def kinds(body: Any) -> Any:
    return [one["type"] for one in body] if isinstance(body, list) else body["type"]


def test_a_client_that_reads_arrays_gets_all_of_a_turn_in_one(bench: Bench) -> None:
    bench.send("front", b"ann", m.ClientHello(client="ann", arrays=True))
    front = bench.sockets["front"]
    for n in range(3):
        front.put([b"ann", *wire.frames(m.CommandText(request=str(n), text="X", progress=False))])
        front.put([b"bob", *wire.frames(m.CommandText(request=str(n), text="X", progress=False))])
    front.sent.clear()
    bench.turn()
    assert [kinds(body) for body in bodies(front, b"ann")] == [["Accepted"] * 3]
    assert [kinds(body) for body in bodies(front, b"bob")] == ["Accepted"] * 3


def test_a_hello_without_arrays_takes_the_word_back(bench: Bench) -> None:
    bench.send("front", b"ann", m.ClientHello(client="ann", arrays=True))
    bench.send("front", b"ann", m.ClientHello(client="ann"))
    front = bench.sockets["front"]
    for n in range(2):
        front.put([b"ann", *wire.frames(m.CommandText(request=str(n), text="X", progress=False))])
    front.sent.clear()
    bench.turn()
    assert [kinds(body) for body in bodies(front, b"ann")] == ["Accepted"] * 2


def test_of_an_array_only_the_bad_map_is_declined(bench: Bench) -> None:
    front = bench.sockets["front"]
    good = [m.CommandText(request=str(n), text="X", progress=False) for n in (1, 3)]
    front.put([b"ann", wire.PROTOCOL, wire.encode([good[0], {"type": "CommandText", "request": "2"}, good[1]])])
    bench.turn()
    answers = {body["request"]: body["type"] for body in bodies(front, b"ann")}
    assert answers == {"1": "Accepted", "2": "Declined", "3": "Accepted"}
    assert bench.router.core.dropped["front"] == 1


def test_an_array_beyond_its_bound_is_declined_as_a_whole(bench: Bench) -> None:
    front = bench.sockets["front"]
    many = [m.CommandText(request=str(n), text="X") for n in range(wire.MOST_TOGETHER + 1)]
    front.put([b"ann", wire.PROTOCOL, wire.encode(many)])
    bench.turn()
    assert [kinds(body) for body in bodies(front, b"ann")] == ["Declined"]
    assert not bench.state.commands


def test_a_halt_leaves_alone_and_at_once_behind_what_was_sent_before_it(bench: Bench) -> None:
    outbox, sent = bench.router.egress.subsystems, bench.sockets["subsystems"].sent
    outbox.set_arrays(b"MCM", reads_arrays=True)
    sent.clear()
    outbox.put(b"MCM", m.ReportAck(primitive="C-1.1"))
    outbox.put(b"MCM", m.ReportAck(primitive="C-2.1"))
    outbox.send_now(b"MCM", m.HaltOrder(halt="H-1"))
    assert [kinds(body) for body in bodies(bench.sockets["subsystems"], b"MCM")] == [["ReportAck"] * 2, "HaltOrder"]
