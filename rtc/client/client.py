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

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import zmq

from rtc.client.core import ANSWER_S, Answer, OnProgress, Query, SubmittedCommand, expect
from rtc.client.hand_controller import HandController
from rtc.client.handle import CommandHandle, OnChange
from rtc.client.rehearsing import NO_TEST, AboutTest, rehearse
from rtc.client.session import ClientSession
from rtc.client.subscription import subscribe
from rtc.programs import whole_file
from rtc.protocol import messages as m
from rtc.protocol.faults import AnyFault
from rtc.protocol.outcomes import Refusal, RefusalReason, RequestDeclined, TimedOut
from rtc.protocol.wire import frames, reader
from rtc.world.client import WorldClient

LOADED_S = 40.0  # longest wait for a program, which the cluster checks first
WINDOW = 512  # maximum number of sentences in progress in `run_many`

OnAccept = Callable[[int, str], None]
OnEnd = Callable[[int, m.CommandEnded], None]


class Client(ClientSession):
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

    _world: WorldClient | None = None

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all sockets. Commands in progress continue."""
        if self._world is not None:
            self._world.close()
            self._world = None
        super().close()

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
        handle.raise_if_declined()
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
        about = AboutTest(if_tested=if_tested, after_test=after_test, label=label)
        wanted = progress or on_progress is not None
        self.send(handle, progress=wanted, traceparent=traceparent, about=about, saved=saved)
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
        todo, open_ = deque(enumerate(texts)), 0
        done: dict[int, m.CommandEnded] = {}  # and not yet passed on
        while todo or open_:
            while todo and open_ < (WINDOW if parallel else 1):
                n, text = todo.popleft()
                sentence = text if isinstance(text, str) else text()
                accepted = on_accept and partial(on_accept, n)
                command = SubmittedCommand(sentence, on_progress, accepted, partial(done.__setitem__, n))
                self.send(command, progress=on_progress is not None, traceparent=traceparent, about=about)
                open_ += 1
            self.receive_until(
                lambda: done,
                None if limit_s is None else limit_s - time.monotonic(),
                f"{open_ + len(todo)} of {len(texts)} commands have not ended; those submitted continue",
            )
            for n in list(done):
                ended[n] = done.pop(n)
                open_ -= 1
                if on_end:
                    on_end(n, ended[n])
        return [ended[n] for n in range(len(texts))]

    def test(
        self, texts: Sequence[str], labels: Sequence[str] = (), *, keep_going: bool = False
    ) -> list[m.CommandEnded]:
        """Test sentences on paper: nothing moves, and nothing is written (`rtc.client.rehearsing`)."""
        return rehearse(self, texts, labels, keep_going=keep_going)

    # --- looking --------------------------------------------------------------------------------------

    def status(self, within_s: float = ANSWER_S) -> m.Status:
        """Processes, workers, queues, resources, commands, subsystems, counters (see docs/protocol.md). Raises TimedOut
        if the broker has not answered within this time."""
        return self._query(m.StatusQuery(request=self.next_request()), m.StatusReply, within_s).status

    def trace(self, command: str) -> m.CommandRecord:
        """The record of a command. Raises RequestDeclined for an unknown command."""
        query = m.TraceQuery(request=self.next_request(), command=command.upper())
        return self._query(query, m.TraceReply).record

    def load(self, kind: str, file: str | Path) -> m.ProgramLoaded:
        """Load a program file into the running cluster. Raises RequestDeclined if it is invalid."""
        path = Path(file)
        return self._query(self.program_text(kind, path.name, path.read_bytes()), m.ProgramLoaded, LOADED_S)

    def load_sections(self, file: str | Path) -> list[m.ProgramLoaded]:
        """Load a file with a section for each kind of worker (docs/scripts.md): all of them, or none. Raises
        ProgramError for a file of another form, and RequestDeclined."""
        path = Path(file)
        before = {kind: self.program(kind).digest for kind in m.WorkerKind}
        loaded: list[m.ProgramLoaded] = []
        try:
            for kind, text in whole_file.sections(path.read_bytes(), path.name).items():
                message = self.program_text(kind, path.name, text)
                loaded.append(self._query(message, m.ProgramLoaded, LOADED_S))
        except RequestDeclined:
            for done in reversed(loaded):
                self.reset(done.kind, before[done.kind], path.name)
            raise
        return loaded

    def reset(self, kind: str, to: str = "", file: str = "default") -> m.ProgramLoaded:
        """Restore the default program of a kind, or the one with the digest `to`, which came from `file`. Raises
        RequestDeclined if it does not fit the other programs, or if the kind has not used it."""
        message = m.ProgramText(
            request=self.next_request(), kind=m.WorkerKind(kind.lower()), name=file, body=b"", reset=True, to=to
        )
        return self._query(message, m.ProgramLoaded, LOADED_S)

    def set_breakpoints(self, breakpoints: list[m.Breakpoint]) -> list[m.Breakpoint]:
        """Replace all breakpoints; returns those in force. A command pauses before such a step.

        Raises RequestDeclined for a verb of no sentence, and a step that no command can reach."""
        query = m.SetBreakpoints(request=self.next_request(), breakpoints=breakpoints)
        return self._query(query, m.Debugged).breakpoints

    def step(self, command: str) -> None:
        """Let a command that is paused between two steps perform one. Raises RequestDeclined if it is not paused."""
        self._query(m.StepCommand(request=self.next_request(), command=command.upper()), m.Debugged)

    def program(self, kind: str) -> m.ProgramReply:
        """The current program of a kind of worker."""
        query = m.ProgramQuery(request=self.next_request(), kind=m.WorkerKind(kind.lower()))
        return self._query(query, m.ProgramReply)

    def cell(self) -> bytes:
        """The document of the cluster's cell, which contains all texts; `Cell.load` reads it from a file."""
        return self._query(m.ProgramQuery(request=self.next_request()), m.ProgramReply).body

    def events(self, silence_s: float | None = None) -> Iterator[m.ProgressNote | m.CommandEnded]:
        """Progress and ends of all commands of all clients, from now on.

        Endless, unless `silence_s` is given: then it ends after that time without a message.
        """
        return subscribe(self.context, self.endpoints, "events", reader(m.ProgressNote | m.CommandEnded), silence_s)

    def telemetry(self, silence_s: float | None = None) -> Iterator[m.Telemetry]:
        """Joints, wrench, tcp pose and hand width of every arm, as the MCM publishes them. Ends as `events` does."""
        return subscribe(self.context, self.endpoints, "telemetry", reader(m.Telemetry), silence_s)

    def hand(self, arm: str, operator: str = "OPERATOR") -> HandController:
        """The stream of an operator's hand to a granted arm. Use it as a context manager. Over tcp it needs the
        key of an operator; what has seen nothing of the arm for 200 ms does nothing. Raises KeyTrouble for another
        key, ClusterError without telemetry of this arm."""
        return HandController(self.context, self.endpoints, arm, operator, self.round_trip_s)

    @property
    def world(self) -> WorldClient:
        """Read access to the world database."""
        if self._world is None:
            secure = self.endpoints.secure if self.far else None
            self._world = WorldClient(
                self.endpoints.endpoint("world"), self.context, secure=secure, round_trip_s=self.round_trip_s
            )
        return self._world

    # --- simulators only ------------------------------------------------------------------------------

    def truth(self) -> m.SimTruthReply:
        """True poses in the simulator."""
        return self._ask_simulator(m.SimTruth(request=self.next_request()), m.SimTruthReply)

    def displace(self, object: str, offset: Sequence[float]) -> None:
        """Move an object and its seat in the simulator only. `offset`: x y z (m) roll pitch yaw (rad), world axes."""
        message = m.SimDisplace(request=self.next_request(), object=object, offset=[float(v) for v in offset])
        self._tamper(message)

    def change_physics(self, mass: float = 1.0, friction: float = 1.0) -> None:
        """Scale the cell's masses and the friction of finger pads in the simulator only."""
        self._tamper(m.SimFactors(request=self.next_request(), mass=mass, friction=friction))

    def inject(self, fault: AnyFault) -> m.SimDone:
        """Inject a fault in the simulator. Raises RequestDeclined with the reason."""
        return self._tamper(m.SimInject(request=self.next_request(), fault=fault))

    def undo_fault(self, name: str = "ALL") -> m.SimDone:
        """Undo an injected fault by its name, or all. Raises RequestDeclined with the reason."""
        return self._tamper(m.SimUndo(request=self.next_request(), fault=name))

    def _tamper(self, message: m.SimDisplace | m.SimFactors | m.SimInject | m.SimUndo) -> m.SimDone:
        done = self._ask_simulator(message, m.SimDone)
        if done.error:
            raise RequestDeclined(Refusal(reason=RefusalReason.STATE, message=done.error))
        return done

    # --- inside ---------------------------------------------------------------------------------------

    def receive(self) -> None:
        """Take the messages that have arrived, without waiting; callbacks are called."""
        while self.connection.step(0.0):
            pass

    def receive_until(self, done: Callable[[], object], timeout_s: float | None, otherwise: str) -> None:
        """Receive messages until `done`. Raises TimedOut with the text `otherwise`."""
        limit_s = None if timeout_s is None else time.monotonic() + timeout_s
        while not done():
            left_s = 3600.0 if limit_s is None else limit_s - time.monotonic()
            if left_s <= 0:
                raise TimedOut(f"{otherwise} (waited {timeout_s:.1f} s)")
            self.connection.step(left_s)
            self.core.check()

    def _query(self, message: Any, answer: type[Answer], within_s: float = ANSWER_S) -> Answer:
        query = Query(message, answer, within_s)
        self.core.ask(query, time.monotonic())
        try:
            limit_s = within_s + self.round_trip_s
            self.receive_until(lambda: query.answer is not None, limit_s, "the broker did not answer")
            return query.result
        finally:
            self.core.forget(query)

    def _ask_simulator(self, message: m.ToSim, answer: type[Answer]) -> Answer:
        """Send a request to the simulator, over a socket of its own: such requests are rare."""
        read = reader(m.FromSim)
        with self.context.socket(zmq.DEALER) as bench:
            bench.setsockopt(zmq.LINGER, 0)
            bench.connect(self.endpoints.endpoint("bench"))
            bench.send_multipart(frames(message))
            if not bench.poll(int(ANSWER_S * 1000)):
                raise TimedOut(f"the simulator did not answer within {ANSWER_S:.0f} s")
            return expect(read(bench.recv_multipart()), answer)
