"""The client against a small broker of real sockets with real messages: what it sends, repeats and reports."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
import zmq

from rtc.client import core, halt
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.outcomes import (
    NoCluster,
    NotSucceeded,
    Outcome,
    OutcomeKind,
    Refusal,
    RefusalReason,
    RequestDeclined,
    TimedOut,
)
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.protocol.wire import frames, reader, reader_of_many, together
from rtc.runtime.halt_admission import overload
from rtc.runtime.settings import Settings
from tests.apps.cli.in_process import call

Answer = Callable[[m.ClientToBroker], list[object]]
read_client = reader_of_many(m.ClientToBroker)
read_halt = reader(m.ToHalt)
UNKNOWN_SCOPES = ("C-99", "RIGHT-AMR")  # names of nothing
ENDED = "C-5"  # of which nothing moves; the broker has nothing to decline


class SmallBroker(threading.Thread):
    """Binds front and halt (as broker) and estop (as MCM); answers by plain functions; keeps what it received."""

    def __init__(self, run_dir: Path, answer: Answer, *, halts: bool = True, front: bool = True) -> None:
        super().__init__(daemon=True)
        self.received: list[m.ClientToBroker] = []
        self.parcels: list[int] = []  # messages in each message of a client
        self.halted: list[tuple[str, m.HaltOrder]] = []
        self.at_rest: bool | None = True
        self.overloaded: tuple[str, ...] = ()  # sockets that obey and say that they will not confirm rest
        self._answer = answer
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._stop_in = self._context.socket(zmq.PAIR)
        self._stop_in.bind("inproc://stop")
        self._stop_out = self._context.socket(zmq.PAIR)
        self._stop_out.connect("inproc://stop")
        self._names: dict[zmq.Socket[bytes], str] = {}
        for name in (["front"] if front else []) + (["halt", "estop"] if halts else []):
            socket = self._context.socket(zmq.ROUTER)
            socket.bind(Settings.load(run_dir).endpoint(name))
            self._names[socket] = name
        self.start()

    def run(self) -> None:
        poller = zmq.Poller()
        for socket in (self._stop_in, *self._names):
            poller.register(socket, zmq.POLLIN)
        while self._stop_in not in (ready := dict(poller.poll())):
            for socket in ready:
                who, *parts = socket.recv_multipart()
                if self._names[socket] == "front":
                    messages = read_client(parts)
                    self.received += messages
                    self.parcels.append(len(messages))
                    answers = [answer for message in messages for answer in self._answer(message)]
                    if len(messages) > 1:  # it reads arrays, then
                        (parts,) = together(answers)
                        socket.send_multipart([who, *parts])
                        continue
                else:
                    order = read_halt(parts)
                    self.halted.append((self._names[socket], order))
                    answers = self._obey(order, self._names[socket])
                for answer in answers:
                    socket.send_multipart([who, *frames(answer)])
        for socket in (self._stop_in, *self._names):
            socket.close(linger=100)

    def _obey(self, order: m.HaltOrder, name: str) -> list[object]:
        rest = m.HaltAtRest(halt=order.halt, subsystem="MCM", at_s=0.0, at_rest=True, performers=[])
        if name in self.overloaded:
            return [overload(order, "too many calls")]
        if order.scope == ENDED:
            return [rest] if name == "estop" else []
        if order.scope in UNKNOWN_SCOPES:  # the MCM cannot know; the broker does
            refusal = Refusal(reason=RefusalReason.NAME, message=f"nothing live is called {order.scope}")
            return [rest if name == "estop" else m.Declined(request=order.halt, refusal=refusal)]
        started = m.HaltStarted(
            halt=order.halt,
            subsystem="MCM",
            received_at_s=order.called_at_s + 0.001,
            decelerating_at_s=order.called_at_s + 0.002,
            moving=["RIGHT-ARM"],
        )
        if self.at_rest is None:
            return [started]
        rest = m.HaltAtRest(
            halt=order.halt, subsystem="MCM", at_s=time.monotonic(), at_rest=self.at_rest, performers=["RIGHT-ARM"]
        )
        return [started, rest]

    def stop(self) -> None:
        self._stop_out.send(b"")
        self.join(5)
        self._stop_out.close()
        self._context.term()

    def sentences(self) -> list[m.CommandText]:
        return [message for message in self.received if isinstance(message, m.CommandText)]


def ended(request: str, command: str, text: str = "", kind: OutcomeKind = OutcomeKind.SUCCEEDED) -> m.CommandEnded:
    return m.CommandEnded(
        seq=9, at_s=0.0, command=command, request=request, text=text, outcome=Outcome(kind=kind), took_s=0.1
    )


def obliging(message: m.ClientToBroker) -> list[object]:
    """Accepts every sentence under the number its text ends with, and ends it at once."""
    match message:
        case m.ClientHello():
            return [m.Welcome(protocol=VERSION, cluster="test", pid=1)]
        case m.CommandText(request=request, text=text):
            command = f"C-{text.split()[-1]}"
            note = m.ProgressNote(seq=1, at_s=0.0, command=command, phase=m.Phase.PARSING)
            return [m.Accepted(request=request, command=command), note, ended(request, command, text)]
        case m.StatusQuery(request=request):
            return [m.StatusReply(request=request, status=m.Status(cluster="test"))]
        case m.TraceQuery(request=request, command=command):
            refusal = Refusal(reason=RefusalReason.NAME, message=f"no command {command}")
            return [m.Declined(request=request, refusal=refusal)]
    return []


def accepting(message: m.ClientToBroker) -> list[object]:
    """Accepts, and says no more."""
    return obliging(message)[:1]


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    Settings(run_dir=str(tmp_path)).save()
    return tmp_path


@pytest.fixture
def broker(run_dir: Path) -> Iterator[SmallBroker]:
    broker = SmallBroker(run_dir, obliging)
    yield broker
    broker.stop()


def test_no_cluster_is_reported_within_a_second_with_what_to_do(tmp_path: Path, run_dir: Path) -> None:
    started_s = time.monotonic()

    with pytest.raises(NoCluster, match="rtc up -d"):
        Client(tmp_path / "nowhere")
    with pytest.raises(NoCluster, match="no longer runs; start one with: rtc up -d"):
        Client(run_dir)

    assert time.monotonic() - started_s < 1


def test_a_halt_without_a_cluster_says_what_a_client_says(tmp_path: Path, run_dir: Path) -> None:
    for directory in (tmp_path / "nowhere", run_dir):
        with pytest.raises(NoCluster) as of_client:
            Client(directory)
        done = call("halt", "--run-dir", str(directory))
        assert done.returncode == 4
        assert str(of_client.value) in done.stderr


def test_a_broker_that_listens_and_says_nothing_is_no_cluster(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, lambda message: [])
    started_s = time.monotonic()

    with pytest.raises(NoCluster, match="no broker answers"):
        Client(run_dir)

    assert time.monotonic() - started_s < 1
    broker.stop()


def test_run_gives_the_outcome_and_tells_the_progress(broker: SmallBroker, run_dir: Path) -> None:
    notes: list[m.ProgressNote] = []

    with Client(run_dir) as rtc:
        outcome = rtc.run("STOW LEFT-ARM 1", on_progress=notes.append, timeout_s=5)

    assert (outcome.command, outcome.text, outcome.outcome.kind) == ("C-1", "STOW LEFT-ARM 1", OutcomeKind.SUCCEEDED)
    assert [note.command for note in notes] == ["C-1"]
    assert broker.sentences()[0].progress


def test_bytes_that_are_no_text_travel_as_a_mark(broker: SmallBroker, run_dir: Path) -> None:
    with Client(run_dir) as rtc:
        rtc.run("GRASP MACS-\udcff")

    assert [message.text for message in broker.received if isinstance(message, m.CommandText)] == ["GRASP MACS-\ufffd"]


def test_submit_then_wait(broker: SmallBroker, run_dir: Path) -> None:
    with Client(run_dir, source="aip") as rtc:
        command = rtc.submit("STOW LEFT-ARM 7")
        outcome = command.wait(timeout_s=5)

    assert (command.number, outcome.command) == ("C-7", "C-7")
    assert broker.sentences()[0].source == "aip"


def test_sentences_and_answers_travel_together_where_the_broker_reads_arrays(run_dir: Path) -> None:
    def modern(message: m.ClientToBroker) -> list[object]:
        if isinstance(message, m.ClientHello):
            assert ARRAYS in message.abilities
            return [m.Welcome(protocol=VERSION, cluster="test", pid=1, abilities=[ARRAYS])]
        return obliging(message)

    broker = SmallBroker(run_dir, modern)
    notes: list[str] = []
    with Client(run_dir) as rtc:
        texts = [f"STOW {n}" for n in range(1, 4)]
        outcomes = rtc.run_many(texts, on_progress=lambda note: notes.append(note.command), timeout_s=5)
        assert rtc.status().cluster == "test"
    broker.stop()
    assert broker.parcels == [1, 3, 1]
    assert [outcome.text for outcome in outcomes] == texts
    assert notes == ["C-1", "C-2", "C-3"]


def test_a_broker_of_another_version_is_refused(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, lambda _: [m.Welcome(cluster="test", pid=1, protocol=VERSION + 1)])
    with pytest.raises(RequestDeclined) as declined:
        Client(run_dir)
    broker.stop()
    assert declined.value.refusal.reason is RefusalReason.VERSION
    assert {str(VERSION), str(VERSION + 1)} <= set(str(declined.value).split())


def test_a_client_that_the_broker_refuses_says_so(run_dir: Path) -> None:
    refusal = Refusal(reason=RefusalReason.VERSION, message="two versions")
    broker = SmallBroker(run_dir, lambda _: [m.Declined(request="", refusal=refusal)])
    with pytest.raises(RequestDeclined) as declined:
        Client(run_dir)
    broker.stop()
    assert declined.value.refusal == refusal


@pytest.mark.parametrize("parallel", [True, False])
def test_outcomes_come_in_the_order_of_the_sentences(run_dir: Path, parallel: bool) -> None:
    """Given a broker that ends the sentences it has in reverse order, when it has two or is asked for one at a time."""
    held: list[m.CommandText] = []

    def backwards(message: m.ClientToBroker) -> list[object]:
        if not isinstance(message, m.CommandText):
            return obliging(message)
        held.append(message)
        if parallel and len(held) < 3:
            return [m.Accepted(request=message.request, command=f"C-{len(held)}")]
        return [ended(sentence.request, f"C-{n}", sentence.text) for n, sentence in reversed(list(enumerate(held, 1)))]

    broker = SmallBroker(run_dir, backwards)
    order: list[int] = []
    with Client(run_dir) as rtc:
        outcomes = rtc.run_many(["A", "B", "C"], parallel, on_end=lambda n, _: order.append(n), timeout_s=5)

    assert [outcome.text for outcome in outcomes] == ["A", "B", "C"]
    assert sorted(order) == [0, 1, 2]
    broker.stop()


def test_a_declined_sentence_is_an_exception_of_submit_and_a_refusal_of_run(run_dir: Path) -> None:
    def full(message: m.ClientToBroker) -> list[object]:
        if isinstance(message, m.CommandText):
            return [m.Declined(request=message.request, refusal=Refusal(reason=RefusalReason.OVERLOAD, message="full"))]
        return obliging(message)

    broker = SmallBroker(run_dir, full)
    with Client(run_dir) as rtc:
        with pytest.raises(RequestDeclined, match="full"):
            rtc.submit("STOW LEFT-ARM")
        outcome = rtc.run("STOW LEFT-ARM", timeout_s=5).outcome

    assert outcome.kind == OutcomeKind.REFUSED
    assert outcome.refusal is not None
    assert outcome.refusal.reason == RefusalReason.OVERLOAD
    broker.stop()


def test_a_question_too_many_is_asked_again(run_dir: Path) -> None:
    def busy(message: m.ClientToBroker) -> list[object]:
        asked = sum(isinstance(message, m.StatusQuery) for message in broker.received)
        if isinstance(message, m.StatusQuery) and asked < 3:
            refusal = Refusal(reason=RefusalReason.OVERLOAD, message="a client may ask 100 times a second")
            return [m.Declined(request=message.request, refusal=refusal)]
        return obliging(message)

    broker = SmallBroker(run_dir, busy)
    try:
        with Client(run_dir) as rtc:
            assert rtc.status().cluster == "test"
    finally:
        broker.stop()


def test_a_command_that_does_not_end_in_time_is_reported_and_goes_on(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, accepting)
    with Client(run_dir) as rtc:
        command = rtc.submit("STOW LEFT-ARM 1")
        with pytest.raises(TimedOut, match="C-1 has not ended; it continues"):
            command.wait(timeout_s=0.05)
    broker.stop()


def test_a_new_broker_receives_the_same_requests_again(run_dir: Path) -> None:
    """Given a sentence accepted by a broker that dies, when a new one comes, then the same request reaches it."""
    first = SmallBroker(run_dir, accepting)
    with Client(run_dir) as rtc:
        command = rtc.submit("STOW LEFT-ARM 1")
        first.stop()
        second = SmallBroker(run_dir, obliging)
        outcome = command.wait(timeout_s=5)
        assert rtc.status().cluster == "test"

    assert outcome.outcome.kind == OutcomeKind.SUCCEEDED
    assert {sentence.request for sentence in second.sentences()} == {first.sentences()[0].request}
    assert first.sentences()[0].known_as == ""
    assert {sentence.known_as for sentence in second.sentences()} == {"C-1"}  # a broker that lost it must not begin it
    assert isinstance(second.received[0], m.ClientHello)
    second.stop()


def of_cluster(name: str, answer: Answer) -> Answer:
    return lambda message: (
        [m.Welcome(protocol=VERSION, cluster=name, pid=1)] if isinstance(message, m.ClientHello) else answer(message)
    )


def test_another_cluster_in_its_place_receives_nothing_of_what_was_sent_to_the_old_one(run_dir: Path) -> None:
    """Given two sentences under way, when another cluster answers in the same directory, then both are lost. Sentences
    sent afterwards do not go to it either."""
    first = SmallBroker(run_dir, of_cluster("old", accepting))
    with Client(run_dir) as rtc:
        commands = [rtc.submit("STOW LEFT-ARM 1"), rtc.submit("STOW RIGHT-ARM 2")]
        first.stop()
        second = SmallBroker(run_dir, of_cluster("new", lambda _: []))
        for command in commands:
            with pytest.raises(NoCluster, match="is gone, and another one is in its place"):
                command.wait(timeout_s=5)
        with pytest.raises(NoCluster, match="another one"):
            rtc.run("STOW LEFT-ARM 3", timeout_s=5)
    second.stop()

    assert {sentence.cluster for sentence in first.sentences()} == {"old"}
    assert not {"STOW LEFT-ARM 1", "STOW RIGHT-ARM 2"} & {sentence.text for sentence in second.sentences()}
    assert all(sentence.cluster == "old" for sentence in second.sentences())  # so that it is declined


def test_a_cluster_that_was_started_while_we_came_is_taken_as_it_is(run_dir: Path) -> None:
    """Given the settings of a run that has ended."""
    Settings(run_dir=str(run_dir), run="old").save()
    broker = SmallBroker(run_dir, of_cluster("new", obliging))
    with Client(run_dir) as rtc:
        assert rtc.run("STOW LEFT-ARM 1", timeout_s=5).command == "C-1"
    assert [sentence.cluster for sentence in broker.sentences()] == ["new"]
    broker.stop()


def test_a_sentence_waits_until_it_is_known_whom_it_is_for(run_dir: Path) -> None:
    """Given a client that has not been welcomed yet, over tcp for example, then it is not sent to just anybody."""
    broker = SmallBroker(run_dir, of_cluster("new", obliging))
    with Client(run_dir, need_broker=False) as rtc:
        assert rtc.run("STOW LEFT-ARM 1", timeout_s=5).command == "C-1"
    assert [sentence.cluster for sentence in broker.sentences()] == ["new"]
    broker.stop()


def test_a_client_of_the_same_name_has_requests_of_its_own(broker: SmallBroker, run_dir: Path) -> None:
    for _ in range(2):
        with Client(run_dir, name="planner") as rtc:
            rtc.run("STOW LEFT-ARM 1", timeout_s=5)
    assert len({sentence.request for sentence in broker.sentences()}) == 2


def test_a_wait_ends_in_time_although_the_broker_is_long_away(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Given more to repeat than a queue holds, if it were repeated all the time."""
    monkeypatch.setattr(core, "SILENCE_S", 0.01)
    broker = SmallBroker(run_dir, accepting)
    rtc = Client(run_dir)
    first = rtc.submit("STOW LEFT-ARM 1")
    broker.stop()
    over = threading.Event()

    def wait() -> None:
        with pytest.raises(TimedOut):
            first.wait(timeout_s=0.1)  # it learns that the broker is away
        with pytest.raises(TimedOut):
            rtc.run_many(["STOW LEFT-ARM"] * 500, parallel=True, timeout_s=1.0)
        over.set()

    threading.Thread(target=wait, daemon=True).start()
    assert over.wait(20)
    rtc.close()


def test_what_no_broker_would_take_is_reported_at_once(broker: SmallBroker, run_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="invalid source 'planner': it must be operator or aip"):
        Client(run_dir, source="planner")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="199 bytes; the limit is 128"):
        Client(run_dir, name="x" * 199)
    program = tmp_path / "long.yaml"
    program.write_bytes(b"#" * 150_000)
    with Client(run_dir) as rtc:
        with pytest.raises(RequestDeclined, match="150,000 bytes; the limit is 131,072"):
            rtc.load("elaborator", program)
        with pytest.raises(RequestDeclined, match=r"300,\d+ bytes, a request may have 262,144"):
            rtc.trace("C" * 300_000)
        assert rtc.run("STOW 1 " * 50_000, timeout_s=5).outcome.kind is OutcomeKind.SUCCEEDED  # by this broker
    assert [len(sentence.text) for sentence in broker.sentences()] == [4_000]  # the parser's business


def test_a_client_closes_although_its_broker_is_gone_for_good(run_dir: Path) -> None:
    """Given a repeated sentence without a receiver, then closing does not wait for one."""
    broker = SmallBroker(run_dir, accepting)
    rtc = Client(run_dir)
    command = rtc.submit("STOW LEFT-ARM 1")
    broker.stop()
    with pytest.raises(TimedOut):
        command.wait(timeout_s=2.5)  # longer than the silence after which it is repeated
    closing = threading.Thread(target=rtc.close, daemon=True)
    closing.start()
    closing.join(3)
    assert not closing.is_alive()


def test_an_unknown_command_has_no_trace(broker: SmallBroker, run_dir: Path) -> None:
    with Client(run_dir) as rtc, pytest.raises(RequestDeclined, match="no command C-99"):
        rtc.trace("c-99")


def test_a_halt_goes_to_broker_and_mcm_with_one_name(broker: SmallBroker, run_dir: Path) -> None:
    with Client(run_dir) as rtc:
        assert rtc.halt_ready()
        result = rtc.halt("right-arm")

    assert result.confirmed
    assert result.latency_s == pytest.approx(0.002)
    assert (result.scope, result.moving, result.sent_to) == ("RIGHT-ARM", ["RIGHT-ARM"], ["estop", "halt"])
    assert {name for name, _ in broker.halted} == {"halt", "estop"}
    assert {order.halt for _, order in broker.halted} == {result.halt}


@pytest.mark.parametrize("scope", UNKNOWN_SCOPES)
def test_a_halt_of_nothing_halts_all_and_says_so(broker: SmallBroker, run_dir: Path, scope: str) -> None:
    with Client(run_dir) as rtc:
        for _ in range(20):  # whichever answer comes first
            result = rtc.halt(scope)
            assert (result.scope, result.unknown, result.confirmed, result.declined) == ("ALL", scope, True, False)


def test_a_halt_of_a_command_that_has_ended_is_confirmed(run_dir: Path) -> None:
    record = m.CommandRecord(
        command=ENDED, text="", source="operator", request="r", accepted_at_s=0.0, phase=m.Phase.ENDED, notes=[]
    )
    broker = SmallBroker(
        run_dir,
        lambda query: [m.TraceReply(request=query.request, record=record)] if isinstance(query, m.TraceQuery) else [],
    )
    with Client(run_dir, need_broker=False) as rtc:
        called_at_s = time.monotonic()
        result = rtc.halt(ENDED, timeout_s=60.0)
    assert (result.confirmed, result.reached, result.declined) == (True, False, False)
    assert time.monotonic() - called_at_s < 30.0  # the broker does not answer its copy: that is awaited briefly
    broker.stop()


def test_the_halt_of_an_unknown_command_is_not_confirmed(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Given a broker that takes the halt and says no word."""
    monkeypatch.setattr(halt, "ASK_S", 0.1)
    broker = SmallBroker(run_dir, lambda _: [])
    with Client(run_dir, need_broker=False) as rtc:
        result = rtc.halt(ENDED)
    assert (result.confirmed, result.declined) == (False, False)
    broker.stop()


@pytest.mark.parametrize("timeout_s", [math.inf, math.nan, 1e300, -math.inf, -1.0, 0.0])
def test_no_number_of_seconds_keeps_a_halt_from_being_sent(
    broker: SmallBroker, run_dir: Path, timeout_s: float
) -> None:
    with Client(run_dir) as rtc:
        assert rtc.halt_ready()
        result = rtc.halt("RIGHT-ARM", timeout_s)
        assert rtc.halt().confirmed  # the next one is taken after it
    assert result.sent_to == ["estop", "halt"]
    assert result.confirmed == (not timeout_s <= 0)
    assert {order.scope for _, order in broker.halted} == {"RIGHT-ARM", "ALL"}


@pytest.mark.parametrize(
    ("sentence", "scope"),
    [("", "ALL"), (" all ", "ALL"), ("both-arms", "ALL"), ("RIGHT-END-EFF", "RIGHT-ARM"), ("c-7", "C-7")],
)
def test_the_scope_of_a_halt_is_understood_as_in_a_sentence(
    broker: SmallBroker, run_dir: Path, sentence: str, scope: str
) -> None:
    with Client(run_dir) as rtc:
        assert rtc.halt(sentence).scope == scope


@pytest.mark.parametrize("scope", ["ALL", "RIGHT-ARM", "C-99"])
def test_a_halt_that_no_one_will_confirm_is_answered_at_once(broker: SmallBroker, run_dir: Path, scope: str) -> None:
    broker.overloaded = ("halt", "estop")
    with Client(run_dir) as rtc:
        called_at_s = time.monotonic()
        result = rtc.halt(scope, timeout_s=600.0)
    assert time.monotonic() - called_at_s < 60.0
    assert (result.confirmed, result.declined) == (False, False)  # it was obeyed


@pytest.mark.parametrize("overloaded", ["halt", "estop"])
def test_a_halt_that_one_of_two_will_confirm_is_confirmed(broker: SmallBroker, run_dir: Path, overloaded: str) -> None:
    broker.overloaded = (overloaded,)
    with Client(run_dir) as rtc:
        assert rtc.halt().confirmed


@pytest.mark.parametrize(("at_rest", "why"), [(False, "has not come to rest"), (None, "has not come to rest")])
def test_a_halt_without_rest_is_not_confirmed(broker: SmallBroker, run_dir: Path, at_rest: bool, why: str) -> None:
    broker.at_rest = at_rest

    with Client(run_dir) as rtc:
        result = rtc.halt(timeout_s=0.2)

    assert not result.confirmed
    assert why in result.message  # wording: what is awaited
    assert result.latency_s is not None


def test_a_halt_works_from_another_thread_while_a_command_runs(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, accepting)
    results = []
    with Client(run_dir) as rtc:
        command = rtc.submit("STOW LEFT-ARM 1")
        other = threading.Thread(target=lambda: results.append(rtc.halt()))
        other.start()
        with pytest.raises(TimedOut):
            command.wait(timeout_s=0.1)
        other.join(5)

    assert [result.confirmed for result in results] == [True]
    broker.stop()


def ending_on_request(ends: dict[str, OutcomeKind]) -> Answer:
    """A broker whose commands end when their request is in `ends`, at the next message of the client."""
    begun: dict[str, str] = {}

    def answer(message: m.ClientToBroker) -> list[m.BrokerToClient]:
        match message:
            case m.CommandText(request=request, text=text) if text.startswith(("PAUSE", "RESUME", "ABORT")):
                number = f"C-{len(begun) + 100}"
                begun[request] = number
                done = [ended(r, begun[r], kind=kind) for r, kind in ends.items() if r in begun]
                return [m.Accepted(request=request, command=number), *done, ended(request, number, text)]
            case m.CommandText(request=request):
                number = begun.setdefault(request, f"C-{len(begun) + 1}")
                note = m.ProgressNote(seq=1, at_s=0.0, command=number, phase=m.Phase.EXECUTING, step="1 of 2: go")
                report = m.ProgressNote(
                    seq=0, at_s=0.0, command=number, phase=m.Phase.EXECUTING, kind=m.NoteKind.CONDITION
                )
                return [m.Accepted(request=request, command=number), note, report]
        return obliging(message)

    return answer


def test_a_handle_waits_shows_progress_and_raises_for_another_outcome_than_success(run_dir: Path) -> None:
    ends: dict[str, OutcomeKind] = {}
    broker = SmallBroker(run_dir, ending_on_request(ends))
    notes: list[int] = []
    with Client(run_dir) as client:
        handle = client.submit("STOW LEFT-ARM", on_progress=lambda note: notes.append(note.seq))
        client.receive_until(lambda: len(notes) == 2, 5, "no notes")
        assert (str(handle), handle.number, handle.outcome) == ("C-1", "C-1", None)
        assert handle.progress is not None
        assert (handle.progress.seq, handle.progress.step) == (1, "1 of 2: go")  # not the report
        assert "executing" in repr(handle)
        ends[broker.sentences()[0].request] = OutcomeKind.FAILED
        handle.pause(5)
        with pytest.raises(NotSucceeded, match="C-1 failed") as raised:
            handle.raise_for_outcome(5)
        assert (raised.value.command, raised.value.outcome) == ("C-1", handle.outcome)
        assert handle.wait() is handle.wait()  # as often as called
        handle.resume(5)
        handle.abort(5)
    assert [sentence.text for sentence in broker.sentences()[1:]] == ["PAUSE C-1", "RESUME C-1", "ABORT C-1"]
    broker.stop()


def test_a_handle_halts_its_own_command(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, accepting)
    with Client(run_dir) as client:
        assert client.submit("STOW LEFT-ARM 1").halt().scope == "C-1"
    broker.stop()


def test_control_of_a_command_that_is_refused_raises(run_dir: Path) -> None:
    def refusing(message: m.ClientToBroker) -> list[m.BrokerToClient]:
        match message:
            case m.CommandText(request=request, text=text) if text.startswith("PAUSE"):
                refused = ended(request, "C-9", text, OutcomeKind.REFUSED)
                return [m.Accepted(request=request, command="C-9"), refused]
        return accepting(message)

    broker = SmallBroker(run_dir, refusing)
    with Client(run_dir) as client:
        handle = client.submit("STOW LEFT-ARM 1")
        with pytest.raises(NotSucceeded):
            handle.pause(5)
        assert handle.outcome is None
    broker.stop()


def test_a_command_without_readers_asks_for_no_notes(run_dir: Path) -> None:
    broker = SmallBroker(run_dir, accepting)
    with Client(run_dir) as client:
        client.submit("STOW LEFT-ARM 1", progress=False)
    assert [sentence.progress for sentence in broker.sentences()] == [False]
    broker.stop()


def test_what_people_print_is_short(broker: SmallBroker, run_dir: Path) -> None:
    with Client(run_dir) as client:
        handle = client.submit("STOW LEFT-ARM 1 " + "X" * 2000 + " 1")
        end = handle.wait(5)
    fact = m.Fact(key="A.frame", value=[0.1] * 7, validity=m.Validity.VALID, version=3, source="C-1/4", at_s=0.0)
    long = msgspec.structs.replace(fact, value={"covariance": [0.1] * 500})
    note = m.ProgressNote(seq=1, at_s=0.0, command="C-1", phase=m.Phase.BINDING, step="1 of 2: go", node="binder@2")
    assert "1 of 2: go" in repr(note)
    for shown in map(repr, (handle, end, end.outcome, fact, long, note)):
        assert len(shown) < 200, shown
    assert "A.frame" in repr(long)


def test_what_a_user_drops_without_closing_it_does_not_stop_the_garbage_collector(tmp_path):
    code = f"""if True:
        import gc
        from rtc.client.context import ClientContext
        from rtc.client.halt import HaltLine
        from rtc.runtime.settings import Settings
        for _ in range(5):
            cycle = [HaltLine(ClientContext(), Settings(run_dir={str(tmp_path)!r}))]
            cycle.append(cycle)
            del cycle
            gc.collect()
        print("ended")
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert done.stdout == "ended\n", done.stderr
