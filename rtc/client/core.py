"""The client without I/O: what it sends, what the answers mean, and when it gives up. It has no clock and no socket.

A shell passes in the time, the frames that it received and the changes of its connection; it sends the frames of
`frames_to_send` and waits no longer than `wait_s`. So both clients and the simulated cluster follow the same rules.
Over TCP the hello identifies the client to the gateway, so it is sent first on every new connection and after a long
pause.

Rule 1: a request is forgotten only after its last answer (for a sentence: `CommandEnded`), so that all open requests
can be sent again to a new broker. Rule 2: repeating is harmless, because the broker identifies a request by (client,
request). Rule 3: requests are repeated only to a broker of the same cluster, according to its Welcome. Requests that
act carry the cluster's name, because ZeroMQ may deliver a message for one broker to the next.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from rtc.client.liveness import BrokerLiveness
from rtc.protocol import messages as m
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import (
    NoCluster,
    Outcome,
    OutcomeKind,
    Refusal,
    RefusalReason,
    RequestDeclined,
    WireError,
)
from rtc.protocol.versions import ARRAYS, VERSION, misfit
from rtc.protocol.wire import frames, reader_of_many, together

HELLO_S, REMOTE_HELLO_S = 0.8, 3.0  # time limit of the first Welcome, local and over tcp
SLOW_HELLO_S = 45.0  # the same over a slow link, whose handshake takes four round trips
RESTART_S = 10.0  # the same while the supervisor lives and restarts the broker
LOOK_S = 0.2  # period of checking that the supervisor lives
FAR_IDLE_S = 60.0  # after this pause the hello is repeated, because a gateway forgets idle clients
SILENCE_S = 2.0  # without a message for this long, the broker is probed
ANSWER_S = 5.0  # longest wait for an answer that needs no motion
ASK_AGAIN_S = 0.2  # pause after the broker declined a query for overload
ACTS = (m.CommandText, m.ProgramText)  # only for the cluster that they were submitted to

OnProgress = Callable[[m.ProgressNote], None]
Answer = TypeVar("Answer")

_read = reader_of_many(m.BrokerToClient)


class SubmittedCommand:
    """One sentence as far as the client knows it. `number`: C-n, once accepted. The callbacks are called when messages
    are taken: for each note, with the number, and with the end, also if the sentence was not accepted."""

    def __init__(
        self,
        text: str,
        on_progress: OnProgress | None = None,
        on_accept: Callable[[str], object] | None = None,
        on_end: Callable[[m.CommandEnded], object] | None = None,
    ) -> None:
        self.text = text
        self.number = ""
        self.latest_note: m.ProgressNote | None = None  # without reports of EVERY and WHEN
        self.known_end: m.CommandEnded | None = None
        self._on_progress, self._on_accept, self._on_end = on_progress, on_accept, on_end

    @property
    def answered(self) -> bool:
        """It is accepted or declined."""
        return bool(self.number) or self.known_end is not None

    def raise_if_declined(self) -> None:
        """Raises RequestDeclined if it has ended without a number."""
        if self.known_end is not None and not self.number:
            refusal = self.known_end.outcome.refusal
            assert refusal is not None
            raise RequestDeclined(refusal)

    def take_number(self, number: str) -> None:
        """Once: a second Accepted answers a repeated sentence."""
        if not self.number:
            self.number = number
            if self._on_accept is not None:
                self._on_accept(number)

    def take_note(self, note: m.ProgressNote) -> None:
        if note.seq:
            self.latest_note = note
        if self._on_progress is not None:
            self._on_progress(note)

    def take_end(self, ended: m.CommandEnded) -> None:
        self.known_end = ended
        if self._on_end is not None:
            self._on_end(ended)


class Query(Generic[Answer]):
    """A request with one answer. It is repeated, for `within_s`, while the broker declines it for overload."""

    def __init__(
        self,
        message: Any,
        kind: type[Answer],
        within_s: float = ANSWER_S,
        on_answer: Callable[[], object] | None = None,
    ) -> None:
        self.message, self.within_s, self.on_answer = message, within_s, on_answer
        self.answer: m.BrokerToClient | None = None
        self.limit_s = math.inf
        self.again_at_s = math.inf  # when it is to be sent again
        self._kind = kind

    @property
    def result(self) -> Answer:
        """Raises RequestDeclined for a refusal."""
        return expect(self.answer, self._kind)


class Connection(Protocol):
    """What the core reads of its connection: see `rtc.runtime.link.Link`."""

    is_up: bool
    handshakes: int
    key_refused: bool

    @property
    def lost(self) -> bool: ...
    @property
    def is_slow(self) -> bool: ...
    def diagnose(self) -> str: ...


class ClientCore:
    """One client and its broker. `cluster`: the run that is meant; "" = the first that sends a Welcome. `far`: over
    tcp. `longest`: bytes that the broker accepts in a request."""

    def __init__(
        self, name: str, link: Connection, liveness: BrokerLiveness, now_s: float, cluster: str, far: bool, longest: int
    ) -> None:
        self.welcome: m.Welcome | None = None
        self.round_trip_s = 0.0  # of the latest hello and its Welcome over tcp: limits of waits are longer by it
        self._name, self._link, self._liveness = name, link, liveness
        self._cluster, self._far, self._longest = cluster, far, longest
        self._began_s = self._received_at_s = self._sent_at_s = now_s
        self._hellos: deque[float] = deque()  # when they were sent, of those without a Welcome
        self._replaced = False  # another cluster has taken the place of ours: nothing is sent to it
        self._refused: Refusal | None = None  # of our hello, or of the broker's: another version of the protocol
        self._unanswered = 0  # number of probes without an answer
        self._open: dict[str, m.ClientToBroker] = {}  # request -> message, until its last answer
        self._commands: dict[str, SubmittedCommand] = {}  # by request
        self._numbered: dict[str, SubmittedCommand] = {}  # by C-n
        self._queries: dict[str, Query[Any]] = {}
        self._resend = False  # send all open requests again after the next Welcome
        self._frames: list[list[bytes]] = []  # not sent yet
        self._parts: list[msgspec.Raw] = []  # requests that are sent together, after the frames
        self._received: deque[m.BrokerToClient] = deque()
        self._send_hello(now_s)

    # --- requests -------------------------------------------------------------------------------------

    def submit(self, command: SubmittedCommand, sentence: m.CommandText, now_s: float) -> None:
        """Send a sentence. Raises RequestDeclined for one that is too long."""
        self._send(sentence, now_s)
        self._commands[sentence.request] = command

    def ask(self, query: Query[Any], now_s: float) -> None:
        """Send a query; `forget` it in the end. Raises RequestDeclined for one that is too long."""
        query.limit_s = now_s + query.within_s + self.round_trip_s
        self._send(query.message, now_s)
        self._queries[query.message.request] = query

    def forget(self, query: Query[Any]) -> None:
        """Stop waiting for its answer."""
        self._queries.pop(query.message.request, None)
        self._open.pop(query.message.request, None)

    # --- what a shell passes in -----------------------------------------------------------------------

    def receive(self, parts: Sequence[bytes], now_s: float) -> None:
        """Frames of the broker; each message in them is handled by one `take_next`."""
        self._received_at_s, self._unanswered = now_s, 0
        with contextlib.suppress(WireError):
            self._received.extend(_read(parts))

    def take_next(self, now_s: float) -> bool:
        """Handle one received message; False if there was none. Callbacks are called."""
        if self._replaced or not self._received:
            return False
        self._take(self._received.popleft(), now_s)
        return True

    def connected(self, now_s: float) -> None:
        """The connection has been established."""
        waiting, self._hellos = len(self._hellos), deque()
        if self._link.handshakes > 1:
            self._probe(now_s)  # a new broker, or the old one again: messages in transit may be lost
        elif waiting:
            self._hellos.append(now_s)  # it waited for the connection

    def tick(self, now_s: float) -> None:
        """Probe a broker that is silent, and repeat queries. To be called after each wait."""
        if self._open and now_s - self._received_at_s > SILENCE_S + self.round_trip_s:
            self._received_at_s = now_s
            self._unanswered += 1
            self._probe(now_s)
        for query in self._queries.values():
            if now_s >= query.again_at_s:
                query.again_at_s = math.inf
                self._send(query.message, now_s)

    # --- what a shell does ----------------------------------------------------------------------------

    def frames_to_send(self) -> list[list[bytes]]:
        """The frames to send now, in this order; each is given once."""
        found, self._frames = self._frames, []
        if self._parts:
            found += together(self._parts)
            self._parts.clear()
        return found

    def queue_is_full(self) -> None:
        """Frames could not be sent: all open requests are sent again after the next Welcome."""
        self._resend = True

    def wait_s(self, now_s: float) -> float:
        """Longest time until `tick` is due; infinite if nothing is, 0 if nothing can come any more."""
        if self._replaced:
            return 0.0
        due_s = min((query.again_at_s for query in self._queries.values()), default=math.inf)
        if self._open:
            due_s = min(due_s, self._received_at_s + SILENCE_S + self.round_trip_s)
        return max(0.0, due_s - now_s)

    def hello_wait_s(self, now_s: float) -> float:
        """How long to wait now for the first Welcome. Raises NoCluster if the broker does not answer in time,
        RequestDeclined if it speaks another version."""
        self._raise_if_refused()
        waited_s = now_s - self._began_s
        left_s = (REMOTE_HELLO_S if self._far else HELLO_S) - waited_s
        if left_s <= 0 and self._far and self._link.is_slow:
            left_s = SLOW_HELLO_S - waited_s
        if self._far and left_s <= 0:
            raise NoCluster(self._link.diagnose())
        if left_s <= 0 and waited_s < RESTART_S and self._liveness.is_restarting():
            left_s = LOOK_S
        if left_s <= 0:
            raise self._liveness.no_answer()
        return left_s

    def check(self) -> None:
        """To be called while something is awaited. Raises NoCluster if no process is left that could answer or if the
        key is refused, RequestDeclined if the broker speaks another version."""
        self._liveness.check(self._unanswered, self._replaced, self._far and self._link.lost)
        self._raise_if_refused()

    # --- inside ---------------------------------------------------------------------------------------

    def _send(self, message: Any, now_s: float) -> None:
        """Send a request and keep it open until its last answer. Raises RequestDeclined for one that is too long."""
        parts = self._frames_of(message)
        if self._far and now_s - self._sent_at_s > FAR_IDLE_S:
            self._send_hello(now_s)
        if not self._open:
            self._received_at_s = now_s  # silence begins with the question
        self._open[message.request] = message
        if isinstance(message, ACTS) and self.welcome is None and not self._cluster:
            self._resend = True  # sent after the Welcome: it names the cluster
        else:
            self._enqueue(parts, now_s)

    def _raise_if_refused(self) -> None:
        if self._link.key_refused:
            raise NoCluster(self._link.diagnose())
        if self._refused is not None:
            raise RequestDeclined(self._refused)

    def _enqueue(self, parts: list[bytes], now_s: float) -> None:
        self._sent_at_s = now_s
        if self.welcome is not None and ARRAYS in self.welcome.abilities:
            self._parts.append(msgspec.Raw(parts[-1]))
        else:
            self._frames.append(parts)

    def _frames_of(self, message: Any) -> list[bytes]:
        """The frames of a request. Raises RequestDeclined if it is longer than a broker accepts."""
        if isinstance(message, ACTS):
            message = msgspec.structs.replace(message, cluster=self._cluster)
        parts = frames(message)
        if len(parts[-1]) > self._longest:  # a longer frame would disconnect us at each repeat
            words = f"too long: {len(parts[-1]):,} bytes, a request may have {self._longest:,}"
            raise RequestDeclined(Refusal(reason=RefusalReason.SENTENCE, message=words))
        return parts

    def _send_hello(self, now_s: float) -> None:
        self._hellos.append(now_s)
        self._sent_at_s = now_s
        self._frames.append(frames(m.ClientHello(client=self._name, at_s=now_s, protocol=VERSION, abilities=[ARRAYS])))

    def _probe(self, now_s: float) -> None:
        """Send a hello; its Welcome makes us repeat all open requests. Without a connection this waits for the next."""
        self._resend = True
        if self._link.is_up:
            self._send_hello(now_s)

    def _take(self, message: m.BrokerToClient, now_s: float) -> None:
        match message:
            case m.ProgressNote(command=number):
                if (command := self._numbered.get(number)) is not None:
                    command.take_note(message)
            case m.Accepted():
                self._take_number(message)
            case m.CommandEnded(request=request):
                self._take_end(request, message)
            case m.Welcome():
                self._take_welcome(message, now_s)
            case m.Declined(request="", refusal=refusal) if refusal.reason is RefusalReason.VERSION:
                self._refused = refusal
            case m.Declined(request=request, refusal=refusal) if request not in self._queries:
                self._take_end(request, _as_refused(request, refusal, now_s))
            case _:
                self._take_answer(message, now_s)

    def _take_number(self, accepted: m.Accepted) -> None:
        """A repeated sentence carries its number, so that a broker that has lost it does not begin it again."""
        command, sentence = self._commands.get(accepted.request), self._open.get(accepted.request)
        if isinstance(sentence, m.CommandText) and not sentence.known_as:
            self._open[accepted.request] = msgspec.structs.replace(sentence, known_as=accepted.command)
        if command is not None:
            self._numbered[accepted.command] = command
            command.take_number(accepted.command)

    def _take_end(self, request: str, ended: m.CommandEnded) -> None:
        """A repeated end, after a reconnect, changes nothing."""
        self._open.pop(request, None)
        if (command := self._commands.pop(request, None)) is not None:
            self._numbered.pop(command.number, None)
            command.take_end(ended)

    def _take_answer(self, answer: Any, now_s: float) -> None:
        self._open.pop(answer.request, None)
        if (query := self._queries.get(answer.request)) is None:
            return
        overload = isinstance(answer, m.Declined) and answer.refusal.reason is RefusalReason.OVERLOAD
        if overload and now_s + ASK_AGAIN_S < query.limit_s:
            query.again_at_s = now_s + ASK_AGAIN_S
            return
        query.answer = answer
        if query.on_answer is not None:
            query.on_answer()

    def _take_welcome(self, welcome: m.Welcome, now_s: float) -> None:
        if words := misfit("this cluster", welcome.protocol, "this program"):
            clears = by_person("use the version of rtc that the cluster was started with")
            self._refused = Refusal(reason=RefusalReason.VERSION, message=words, clears=clears)
            return
        if self._hellos and self._far:
            self.round_trip_s = now_s - self._hellos.popleft()
        another = self._cluster not in ("", welcome.cluster)
        if another and (
            self.welcome is not None or self._open
        ):  # without open requests, the cluster may have been started during our first hello
            self._replaced = True
            self._open.clear()
            return
        self._cluster, self.welcome = welcome.cluster, welcome
        if self._resend:
            self._resend = False
            for message in self._open.values():
                self._enqueue(self._frames_of(message), now_s)


def expect(message: object, kind: type[Answer]) -> Answer:
    """The message, which must be of this kind. Raises RequestDeclined for a refusal."""
    if isinstance(message, m.Declined):
        raise RequestDeclined(message.refusal)
    assert isinstance(message, kind), f"expected {kind.__name__}, got {message!r}"
    return message


def _as_refused(request: str, refusal: Refusal, now_s: float) -> m.CommandEnded:
    """The outcome of a sentence that did not become a command: a refusal, so that callers handle one type."""
    outcome = Outcome(kind=OutcomeKind.REFUSED, message=refusal.message, refusal=refusal)
    return m.CommandEnded(seq=0, at_s=now_s, command="", request=request, text="", outcome=outcome, took_s=0)
