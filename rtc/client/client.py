"""Python client of a cluster: submit sentences, fetch outcomes, halt, and read status, traces and the world.

    from rtc import Client

    with Client() as client:                                # the cluster that `rtc up -d` started
        ended = client.run("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
        print(ended.command, ended.outcome.kind, ended.outcome.message)
        lift = client.submit("LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")  # its handle: wait, halt, pause, progress
        lift.raise_for_outcome()

Threads: only one thread may use a Client. The exception is `halt`: it has its own sockets, and any thread may call it
at any time, also while another waits in `run`. A lost broker is not an error. Open requests are sent again to the new
one under the same request name, so none is lost or done twice. A failed sentence does not raise: see its
`CommandEnded.outcome`, or call its `raise_for_outcome`. Other exceptions (see `rtc.protocol.outcomes`) mean that the
cluster does not answer.
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
from typing import Any, Literal, get_args

import zmq

from rtc.client.connection import LAST_WORDS_MS, BrokerConnection
from rtc.client.context import ClientContext
from rtc.client.halt import HaltLine, HaltResult, OnRest
from rtc.client.hand_controller import HandController
from rtc.client.handle import CommandHandle, OnChange
from rtc.client.heartbeat import HeartbeatSender
from rtc.client.liveness import BrokerLiveness, Report, is_listening, not_running
from rtc.client.rehearsing import NO_TEST, AboutTest, rehearse
from rtc.client.requests import Answer, OnEnded, OnProgress, Requests, expect
from rtc.client.subscription import subscribe
from rtc.language.refuse import MAX_CHARACTERS
from rtc.programs import whole_file
from rtc.protocol import messages as m
from rtc.protocol.faults import AnyFault
from rtc.protocol.outcomes import (
    KeyTrouble,
    NoCluster,
    Refusal,
    RefusalReason,
    RequestDeclined,
    TimedOut,
)
from rtc.protocol.traceparent import with_traceparent
from rtc.protocol.wire import frames, reader
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import Settings, default_run_dir
from rtc.world.client import WorldClient

NAME_BYTES = 128  # maximum length of a client's name; it becomes part of other names
ANSWER_S = 5.0  # longest wait for an answer that needs no motion
LOADED_S = 40.0  # the same for a program, which the cluster checks first
REST_S = 2.0  # wait for the rest of what was halted
ASK_AGAIN_S = 0.2  # pause after the broker declined a query for overload
WINDOW = 512  # maximum number of sentences in progress in `run_many`
NO_TEXT = re.compile("[\ud800-\udfff]")  # lone surrogates, made by Python of undecodable bytes; not valid in UTF-8

Source = Literal["operator", "aip"]
SOURCES = get_args(Source)
OnAccept = Callable[[int, str], None]
OnEnd = Callable[[int, m.CommandEnded], None]


def as_text(sentence: str) -> str:
    """The sentence as valid UTF-8; undecodable characters become U+FFFD, which the parser refuses at its place."""
    return NO_TEXT.sub("\ufffd", sentence)


class Client:
    """A connection to one cluster. Use it as a context manager, or call `close`.

    `run_dir`: the cluster's run directory; None = the default of `rtc up`.
    `name`: a label for people, at most 128 bytes; two clients may have the same name.
    `need_broker=False`: connect although the broker is absent; halt, truth and telemetry then work.
    `halt_if_lost`: the cluster halts this client's commands if this process dies or hangs for some seconds.
    `key`: a key file, in place of `run_dir`, for a cluster on another machine (docs/security.md). Connecting may take
    some seconds, and the cluster declines what the key's role may not do.
    `on_silence`: called with a message when the broker has not answered for some seconds, and when it answers again.

    Raises NoCluster, within a second, if no broker answers; if its supervisor lives, the client waits some seconds for
    the restart. Raises KeyTrouble for an invalid key file, ValueError for an invalid name or source. Every wait
    outlasts a restart of the broker. If the cluster is gone or another one has taken over the run directory, waits
    raise NoCluster; create a new Client. RequestDeclined: the cluster speaks another version of the protocol.
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
        on_silence: Report | None = None,
    ) -> None:
        if source not in SOURCES:
            raise ValueError(f"invalid source {source!r}: it must be {' or '.join(SOURCES)}")
        self.run_dir = Path(run_dir) if run_dir is not None else default_run_dir()
        self._endpoints: Endpoints = running_settings(self.run_dir) if key is None else KeyFile.load(key)
        self._endpoints.endpoint("front")  # raises if the key's role is not that of a client
        self.source: Source = source
        self._life = uuid.uuid4().hex[:8]  # keeps our requests apart from those of another client with this name
        self.name = name or f"client-{os.getpid()}"
        if (length := len(self.name.encode())) > NAME_BYTES or self.name[0] == "\0":
            raise ValueError(f"invalid client name: {length} bytes; the limit is {NAME_BYTES}, the first must not be 0")
        me = f"{self.name}~{self._life}"  # unique, although two clients may have one name
        self._ask_number = itertools.count(1)
        self._requests = Requests()
        self._context = ClientContext()
        self._halt_line = HaltLine(self._context, self._endpoints)
        self._connection = BrokerConnection(
            self._context, self._endpoints, me, self._endpoints.run if isinstance(self._endpoints, Settings) else ""
        )
        self._heartbeat = HeartbeatSender(self._context, self._endpoints, me) if halt_if_lost else None
        self._liveness = BrokerLiveness(self.run_dir if key is None else None, on_silence, halt_if_lost)
        self._world: WorldClient | None = None
        if need_broker:
            try:
                self._connection.connect(str(self.run_dir), self._restarting, self._liveness.restarting)
            except (NoCluster, RequestDeclined):
                self.close()
                raise

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all sockets. Commands in progress continue."""
        if self._world is not None:
            self._world.close()
            self._world = None
        if self._heartbeat is not None:
            self._heartbeat.close()
        self._halt_line.close()
        self._connection.close()
        self._context.destroy(linger=LAST_WORDS_MS)  # also closes the sockets of `events` and `telemetry`

    @property
    def context(self) -> ClientContext:
        """The ZeroMQ context of its sockets."""
        return self._context

    @property
    def endpoints(self) -> Endpoints:
        """The addresses of the cluster."""
        return self._endpoints

    def wake_by(self, descriptor: int) -> None:
        """`receive_until` also looks again when this eventfd has been written."""
        self._connection.wake_by(descriptor)

    @property
    def where(self) -> str:
        """The cluster, for people: its run directory, or the address of its gateway."""
        return self._endpoints.address if isinstance(self._endpoints, KeyFile) else str(self.run_dir)

    @property
    def settings(self) -> Settings:
        """Settings of a cluster on this machine. Raises KeyTrouble for a cluster that is reached by a key."""
        if not isinstance(self._endpoints, Settings):
            raise KeyTrouble("the settings of a cluster on another machine are not available over tcp")
        return self._endpoints

    @property
    def far(self) -> bool:
        """Whether the cluster is reached over tcp, by a key."""
        return bool(self._endpoints.far)

    @property
    def round_trip_s(self) -> float:
        """To the broker and back, over tcp (s); 0 on the cluster's machine. Waits for answers are longer by it."""
        return self._connection.round_trip_s

    # --- sentences ------------------------------------------------------------------------------------

    def submit(
        self,
        text: str,
        *,
        on_progress: OnProgress | None = None,
        progress: bool = True,
        traceparent: str = "",
        if_tested: str = "",
        saved: m.SavedWorld | None = None,
    ) -> CommandHandle:
        """Submit one sentence; its handle, after the cluster has journalled it.

        `on_progress` receives each ProgressNote, as in `run`. `progress=False`: the cluster sends none, and REPORT
        EVERY and WHEN are refused; for a client that does not wait. `traceparent`: a W3C trace context, below which
        `rtc observe --otlp` puts the trace of the command. `if_tested`: as in `run`. `saved`: facts of a file, for SET
        WORLD FACTS SAVED.

        Raises RequestDeclined if the cluster does not accept it.
        """
        handle = self.begin(
            text, on_progress=on_progress, progress=progress, traceparent=traceparent, if_tested=if_tested, saved=saved
        )
        self.receive_until(lambda: handle.answered, ANSWER_S + self.round_trip_s, "the sentence was not accepted")
        if not handle.number:
            refusal = handle.wait().outcome.refusal
            assert refusal is not None
            raise RequestDeclined(refusal)
        return handle

    def begin(
        self,
        text: str,
        *,
        on_progress: OnProgress | None = None,
        on_change: OnChange | None = None,
        progress: bool = True,
        traceparent: str = "",
        if_tested: str = "",
        after_test: str = "",
        label: str = "",
        saved: m.SavedWorld | None = None,
    ) -> CommandHandle:
        """Send one sentence and do not wait: its handle has no number yet. `on_change` is called, while messages are
        received, when it has got one, and when it has ended: also when it was not accepted. The rest as in `run`."""
        handle = CommandHandle(self, text, on_progress, on_change)
        noted = handle.take_note if progress or on_progress is not None else None
        about = AboutTest(if_tested=if_tested, after_test=after_test, label=label)
        self._submit(text, noted, handle.take_number, traceparent, handle.take_end, about, saved)
        return handle

    def run(
        self,
        text: str,
        on_progress: OnProgress | None = None,
        timeout_s: float | None = None,
        *,
        traceparent: str = "",
        if_tested: str = "",
        after_test: str = "",
        label: str = "",
    ) -> m.CommandEnded:
        """Submit one sentence and wait for its outcome.

        `on_progress` receives each ProgressNote; `seq` 0 marks a report of EVERY or WHEN. `if_tested`: digest of a test
        of this sentence; it is refused if what that rests on has changed. `after_test`, `label`: of a TEST sentence,
        see `test`. Raises TimedOut after `timeout_s`; the command then continues.
        """
        about = AboutTest(if_tested=if_tested, after_test=after_test, label=label)
        return self.run_many(
            [text], on_progress=on_progress, timeout_s=timeout_s, traceparent=traceparent, about=about
        )[0]

    def run_many(
        self,
        texts: Sequence[str | Callable[[], str]],
        parallel: bool = True,
        *,
        on_accept: OnAccept | None = None,
        on_progress: OnProgress | None = None,
        on_end: OnEnd | None = None,
        timeout_s: float | None = None,
        traceparent: str = "",
        about: AboutTest = NO_TEST,
    ) -> list[m.CommandEnded]:
        """Submit sentences and wait; outcomes in the order of `texts`.

        `parallel`: submit all at once; the cluster runs those that need different resources at the same time. Otherwise
        each sentence is submitted when the one before has ended. `on_accept(i, "C-7")` and `on_end(i, ended)` are
        called for sentence i. `timeout_s` is for all together. A function among `texts` is called when its sentence is
        to be sent, and returns it: it may name a command that was accepted before. `about`: what `run` states of a
        test.
        """
        limit_s = None if timeout_s is None else time.monotonic() + timeout_s
        ended: dict[int, m.CommandEnded] = {}
        waiting: dict[str, int] = {}
        todo = deque(enumerate(texts))
        while todo or waiting:
            while todo and len(waiting) < (WINDOW if parallel else 1):
                n, text = todo.popleft()
                sentence = text if isinstance(text, str) else text()
                request = self._submit(
                    sentence, on_progress, on_accept and partial(on_accept, n), traceparent, about=about
                )
                waiting[request] = n
            self.receive_until(
                lambda: not waiting.keys().isdisjoint(self._requests.ended),
                None if limit_s is None else limit_s - time.monotonic(),
                f"{len(waiting) + len(todo)} of {len(texts)} commands have not ended; those submitted continue",
            )
            for request in waiting.keys() & self._requests.ended.keys():
                n = waiting.pop(request)
                ended[n] = self._requests.fetch(request)
                if on_end:
                    on_end(n, ended[n])
        return [ended[n] for n in range(len(texts))]

    def test(
        self, texts: Sequence[str], labels: Sequence[str] = (), *, keep_going: bool = False
    ) -> list[m.CommandEnded]:
        """Test sentences on paper: nothing moves, and nothing is written (`rtc.client.rehearsing`)."""
        return rehearse(self, texts, labels, keep_going=keep_going)

    # --- stopping -------------------------------------------------------------------------------------

    def halt(self, scope: str = "ALL", timeout_s: float | None = None, on_rest: OnRest | None = None) -> HaltResult:
        """Stop motion now: ALL, an arm, or a command C-n. The order goes to broker and MCM at once, past all queues.

        Returns when rest is confirmed (`confirmed`) or `timeout_s` has passed: None is 2 s, and over tcp the round trip
        in addition. `on_rest` is called at once with a subsystem that has come to rest while others have not, and the
        names of these. Any thread may call it. Raises ClusterError if neither broker nor MCM could be reached.
        """
        round_trip_s = self.round_trip_s
        limit_s = REST_S + round_trip_s if timeout_s is None else timeout_s
        return self._halt_line.halt(scope, limit_s, round_trip_s, on_rest)

    def halt_ready(self) -> bool:
        """True once the halt sockets of broker and MCM are both connected."""
        return self._halt_line.ready()

    # --- looking --------------------------------------------------------------------------------------

    def status(self, within_s: float = ANSWER_S) -> m.Status:
        """Processes, workers, queues, resources, commands, subsystems, counters (see docs/protocol.md). Raises TimedOut
        if the broker has not answered within this time."""
        return self._query(m.StatusQuery(request=self._next_request()), m.StatusReply, within_s).status

    def trace(self, command: str) -> m.CommandRecord:
        """The record of a command. Raises RequestDeclined for an unknown command."""
        query = m.TraceQuery(request=self._next_request(), command=command.upper())
        return self._query(query, m.TraceReply).record

    def load(self, kind: str, file: str | Path) -> m.ProgramLoaded:
        """Load a program file into the running cluster. Raises RequestDeclined if it is invalid."""
        path = Path(file)
        return self._load(m.WorkerKind(kind.lower()), path.name, path.read_bytes())

    def load_sections(self, file: str | Path) -> list[m.ProgramLoaded]:
        """Load a file with a section for each kind of worker (docs/scripts.md): all of them, or none. Raises
        ProgramError for a file of another form, and RequestDeclined."""
        path = Path(file)
        before = {kind: self.program(kind).digest for kind in m.WorkerKind}
        loaded: list[m.ProgramLoaded] = []
        try:
            for kind, text in whole_file.sections(path.read_bytes(), path.name).items():
                loaded.append(self._load(kind, path.name, text))
        except RequestDeclined:
            for done in reversed(loaded):
                self.reset(done.kind, before[done.kind], path.name)
            raise
        return loaded

    def _load(self, kind: m.WorkerKind, name: str, text: bytes) -> m.ProgramLoaded:
        if len(text) > m.PROGRAM_BYTES:
            words = f"{name} has {len(text):,} bytes; the limit is {m.PROGRAM_BYTES:,}"
            raise RequestDeclined(Refusal(reason=RefusalReason.PROGRAM, message=words))
        message = m.ProgramText(request=self._next_request(), kind=kind, name=name, body=text)
        return self._query(message, m.ProgramLoaded, LOADED_S)

    def reset(self, kind: str, to: str = "", file: str = "default") -> m.ProgramLoaded:
        """Restore the default program of a kind, or the one with the digest `to`, which came from `file`. Raises
        RequestDeclined if it does not fit the other programs, or if the kind has not used it."""
        message = m.ProgramText(
            request=self._next_request(), kind=m.WorkerKind(kind.lower()), name=file, body=b"", reset=True, to=to
        )
        return self._query(message, m.ProgramLoaded, LOADED_S)

    def set_breakpoints(self, breakpoints: list[m.Breakpoint]) -> list[m.Breakpoint]:
        """Replace all breakpoints; returns those in force. A command pauses before such a step.

        Raises RequestDeclined for a verb of no sentence, and a step that no command can reach."""
        query = m.SetBreakpoints(request=self._next_request(), breakpoints=breakpoints)
        return self._query(query, m.Debugged).breakpoints

    def step(self, command: str) -> None:
        """Let a command that is paused between two steps perform one. Raises RequestDeclined if it is not paused."""
        self._query(m.StepCommand(request=self._next_request(), command=command.upper()), m.Debugged)

    def program(self, kind: str) -> m.ProgramReply:
        """The current program of a kind of worker."""
        query = m.ProgramQuery(request=self._next_request(), kind=m.WorkerKind(kind.lower()))
        return self._query(query, m.ProgramReply)

    def cell(self) -> bytes:
        """The document of the cluster's cell, which contains all texts; `Cell.load` reads it from a file."""
        return self._query(m.ProgramQuery(request=self._next_request()), m.ProgramReply).body

    def events(self, silence_s: float | None = None) -> Iterator[m.ProgressNote | m.CommandEnded]:
        """Progress and ends of all commands of all clients, from now on.

        Endless, unless `silence_s` is given: then it ends after that time without a message.
        """
        return subscribe(self._context, self._endpoints, "events", reader(m.ProgressNote | m.CommandEnded), silence_s)

    def telemetry(self, silence_s: float | None = None) -> Iterator[m.Telemetry]:
        """Joints, wrench, tcp pose and hand width of every arm, as the MCM publishes them. Ends as `events` does."""
        return subscribe(self._context, self._endpoints, "telemetry", reader(m.Telemetry), silence_s)

    def hand(self, arm: str, operator: str = "OPERATOR") -> HandController:
        """The stream of an operator's hand to an arm that he has. Use it as a context manager. Over tcp it needs the
        key of an operator; what has seen nothing of the arm for 200 ms does nothing. Raises KeyTrouble for another
        key, ClusterError without telemetry of this arm."""
        return HandController(self._context, self._endpoints, arm, operator, self.round_trip_s)

    @property
    def world(self) -> WorldClient:
        """Read access to the world database."""
        if self._world is None:
            secure = self._endpoints.secure if self.far else None
            self._world = WorldClient(
                self._endpoints.endpoint("world"), self._context, secure=secure, round_trip_s=self.round_trip_s
            )
        return self._world

    # --- simulators only ------------------------------------------------------------------------------

    def truth(self) -> m.SimTruthReply:
        """True poses in the simulator."""
        return self._ask_simulator(m.SimTruth(request=self._next_request()), m.SimTruthReply)

    def displace(self, object: str, offset: Sequence[float]) -> None:
        """Move an object and its seat in the simulator only. `offset`: x y z (m) roll pitch yaw (rad), world axes."""
        message = m.SimDisplace(request=self._next_request(), object=object, offset=[float(v) for v in offset])
        self._tamper(message)

    def change_physics(self, mass: float = 1.0, friction: float = 1.0) -> None:
        """Scale the cell's masses and the friction of finger pads in the simulator only."""
        self._tamper(m.SimFactors(request=self._next_request(), mass=mass, friction=friction))

    def inject(self, fault: AnyFault) -> m.SimDone:
        """Inject a fault in the simulator. Raises RequestDeclined with the reason."""
        return self._tamper(m.SimInject(request=self._next_request(), fault=fault))

    def undo_fault(self, name: str = "ALL") -> m.SimDone:
        """Undo an injected fault by its name, or all. Raises RequestDeclined with the reason."""
        return self._tamper(m.SimUndo(request=self._next_request(), fault=name))

    def _tamper(self, message: m.SimDisplace | m.SimFactors | m.SimInject | m.SimUndo) -> m.SimDone:
        done = self._ask_simulator(message, m.SimDone)
        if done.error:
            raise RequestDeclined(Refusal(reason=RefusalReason.STATE, message=done.error))
        return done

    # --- inside ---------------------------------------------------------------------------------------

    def _next_request(self) -> str:
        return f"{self.name}/{self._life}-{next(self._ask_number)}"

    def _restarting(self) -> bool:
        return not self.far and supervised(self.run_dir, by_hand=False)

    def _submit(
        self,
        text: str,
        on_progress: OnProgress | None,
        on_accept: Callable[[str], None] | None = None,
        traceparent: str = "",
        on_ended: OnEnded | None = None,
        about: AboutTest = NO_TEST,
        saved: m.SavedWorld | None = None,
    ) -> str:
        """Send one sentence; returns the name of the request. Raises ValueError for an invalid trace context."""
        request = self._next_request()
        if traceparent:
            request = with_traceparent(request, traceparent)
        self._requests.watch(request, on_progress, on_accept, on_ended)
        sentence = m.CommandText(
            request=request,
            text=as_text(text)[: 2 * MAX_CHARACTERS],  # cut for the wire; still refused by the parser
            source=self.source,
            progress=on_progress is not None,
            halt_if_lost=self._heartbeat is not None,
            saved=saved,
            sent_at_s=time.monotonic(),  # a repeat after a halt keeps this time, so that the halt covers it
            if_tested=about.if_tested,
            after_test=about.after_test,
            label=about.label,
        )
        self._connection.send(request, sentence)
        return request

    def receive(self) -> None:
        """Take the messages that have arrived, without waiting; callbacks are called."""
        while (message := self._connection.recv(0.0)) is not None:
            self._requests.take(message)

    def receive_until(self, done: Callable[[], object], timeout_s: float | None, otherwise: str) -> None:
        """Receive messages until `done`. Raises TimedOut with the text `otherwise`."""
        limit_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not done():
            left_s = 3600.0 if limit_s is None else limit_s - time.monotonic()
            if left_s <= 0:
                raise TimedOut(f"{otherwise} (waited {timeout_s:.1f} s)")
            if (message := self._connection.recv(left_s)) is not None:
                self._requests.take(message)
            self._liveness.check(self._connection.unanswered, self._connection.replaced, self._connection.lost)
            if key_refused := self._connection.key_refused:
                raise NoCluster(key_refused)
            if self._connection.refused is not None:
                raise RequestDeclined(self._connection.refused)

    def _query(self, message: Any, answer: type[Answer], within_s: float = ANSWER_S) -> Answer:
        """Send a query; repeat it for `within_s` while the broker declines it for overload."""
        within_s += self.round_trip_s
        request, limit_s = message.request, time.monotonic() + within_s
        self._requests.queries.add(request)
        try:
            while True:
                self._connection.send(request, message)
                self.receive_until(lambda: request in self._requests.answers, within_s, "the broker did not answer")
                found = self._requests.answers.pop(request)
                overload = isinstance(found, m.Declined) and found.refusal.reason is RefusalReason.OVERLOAD
                if not overload or time.monotonic() > limit_s:
                    return expect(found, answer)
                self._receive_for(ASK_AGAIN_S)
        finally:
            self._requests.queries.discard(request)
            self._connection.forget(request)

    def _receive_for(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            if (message := self._connection.recv(left_s)) is not None:
                self._requests.take(message)

    def _ask_simulator(self, message: m.ToSim, answer: type[Answer]) -> Answer:
        """Send a request to the simulator, over a socket of its own: such requests are rare."""
        read = reader(m.FromSim)
        with self._context.socket(zmq.DEALER) as bench:
            bench.setsockopt(zmq.LINGER, 0)
            bench.connect(self._endpoints.endpoint("bench"))
            bench.send_multipart(frames(message))
            if not bench.poll(int(ANSWER_S * 1000)):
                raise TimedOut(f"the simulator did not answer within {ANSWER_S:.0f} s")
            return expect(read(bench.recv_multipart()), answer)


def running_settings(run_dir: Path) -> Settings:
    """The cluster's settings. Raises NoCluster at once if no process listens in `run_dir`."""
    try:
        settings = Settings.load(run_dir)
    except (FileNotFoundError, NotADirectoryError):
        raise not_running(run_dir) from None
    except PermissionError:
        raise NoCluster(f"the cluster in {run_dir} belongs to another user; choose another --run-dir") from None
    if not is_listening(run_dir, ("front", "estop")):
        raise not_running(run_dir)
    return settings
