"""The cluster from Python: sentences in, outcomes out, a halt at any time, and everything that can be looked at.

    from rtc.client import Client

    with Client() as rtc:                                   # the cluster that `rtc up -d` started
        ended = rtc.run("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
        print(ended.command, ended.outcome.kind, ended.outcome.message)

Threads: one thread uses a Client, with one exception: `halt` has its own sockets and may be called from any thread at
any time, also while another waits in `run`. A lost broker is no error: open requests are said again to the new one
under the same request name, so nothing is lost and nothing done twice. A sentence that fails is not an exception: its
`CommandEnded.outcome` says how it ended. Exceptions (see `rtc.outcomes`) are for a cluster that does not answer.
"""

from __future__ import annotations

import itertools
import os
import re
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import zmq

from rtc import messages as m
from rtc.front_door import LAST_WORDS_MS, FrontDoor
from rtc.halting import HaltLine, HaltResult
from rtc.keys import Doors, KeyFile
from rtc.language.refuse import MAX_CHARACTERS
from rtc.lifeline import Lifeline
from rtc.outcomes import (
    KeyTrouble,
    NoCluster,
    Outcome,
    OutcomeKind,
    Refusal,
    RefusalReason,
    RequestDeclined,
    TimedOut,
    WireError,
)
from rtc.settings import Settings, default_run_dir
from rtc.silence import Silence, Tell, somebody_listens, supervised
from rtc.wire import MAX_BYTES, frames, reader
from rtc.world.client import WorldClient

NAME_BYTES = 128  # of a client's name: it becomes part of other names
ANSWER_S = 5.0  # longest wait for an answer that needs no motion
LOADED_S = 40.0  # the same for a program, which is checked first
ASK_AGAIN_S = 0.2  # after the broker has said that we ask too much
WINDOW = 512  # sentences under way at once in `run_many`
KEPT = 10_000  # outcomes nobody has asked for yet
NO_TEXT = re.compile("[\ud800-\udfff]")  # what Python makes of bytes that are no text; UTF-8 cannot carry it

Source = Literal["operator", "aip"]
SOURCES = get_args(Source)
OnAccept = Callable[[int, str], None]
OnProgress = Callable[[m.ProgressNote], None]
OnEnd = Callable[[int, m.CommandEnded], None]
Answer = TypeVar("Answer")


def as_text(sentence: str) -> str:
    """The sentence as it can travel; what is no text in it is a mark that is refused at its place."""
    return NO_TEXT.sub("\ufffd", sentence)


class Client:
    """A connection to one cluster. Use it as a context manager, or call `close`.

    `run_dir` is the cluster's run directory; None = where `rtc up` puts it. Raises NoCluster, within a second, when
    nothing answers there; for a broker that is being restarted it waits some seconds. `need_broker=False` connects
    although the broker is away: halt, truth and telemetry work. `name` is a label for people, of 128 bytes at most; two
    clients may have the same. Raises ValueError for a longer one, and for a source that is none.
    `halt_if_lost`: what it has under way is halted when this process dies or stands still for some seconds.
    `key`: a key file, in place of `run_dir`, for a cluster on another machine (docs/security.md). To connect may then
    take some seconds, and what the key's role may not do is declined. Raises KeyTrouble when the file is no good.
    `on_silence` is told in words when the broker has not answered for some seconds, and when it does again; every wait
    outlasts a broker that is restarted, and raises NoCluster when the whole cluster is gone; one that takes its place
    hears nothing of what was said to it: make a new Client.
    """

    def __init__(
        self,
        run_dir: str | Path | None = None,
        *,
        name: str | None = None,
        source: Source = "operator",
        need_broker: bool = True,
        halt_if_lost: bool = False,
        key: str | Path | None = None,
        on_silence: Tell | None = None,
    ) -> None:
        if source not in SOURCES:
            raise ValueError(f"no source {source!r}: sentences come from {' or '.join(SOURCES)}")
        self.run_dir = Path(run_dir) if run_dir is not None else default_run_dir()
        self._doors: Doors = _settings_of(self.run_dir) if key is None else KeyFile.load(key)
        self._doors.endpoint("front")  # raises for a key that is no client's
        self.source: Source = source
        self._life = uuid.uuid4().hex[:8]  # the cluster remembers requests; those of another of our name are not ours
        self.name = name or f"client-{os.getpid()}"
        if (length := len(self.name.encode())) > NAME_BYTES or self.name[0] == "\0":
            raise ValueError(f"no name for a client: {length} bytes; it may have {NAME_BYTES}, and no zero in front")
        me = f"{self.name}~{self._life}"  # two clients of one name are two clients
        self._ask_number = itertools.count(1)
        self._command_of: dict[str, str] = {}  # request -> C-n
        self._request_of: dict[str, str] = {}  # C-n -> request
        self._listeners: dict[str, OnProgress] = {}  # request -> who wants its notes
        self._accept_listeners: dict[str, Callable[[str], None]] = {}
        self._ended: dict[str, m.CommandEnded] = {}  # request -> outcome that nobody has fetched yet
        self._fetched: dict[str, None] = {}  # the latest outcomes handed over, so that one told again is known
        self._queries: set[str] = set()  # requests that are questions, not sentences
        self._answers: dict[str, m.BrokerToClient] = {}  # request -> answer to a query
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._halt_line = HaltLine(self._context, self._doors)
        self._front = FrontDoor(
            self._context, self._doors, me, self._doors.run if isinstance(self._doors, Settings) else ""
        )
        self._lifeline = Lifeline(self._context, self._doors, me) if halt_if_lost else None
        self._silence = Silence(self.run_dir if key is None else None, on_silence)
        self._world: WorldClient | None = None
        if need_broker:
            try:
                self._front.knock(str(self.run_dir), self._restarting, self._silence.restarting)
            except NoCluster:
                self.close()
                raise

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of all sockets; commands go on without us."""
        if self._world is not None:
            self._world.close()
            self._world = None
        if self._lifeline is not None:
            self._lifeline.close()
        self._halt_line.close()
        self._front.close()
        self._context.destroy(linger=LAST_WORDS_MS)  # also what `events` and `telemetry` left open

    @property
    def where(self) -> str:
        """The cluster, for people: its run directory, or the address of its gate."""
        return self._doors.address if isinstance(self._doors, KeyFile) else str(self.run_dir)

    @property
    def settings(self) -> Settings:
        """Of a cluster on this machine. Raises KeyTrouble for one that is reached by a key."""
        if not isinstance(self._doors, Settings):
            raise KeyTrouble("how a cluster on another machine is made up is not told over tcp")
        return self._doors

    # --- sentences ------------------------------------------------------------------------------------

    def submit(self, text: str, *, on_progress: OnProgress | None = None) -> str:
        """Hand in one sentence; its number C-n, once the cluster has it for good. Fetch the outcome with `wait`.

        Raises RequestDeclined when the cluster takes no more.
        """
        request = self._say(text, on_progress)
        self._until(
            lambda: request in self._command_of or request in self._ended, ANSWER_S, "the sentence was not taken"
        )
        if request not in self._command_of:
            refusal = self._fetch(request).outcome.refusal
            assert refusal is not None
            raise RequestDeclined(refusal)
        return self._command_of[request]

    def wait(self, command: str, timeout_s: float | None = None) -> m.CommandEnded:
        """The outcome of a command submitted here. Raises TimedOut when it has not ended in time; it goes on."""
        request = self._request_of.get(command)
        assert request is not None, f"{command} was not submitted by this client, or its outcome was fetched already"
        self._until(lambda: request in self._ended, timeout_s, f"{command} has not ended; it goes on")
        return self._fetch(request)

    def run(
        self,
        text: str,
        on_progress: OnProgress | None = None,
        timeout_s: float | None = None,
    ) -> m.CommandEnded:
        """Submit one sentence and wait for its outcome.

        `on_progress` hears each ProgressNote; one with `seq` 0 is a report of REPORT EVERY. Raises TimedOut after
        `timeout_s`; the command then goes on.
        """
        return self.run_many([text], on_progress=on_progress, timeout_s=timeout_s)[0]

    def run_many(
        self,
        texts: Sequence[str],
        parallel: bool = True,
        *,
        on_accept: OnAccept | None = None,
        on_progress: OnProgress | None = None,
        on_end: OnEnd | None = None,
        timeout_s: float | None = None,
    ) -> list[m.CommandEnded]:
        """Outcomes in the order of `texts`. In parallel the cluster itself finds what may go on at the same time;
        otherwise each sentence waits for the end of the one before, whatever that end is.

        `on_accept(i, "C-7")` and `on_end(i, ended)` are told about sentence i. `timeout_s` is for all together.
        """
        limit_s = None if timeout_s is None else time.monotonic() + timeout_s
        ended: dict[int, m.CommandEnded] = {}
        waiting: dict[str, int] = {}
        todo = deque(enumerate(texts))
        while todo or waiting:
            while todo and len(waiting) < (WINDOW if parallel else 1):
                n, text = todo.popleft()
                waiting[self._say(text, on_progress, on_accept and partial(on_accept, n))] = n
            self._until(
                lambda: not waiting.keys().isdisjoint(self._ended),
                None if limit_s is None else limit_s - time.monotonic(),
                f"{len(waiting) + len(todo)} of {len(texts)} commands have not ended; what was sent goes on",
            )
            for request in waiting.keys() & self._ended.keys():
                n = waiting.pop(request)
                ended[n] = self._fetch(request)
                if on_end:
                    on_end(n, ended[n])
        return [ended[n] for n in range(len(texts))]

    # --- stopping -------------------------------------------------------------------------------------

    def halt(self, scope: str = "ALL", timeout_s: float = 2.0) -> HaltResult:
        """Stop motion now: ALL, an arm, or a command C-n. Goes to the broker and to the MCM at once, past everything.

        Returns when rest is confirmed or `timeout_s` has passed (`confirmed` tells). From any thread. Raises
        ClusterError when nobody could be told.
        """
        return self._halt_line.halt(scope, timeout_s)

    def halt_ready(self) -> bool:
        """True once the halt sockets of broker and MCM are both connected."""
        return self._halt_line.ready()

    # --- looking --------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Processes, workers, queues, resources, commands, subsystems, counters (see docs/protocol.md)."""
        return self._query(m.StatusQuery(request=self._next_request()), m.StatusReply).status

    def trace(self, command: str) -> m.CommandRecord:
        """A command's whole story. Raises RequestDeclined for an unknown command."""
        query = m.TraceQuery(request=self._next_request(), command=command.upper())
        return self._query(query, m.TraceReply).record

    def load(self, kind: str, file: str | Path) -> m.ProgramLoaded:
        """Put a program file into the running cluster. Raises RequestDeclined when it does not check."""
        path = Path(file)
        if (length := path.stat().st_size) > m.PROGRAM_BYTES:
            words = f"{path.name} has {length:,} bytes; a program may have {m.PROGRAM_BYTES:,}"
            raise RequestDeclined(Refusal(reason=RefusalReason.PROGRAM, message=words))
        message = m.ProgramText(
            request=self._next_request(), kind=m.WorkerKind(kind.lower()), name=path.name, body=path.read_bytes()
        )
        return self._query(message, m.ProgramLoaded, LOADED_S)

    def reset(self, kind: str) -> m.ProgramLoaded:
        """Put the default program of a kind back. Raises RequestDeclined when it does not fit the other programs."""
        message = m.ProgramText(
            request=self._next_request(), kind=m.WorkerKind(kind.lower()), name="default", body=b"", reset=True
        )
        return self._query(message, m.ProgramLoaded, LOADED_S)

    def program(self, kind: str) -> m.ProgramReply:
        """The program of a kind of worker as it is now."""
        query = m.ProgramQuery(request=self._next_request(), kind=m.WorkerKind(kind.lower()))
        return self._query(query, m.ProgramReply)

    def events(self, silence_s: float | None = None) -> Iterator[m.ProgressNote | m.CommandEnded]:
        """All that happens to all commands from now on, whoever submitted them. Disturbs nobody.

        Endless; ends when there is no news for `silence_s`, if that is given.
        """
        return self._subscribe("events", reader(m.ProgressNote | m.CommandEnded), silence_s)

    def telemetry(self, silence_s: float | None = None) -> Iterator[m.Telemetry]:
        """Joints, wrench, tcp pose and hand width of every arm, as the MCM publishes them. Ends as `events` does."""
        return self._subscribe("telemetry", reader(m.Telemetry), silence_s)

    @property
    def world(self) -> WorldClient:
        """The world database, to be read."""
        if self._world is None:
            secure = self._doors.secure if self._doors.far else None
            self._world = WorldClient(self._doors.endpoint("world"), self._context, secure=secure)
        return self._world

    # --- simulators only ------------------------------------------------------------------------------

    def truth(self) -> m.SimTruthReply:
        """Where everything really is, in the simulator."""
        return self._bench(m.SimTruth(request=self._next_request()), m.SimTruthReply)

    def displace(self, object: str, offset: Sequence[float]) -> None:
        """Move an object, with its seat, behind the cluster's back. `offset`: x y z (m) roll pitch yaw (rad), world."""
        message = m.SimDisplace(request=self._next_request(), object=object, offset=[float(v) for v in offset])
        self._tamper(message)

    def change_physics(self, mass: float = 1.0, friction: float = 1.0) -> None:
        """Make things heavier, and pads rub less, by factors of what the cell says, behind the cluster's back."""
        self._tamper(m.SimFactors(request=self._next_request(), mass=mass, friction=friction))

    def _tamper(self, message: m.SimDisplace | m.SimFactors) -> None:
        done = self._bench(message, m.SimDone)
        if done.error:
            raise RequestDeclined(Refusal(reason=RefusalReason.STATE, message=done.error))

    # --- inside ---------------------------------------------------------------------------------------

    def _next_request(self) -> str:
        return f"{self.name}/{self._life}-{next(self._ask_number)}"

    def _restarting(self) -> bool:
        return not self._doors.far and supervised(self.run_dir, by_hand=False)

    def _say(
        self,
        text: str,
        on_progress: OnProgress | None,
        on_accept: Callable[[str], None] | None = None,
    ) -> str:
        """Send one sentence; the name of the request."""
        request = self._next_request()
        if on_progress is not None:
            self._listeners[request] = on_progress
        if on_accept is not None:
            self._accept_listeners[request] = on_accept
        sentence = m.CommandText(
            request=request,
            text=as_text(text)[: 2 * MAX_CHARACTERS],  # too long for the parser, which says so, and not for the door
            source=self.source,
            progress=on_progress is not None,
            halt_if_lost=self._lifeline is not None,
            sent_at_s=time.monotonic(),  # said again after a halt it is still what was said before it
        )
        self._front.ask(request, sentence)
        return request

    def _until(self, done: Callable[[], bool], timeout_s: float | None, otherwise: str) -> None:
        """Hear messages until `done`. Raises TimedOut, saying `otherwise`."""
        limit_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not done():
            left_s = 3600.0 if limit_s is None else limit_s - time.monotonic()
            if left_s <= 0:
                raise TimedOut(f"{otherwise} (waited {timeout_s:.1f} s)")
            if (message := self._front.hear(left_s)) is not None:
                self._take(message)
            self._silence.judge(self._front.unanswered, self._front.replaced)
            if shut_out := self._front.shut_out:
                raise NoCluster(shut_out)

    def _take(self, message: m.BrokerToClient) -> None:
        match message:
            case m.Accepted(request=request, command=command):
                if request not in self._command_of:  # a second Accepted answers a repeated sentence
                    self._command_of[request] = command
                    self._request_of[command] = request
                    if tell := self._accept_listeners.pop(request, None):
                        tell(command)
            case m.ProgressNote(command=command):
                if listener := self._listeners.get(self._request_of.get(command, "")):
                    listener(message)
            case m.CommandEnded(request=request):
                self._keep_outcome(request, message)
            case m.Declined(request=request, refusal=refusal) if request in self._queries:
                self._answers[request] = message
            case m.Declined(request=request, refusal=refusal):
                self._keep_outcome(request, _never_taken(request, refusal))
            case m.StatusReply() | m.TraceReply() | m.ProgramLoaded() | m.ProgramReply():
                if message.request in self._queries:
                    self._answers[message.request] = message

    def _keep_outcome(self, request: str, ended: m.CommandEnded) -> None:
        if request in self._fetched:
            return  # told twice, after a reconnect
        self._ended[request] = ended
        while len(self._ended) > KEPT:
            self._fetch(next(iter(self._ended)))

    def _fetch(self, request: str) -> m.CommandEnded:
        """Hand over an outcome and forget all about its command."""
        self._listeners.pop(request, None)
        self._accept_listeners.pop(request, None)
        self._request_of.pop(self._command_of.pop(request, ""), None)
        self._fetched[request] = None
        while len(self._fetched) > KEPT:
            del self._fetched[next(iter(self._fetched))]
        return self._ended.pop(request)

    def _query(self, message: Any, answer: type[Answer], within_s: float = ANSWER_S) -> Answer:
        """Ask, and ask again for a while when we have asked more than the broker answers a client in a second."""
        request, limit_s = message.request, time.monotonic() + within_s
        self._queries.add(request)
        try:
            while True:
                self._front.ask(request, message)
                self._until(lambda: request in self._answers, within_s, "the broker did not answer")
                found = self._answers.pop(request)
                overload = isinstance(found, m.Declined) and found.refusal.reason is RefusalReason.OVERLOAD
                if not overload or time.monotonic() > limit_s:
                    return _expect(found, answer)
                self._hear_for(ASK_AGAIN_S)
        finally:
            self._queries.discard(request)
            self._front.forget(request)

    def _hear_for(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            if (message := self._front.hear(left_s)) is not None:
                self._take(message)

    def _bench(self, message: m.ToSim, answer: type[Answer]) -> Answer:
        """Ask the simulator. A socket for one question: tests and demos ask seldom."""
        read = reader(m.FromSim)
        with self._context.socket(zmq.DEALER) as bench:
            bench.setsockopt(zmq.LINGER, 0)
            bench.connect(self._doors.endpoint("bench"))
            bench.send_multipart(frames(message))
            if not bench.poll(int(ANSWER_S * 1000)):
                raise TimedOut(f"the simulator did not answer within {ANSWER_S:.0f} s")
            return _expect(read(bench.recv_multipart()), answer)

    def _subscribe(
        self, endpoint: str, read: Callable[[Sequence[bytes]], Answer], silence_s: float | None
    ) -> Iterator[Answer]:
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_BYTES)
        socket.subscribe(b"")
        self._doors.secure(socket)
        socket.connect(self._doors.endpoint(endpoint))
        return _each(socket, read, silence_s)


def _each(
    socket: zmq.Socket[bytes], read: Callable[[Sequence[bytes]], Answer], silence_s: float | None
) -> Iterator[Answer]:
    limit_ms = None if silence_s is None else int(silence_s * 1000)
    with socket:
        while socket.poll(limit_ms):
            try:
                yield read(socket.recv_multipart())
            except WireError:
                continue  # newer than we are


def _settings_of(run_dir: Path) -> Settings:
    """The cluster's settings. Raises NoCluster at once when nobody can be listening in `run_dir`."""
    try:
        settings = Settings.load(run_dir)
    except (FileNotFoundError, NotADirectoryError):
        raise NoCluster(f"no cluster in {run_dir}; start one with: rtc up -d") from None
    except PermissionError:
        raise NoCluster(f"the cluster in {run_dir} belongs to another user; choose another --run-dir") from None
    if not somebody_listens(run_dir, ("front", "estop")):
        raise NoCluster(f"the cluster in {run_dir} is not running any more; start one with: rtc up -d")
    return settings


def _expect(message: object, kind: type[Answer]) -> Answer:
    if isinstance(message, m.Declined):
        raise RequestDeclined(message.refusal)
    assert isinstance(message, kind), f"expected {kind.__name__}, got {message!r}"
    return message


def _never_taken(request: str, refusal: Refusal) -> m.CommandEnded:
    """A sentence that did not even become a command ends as a refusal too, so that callers look in one place."""
    outcome = Outcome(kind=OutcomeKind.REFUSED, message=refusal.message, refusal=refusal)
    return m.CommandEnded(seq=0, at_s=time.monotonic(), command="", request=request, text="", outcome=outcome, took_s=0)
