"""The client without I/O: frames, states of its connection and times in; frames, callbacks and errors out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from rtc.client import core
from rtc.client.core import ClientCore, Query, SubmittedCommand
from rtc.client.liveness import BrokerLiveness
from rtc.protocol import messages as m
from rtc.protocol.outcomes import (
    NoCluster,
    Outcome,
    OutcomeKind,
    Refusal,
    RefusalReason,
    RequestDeclined,
    RtcError,
)
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.protocol.wire import frames, reader_of_many, together

LONGEST = 4_000
read = reader_of_many(m.ClientToBroker)


@dataclass
class Line:
    """The state of a connection."""

    is_up: bool = True
    handshakes: int = 1
    key_refused: bool = False
    lost: bool = False
    is_slow: bool = False

    def diagnose(self) -> str:
        return "diagnosed"


@dataclass
class Conversation:
    """A core at a time, and what it has sent. `alive`: the supervisor lives."""

    far: bool = False
    cluster: str = ""
    alive: bool = True
    now_s: float = 100.0
    line: Line = field(default_factory=Line)
    reports: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        liveness = BrokerLiveness("here", None if self.far else lambda _: self.alive, self.reports.append)
        self.core = ClientCore("me", self.line, liveness, self.now_s, self.cluster, self.far, LONGEST)

    def sent(self) -> list[m.ClientToBroker]:
        return [message for parts in self.core.frames_to_send() for message in read(parts)]

    def take(self, *messages: m.BrokerToClient) -> None:
        for parts in together(messages):
            self.core.receive(parts, self.now_s)
        while self.core.take_next(self.now_s):
            pass

    def welcome(self, cluster: str = "ours", *abilities: str) -> None:
        self.take(m.Welcome(protocol=VERSION, cluster=cluster, pid=1, abilities=list(abilities)))

    def submit(self, request: str, text: str = "STOW") -> SubmittedCommand:
        command = SubmittedCommand(text)
        self.core.submit(command, m.CommandText(request=request, text=text, sent_at_s=self.now_s), self.now_s)
        return command

    def after(self, seconds: float) -> None:
        self.now_s += seconds
        self.core.tick(self.now_s)


def welcomed(**how: object) -> Conversation:
    talk = Conversation(**how)  # type: ignore[arg-type]
    talk.welcome()
    talk.sent()
    return talk


def end(request: str, command: str = "C-1") -> m.CommandEnded:
    done = Outcome(kind=OutcomeKind.SUCCEEDED)
    return m.CommandEnded(seq=9, at_s=0.0, command=command, request=request, text="", outcome=done, took_s=0.1)


def declined(request: str, reason: RefusalReason) -> m.Declined:
    return m.Declined(request=request, refusal=Refusal(reason=reason, message="no"))


def test_the_hello_is_first_and_a_sentence_waits_until_its_cluster_is_known() -> None:
    talk = Conversation()
    talk.submit("r1")
    assert [type(message) for message in talk.sent()] == [m.ClientHello]
    talk.welcome("ours")
    (sentence,) = talk.sent()
    assert isinstance(sentence, m.CommandText)
    assert sentence.cluster == "ours"


def test_a_query_does_not_wait_for_the_welcome() -> None:
    talk = Conversation()
    talk.core.ask(Query(m.StatusQuery(request="q"), m.StatusReply), talk.now_s)
    assert [type(message) for message in talk.sent()] == [m.ClientHello, m.StatusQuery]


def test_requests_travel_together_only_to_a_broker_that_reads_arrays() -> None:
    for abilities, frames_sent in (([], 3), ([ARRAYS], 1)):
        talk = Conversation()
        talk.welcome("ours", *abilities)
        talk.sent()
        for n in range(3):
            talk.submit(f"r{n}")
        assert len(talk.core.frames_to_send()) == frames_sent
        assert talk.core.frames_to_send() == []  # each once


def test_the_callbacks_of_a_command_are_called_once_each() -> None:
    talk = welcomed()
    called: list[object] = []
    command = SubmittedCommand("STOW", called.append, called.append, called.append)
    talk.core.submit(command, m.CommandText(request="r", text="STOW", sent_at_s=0.0), talk.now_s)
    note = m.ProgressNote(seq=1, at_s=0.0, command="C-1", phase=m.Phase.PARSING)
    accepted = m.Accepted(request="r", command="C-1")
    talk.take(accepted, accepted, note, end("r"), end("r"), note)  # repeated after a reconnect
    assert called == ["C-1", note, end("r")]
    assert (command.number, command.latest_note, command.known_end) == ("C-1", note, end("r"))
    assert talk.core.wait_s(talk.now_s) > 1e9  # nothing is open


def test_a_report_is_no_progress() -> None:
    talk = welcomed()
    command = talk.submit("r")
    report = m.ProgressNote(seq=0, at_s=0.0, command="C-1", phase=m.Phase.EXECUTING, kind=m.NoteKind.CONDITION)
    talk.take(m.Accepted(request="r", command="C-1"), report)
    assert command.latest_note is None


def test_a_declined_sentence_ends_without_a_number() -> None:
    talk = welcomed()
    command = talk.submit("r")
    talk.take(declined("r", RefusalReason.OVERLOAD))
    assert command.answered
    assert command.known_end is not None
    assert command.known_end.outcome.kind is OutcomeKind.REFUSED
    with pytest.raises(RequestDeclined) as raised:
        command.raise_if_declined()
    assert raised.value.refusal.reason is RefusalReason.OVERLOAD


def test_a_new_broker_receives_what_is_open_with_the_number_that_it_had() -> None:
    talk = welcomed()
    for n in (1, 2, 3):
        talk.submit(f"r{n}")
    talk.take(*(m.Accepted(request=f"r{n}", command=f"C-{n}") for n in (1, 2)), end("r1"))
    talk.sent()
    talk.line.handshakes = 2
    talk.core.connected(talk.now_s)
    assert [type(message) for message in talk.sent()] == [m.ClientHello]
    talk.welcome()
    again = [(s.request, s.known_as) for s in talk.sent() if isinstance(s, m.CommandText)]
    assert again == [("r2", "C-2"), ("r3", "")]


def test_the_first_connection_repeats_nothing() -> None:
    talk = welcomed()
    talk.submit("r")
    talk.sent()
    talk.core.connected(talk.now_s)
    assert talk.sent() == []


def test_what_did_not_fit_into_the_queue_is_sent_after_the_next_welcome() -> None:
    talk = welcomed()
    talk.submit("r")
    talk.sent()
    talk.core.queue_is_full()
    talk.welcome()
    assert [type(message) for message in talk.sent()] == [m.CommandText]


def test_another_cluster_receives_nothing_and_every_wait_ends() -> None:
    talk = welcomed()
    command = talk.submit("r")
    talk.sent()
    talk.welcome("another")
    talk.take(end("r"))
    assert talk.sent() == []
    assert command.known_end is None
    assert talk.core.wait_s(talk.now_s) == 0.0
    with pytest.raises(NoCluster):
        talk.core.check()


def test_a_cluster_that_was_started_during_the_first_hello_is_taken_as_it_is() -> None:
    talk = Conversation(cluster="old")
    talk.welcome("new")
    talk.core.check()
    talk.sent()
    talk.submit("r")
    assert [s.cluster for s in talk.sent() if isinstance(s, m.CommandText)] == ["new"]


@pytest.mark.parametrize(
    "answer",
    [
        m.Welcome(protocol=VERSION + 1, cluster="ours", pid=1),
        declined("", RefusalReason.VERSION),
    ],
)
def test_another_version_is_refused_by_version(answer: m.BrokerToClient) -> None:
    talk = Conversation()
    talk.take(answer)
    for wait in (talk.core.check, lambda: talk.core.hello_wait_s(talk.now_s)):
        with pytest.raises(RequestDeclined) as raised:
            wait()
        assert raised.value.refusal.reason is RefusalReason.VERSION


def test_a_query_that_is_declined_for_overload_is_asked_again_until_its_limit() -> None:
    talk = welcomed()
    query = Query(m.StatusQuery(request="q"), m.StatusReply, within_s=0.5)
    talk.core.ask(query, talk.now_s)
    asked = 0
    while query.answer is None:
        asked += len(talk.sent())
        talk.take(declined("q", RefusalReason.OVERLOAD))
        if query.answer is None:
            assert talk.core.wait_s(talk.now_s) == pytest.approx(core.ASK_AGAIN_S)
            talk.after(core.ASK_AGAIN_S)
    assert asked == 3
    with pytest.raises(RequestDeclined):
        _ = query.result


def test_an_answer_that_comes_after_its_wait_changes_nothing() -> None:
    talk = welcomed()
    query = Query(m.StatusQuery(request="q"), m.StatusReply)
    talk.core.ask(query, talk.now_s)
    talk.core.forget(query)
    talk.take(m.StatusReply(request="q", status=m.Status(cluster="ours")))
    assert query.answer is None


def test_a_request_that_no_broker_takes_is_declined_and_not_kept() -> None:
    talk = welcomed()
    with pytest.raises(RequestDeclined):
        talk.submit("r", "X" * LONGEST)
    assert talk.sent() == []
    assert talk.core.wait_s(talk.now_s) > 1e9


def test_silence_is_probed_and_reported_and_its_end_too() -> None:
    talk = welcomed()
    talk.submit("r")
    talk.sent()
    talk.after(core.SILENCE_S - 0.1)
    assert talk.sent() == []
    for _ in range(2):
        talk.after(core.SILENCE_S + 0.1)
        talk.core.check()
        assert [type(message) for message in talk.sent()] == [m.ClientHello]
    assert len(talk.reports) == 1
    talk.welcome()
    talk.core.check()
    assert len(talk.reports) == 2
    assert [type(message) for message in talk.sent()] == [m.CommandText]


def test_silence_of_a_client_that_waits_for_nothing_is_none() -> None:
    talk = welcomed()
    talk.after(100 * core.SILENCE_S)
    assert talk.sent() == []
    talk.submit("r")
    talk.sent()
    talk.after(core.SILENCE_S - 0.1)
    assert talk.sent() == []  # it begins with the question


def test_a_probe_waits_for_a_connection() -> None:
    talk = welcomed()
    talk.submit("r")
    talk.sent()
    talk.line.is_up = False
    talk.after(core.SILENCE_S + 0.1)
    assert talk.sent() == []


def test_a_silent_broker_whose_supervisor_has_ended_ends_the_wait() -> None:
    talk = welcomed()
    talk.submit("r")
    talk.alive = False
    talk.core.check()
    talk.after(core.SILENCE_S + 0.1)
    with pytest.raises(NoCluster):
        talk.core.check()


@pytest.mark.parametrize(
    ("talk", "limit_s"),
    [
        (Conversation(alive=False), core.HELLO_S),
        (Conversation(), core.RESTART_S),
        (Conversation(far=True), core.REMOTE_HELLO_S),
        (Conversation(far=True, line=Line(is_slow=True)), core.SLOW_HELLO_S),
    ],
    ids=["no supervisor", "restart", "far", "slow"],
)
def test_the_first_welcome_is_awaited_for_its_time(talk: Conversation, limit_s: float) -> None:
    began_s = talk.now_s

    def wait() -> None:
        for _ in range(100):
            talk.after(0.001 + talk.core.hello_wait_s(talk.now_s))

    with pytest.raises(NoCluster):
        wait()
    assert limit_s <= talk.now_s - began_s <= limit_s + core.LOOK_S
    assert len(talk.reports) == (limit_s == core.RESTART_S)


def test_a_refused_key_ends_the_wait_at_once() -> None:
    talk = Conversation(far=True)
    talk.line.key_refused = True
    waits: list[Callable[[], object]] = [talk.core.check, lambda: talk.core.hello_wait_s(talk.now_s)]
    for wait in waits:
        with pytest.raises(RtcError):
            wait()


def test_limits_are_longer_by_the_round_trip_of_a_far_cluster() -> None:
    talk = Conversation(far=True)
    talk.after(0.3)
    talk.welcome()
    assert talk.core.round_trip_s == pytest.approx(0.3)
    talk.sent()
    talk.submit("r")
    talk.sent()
    talk.after(core.SILENCE_S + 0.2)
    assert talk.sent() == []
    talk.after(0.2)
    assert [type(message) for message in talk.sent()] == [m.ClientHello]


def test_a_far_client_says_hello_again_after_a_long_pause() -> None:
    talk = welcomed(far=True)
    talk.after(core.FAR_IDLE_S + 1)
    talk.submit("r")
    assert [type(message) for message in talk.sent()] == [m.ClientHello, m.CommandText]


def test_frames_that_are_no_message_change_nothing() -> None:
    talk = welcomed()
    command = talk.submit("r")
    talk.core.receive([b"RTC1", b"\xc1"], talk.now_s)
    talk.core.receive(frames("text"), talk.now_s)
    assert not talk.core.take_next(talk.now_s)
    assert not command.answered
