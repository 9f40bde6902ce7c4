"""Times one turn of the real broker's loop, alone in this process, by what it reads and sends.

The router, journal and sockets are real. This process also has the sockets of a client, a subsystem and the workers,
and passes a number of commands together from stage to stage. So each turn has events of one kind, and their number and
the number of messages are known. The time of a turn is processor time of its thread; the I/O thread is counted apart.
"""

from __future__ import annotations

import os
import secrets
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import msgspec
import zmq

from benchmarks.hypercube.costs import EVENTS
from benchmarks.hypercube.fit import fitted, medians, ratios
from benchmarks.load.subsystem import Instant
from benchmarks.load.trivial import FUNCTIONS, PERFORMERS, SUBSYSTEM, performer
from broker.__main__ import RANK, _first_programs
from broker.decisions.command.termination import ENDED_KEPT, FORGOTTEN_AT_ONCE
from broker.decisions.effects import DispatchJob
from broker.decisions.state import State
from broker.dispatch.autoscaler import Autoscaler
from broker.dispatch.worker_registry import WorkerRegistry
from broker.persistence.journal import Journal
from broker.persistence.program_store import ProgramStore
from broker.router.core import Core
from broker.router.loop import SNAPSHOT_EVENTS, Router
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind
from rtc.protocol.versions import ARRAYS, VERSION
from rtc.runtime.handover import Handover
from rtc.runtime.priority import real_time
from rtc.runtime.process import Every, Process, freeze_heap, open_socket
from rtc.runtime.settings import Settings, prepare_run_dir
from rtc.world.lease import KEY_BYTES

STAGES = EVENTS  # kinds of events, in order
FEATURES = ("turn", "message_in", "message_out", *STAGES)
TOGETHER = (1, 2, 4, 8, 16, 32, 48)  # commands in one turn, of quick workers: one message
APART = (1, 2, 4, 8, 16)  # of slow workers: one message each
QUICK_S, SLOW_S = 1e-5, 3e-3  # reported duration of a job
ALONE_S = 0.0002  # pause before a turn, so that all messages have arrived
IN_PROGRESS = 1000  # commands that take turns, as many as in the trivial workload
QUICK_WORKERS = 8  # of each kind: enough to hold so many jobs
PASSES = 4  # repetitions of a size in one round of turns, at least
LATE_S = 0.2
START_LIMIT_S = 20.0
SETTLED = 8  # commands of each kind of worker that make its mean duration known
NEVER_S = 1e9
CLOCK = 1e-3  # seconds of the router per second
SIZES = (4, 64, 1024, 4096, 16384, 65536)  # workers, for the costs that grow with their number


Sent = list[tuple[zmq.Socket[bytes], list[bytes]]]  # messages of the broker: receiver, frames


class TurnCost(NamedTuple):
    features: tuple[float, ...]
    main_s: float
    io_s: float


class BrokerBench:
    """`slots` workers of each kind, each with a socket."""

    def __init__(self, folder: Path, slots: int) -> None:
        run_dir = prepare_run_dir(folder / "run")
        settings = Settings(run_dir=str(run_dir), run=secrets.token_hex(4))
        self.me = Process("broker", run_dir)
        state = State(life=secrets.token_hex(2))
        self.journal = Journal.open(run_dir / "journal.db", settings.run, state)
        store = ProgramStore(self.journal, state.programs)
        began_s, handed = time.monotonic(), Handover(settings, secrets.token_bytes(KEY_BYTES))

        def clock() -> float:  # it is slow, so that commands in progress do not reach their limit
            return began_s + CLOCK * (time.monotonic() - began_s)

        self.router = Router(Core(self.me, settings, self.journal, state, store, handed, clock))
        self.router._checks = Every(NEVER_S, time.monotonic() + NEVER_S)  # the health checks are timed apart
        for installed in _first_programs(settings, store, time.monotonic()):
            self.router.enqueue(installed)
        self.router.run_once()
        self._io = _io_threads()  # the peers have a context of their own, made later
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.client = self._peer(settings, "front", "load")
        self.subsystem = self._peer(settings, "subsystems", SUBSYSTEM)
        self.workers = {kind: [self._peer(settings, "workers", _name(kind, n)) for n in range(slots)] for kind in KINDS}
        self.instant = Instant(os.getpid(), self.performers())
        self._read_job = wire.reader(m.BrokerToWorker)
        self._read_client = wire.reader_of_many(m.BrokerToClient)
        self._read_order = wire.reader_of_many(m.BrokerToSubsystem)
        self._inputs = {kind: wire.decoder(FUNCTIONS[kind].INPUT) for kind in KINDS}
        self._number = 0
        self._performers = cycle(range(PERFORMERS))
        self._greet(settings)

    def performers(self) -> list[str]:
        return [performer(n) for n in range(PERFORMERS)]

    def sentence(self) -> str:
        return f"MOVE {performer(next(self._performers))}"

    def _peer(self, settings: Settings, endpoint: str, identity: str) -> zmq.Socket[bytes]:
        return open_socket(self.context, zmq.DEALER, settings.endpoint(endpoint), identity=identity)

    def _greet(self, settings: Settings) -> None:
        self.client.send_multipart(wire.frames(m.ClientHello(protocol=VERSION, client="load", abilities=[ARRAYS])))
        for message in self.instant.hello():
            self.subsystem.send_multipart(wire.frames(message))
        for kind, sockets in self.workers.items():
            for n, socket in enumerate(sockets):
                hello = m.WorkerHello(
                    protocol=VERSION, name=_name(kind, n), node=KINDS.index(kind) + 4 * n, kind=kind, pid=os.getpid()
                )
                socket.send_multipart(wire.frames(hello))
        end_s = time.monotonic() + START_LIMIT_S
        while len(self.router.core.registry.workers) < sum(map(len, self.workers.values())):
            self.router.run_once(self.me.wait(0.01))
            assert time.monotonic() < end_s, "not all peers have registered"
        for _ in range(20):
            self.router.run_once(self.me.wait(0.005))
        self._drain([])

    # --- one turn --------------------------------------------------------------------------------------

    def turn(self, sent: int, events: int, stage: str) -> tuple[TurnCost | None, Sent]:
        """Let the broker read `sent` messages in one turn. Returns its cost, and the messages that it sent.

        The cost is None if some messages were late: then there were several turns."""
        _spin(ALONE_S + 2e-5 * sent)
        io_s, began_s = _run_s(self._io), time.thread_time()
        self.router.run_once(self.me.wait(LATE_S))
        main_s = time.thread_time() - began_s
        out: Sent = []
        end_s = time.monotonic() + LATE_S
        while self._drain(out) < events and time.monotonic() < end_s:
            _spin(ALONE_S)
        io_s = _run_s(self._io) - io_s
        late = False
        while self._drain(out) < events:
            late = True
            self.router.run_once(self.me.wait(LATE_S))
            time.sleep(10 * ALONE_S)
        counts = [float(name == stage) * events for name in STAGES]
        return None if late else TurnCost((1.0, float(sent), float(len(out)), *counts), main_s, io_s), out

    def _drain(self, out: Sent) -> int:
        """Receive what the broker has sent; the number of commands in `out` that it has passed on."""
        for socket in (self.client, self.subsystem, *(s for sockets in self.workers.values() for s in sockets)):
            while socket.poll(0):
                out.append((socket, socket.recv_multipart()))
        return sum(
            len(self._jobs(parts))
            if socket not in (self.client, self.subsystem)
            else sum(isinstance(one, (m.Execute, m.CommandEnded)) for one in self._messages(socket, parts))
            for socket, parts in out
        )

    def _messages(self, socket: zmq.Socket[bytes], parts: list[bytes]) -> Sequence[Any]:
        return (self._read_order if socket is self.subsystem else self._read_client)(parts)

    # --- one group of commands --------------------------------------------------------------------------

    def pass_through(self, how_many: int, took_s: float, last: str = STAGES[-1]) -> Iterator[TurnCost]:
        """Pass this many commands through the stages up to `last`; yields a turn for each stage, unless messages were
        late."""
        texts = []
        for _ in range(how_many):
            self._number += 1
            request = str(self._number)
            texts.append(
                m.CommandText(request=request, text=self.sentence(), progress=False, sent_at_s=time.monotonic())
            )
        for parts in wire.together(texts):
            self.client.send_multipart(parts)
        messages, events = 1, how_many
        for stage in STAGES:
            turn, out = self.turn(messages, events, stage)
            if turn is not None:
                yield turn
            if stage == last:
                return
            messages, events = self.answer(out, STAGES[STAGES.index(stage) + 1], took_s)

    def take_turns(self, sizes: Sequence[int], took_s: float) -> Iterator[TurnCost]:
        """Pass groups of these sizes through all stages, each group by one stage in turn. So each command waits for
        all others between two of its events, as in a cluster, and its data have left the nearest caches."""
        groups = [self.pass_through(size, took_s) for size in sizes]
        while groups:
            for group in groups.copy():
                turn = next(group, None)
                if turn is None:
                    groups.remove(group)
                else:
                    yield turn

    def fill(self) -> None:
        """Pass commands until the broker forgets old results, as it does from then on."""
        for _ in range(-(-(ENDED_KEPT + FORGOTTEN_AT_ONCE) // IN_PROGRESS)):
            for _ in self.take_turns([TOGETHER[-1]] * (IN_PROGRESS // TOGETHER[-1] + 1), QUICK_S):
                pass

    def snapshot_s(self) -> float:
        """Processor time (s) of a snapshot of the state."""
        began_s = time.thread_time()
        self.journal.snapshot(self.router.core.state)
        return time.thread_time() - began_s

    def answer(self, out: Sent, stage: str, took_s: float) -> tuple[int, int]:
        """The peers' answers of the next stage; (messages, events)."""
        if stage == "reported":
            replies = [
                reply
                for socket, parts in out
                if socket is self.subsystem
                for message in self._read_order(parts)
                for reply in self.instant.handle(message, time.monotonic())
            ]
            frames = wire.together(replies)
            for parts in frames:
                self.subsystem.send_multipart(parts)
            return len(frames), len(replies)
        kind = KINDS[(1, 2, 3, 5).index(STAGES.index(stage))]
        messages = events = 0
        for n, socket in enumerate(self.workers[kind]):
            results = [
                m.JobDone(id=job.id, attempt=job.attempt, product=self.product(kind, job), took_s=took_s)
                for peer, parts in out
                if peer is socket
                for job in self._jobs(parts)
            ]
            if results:
                socket.send_multipart(wire.frames(m.ResultBatch(name=_name(kind, n), results=results)))
                messages, events = messages + 1, events + len(results)
        for socket, parts in out:  # acknowledgements travel with the next primitives
            if socket is self.subsystem:
                for message in self._read_order(parts):
                    if isinstance(message, m.ReportAck):
                        self.instant.handle(message, 0.0)
        return messages, events

    def _jobs(self, parts: list[bytes]) -> list[m.Job]:
        message = self._read_job(parts)
        return message.jobs if isinstance(message, m.JobBatch) else []

    def product(self, kind: WorkerKind, job: m.Job) -> msgspec.Raw:
        """The product of a worker of this kind."""
        return wire.raw(FUNCTIONS[kind].body(self._inputs[kind](job.input)))

    def heartbeats(self, how_many: int) -> float:
        """Processor time (s) of one heartbeat of a worker, among this many in one turn."""
        name = _name(KINDS[0], 0)
        for _ in range(how_many):
            self.workers[KINDS[0]][0].send_multipart(wire.frames(m.Heartbeat(name=name)))
        turn, _ = self.turn(how_many, 0, "")
        assert turn is not None
        return turn.main_s / how_many

    def close(self) -> None:
        self.context.destroy(linger=0)
        self.me.close()
        self.journal.close()


KINDS = tuple(WorkerKind)


@contextmanager
def bench(slots: int) -> Iterator[BrokerBench]:
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        made = BrokerBench(Path(folder), slots)
        try:
            yield made
        finally:
            made.close()


@contextmanager
def priority() -> Iterator[None]:
    """The priority of a broker, if it is permitted: a process that is preempted between two turns finds less of its
    data in the caches. Only for this thread; the I/O threads exist already."""
    with ExitStack() as entered:
        with suppress(OSError):
            entered.enter_context(real_time(RANK))
        yield


def measure(repetitions: int) -> dict[str, Any]:
    """Costs of the broker in seconds: per turn, message, event and registered worker; the spread."""
    turns: list[TurnCost] = []
    for slots, sizes, took_s in ((QUICK_WORKERS, TOGETHER, QUICK_S), (max(APART), APART, SLOW_S)):
        with bench(slots) as broker, priority():
            for _ in range(SETTLED):
                list(broker.pass_through(slots, took_s))
            freeze_heap()
            if sizes is TOGETHER:
                broker.fill()
                for _ in range(-(-repetitions // PASSES)):
                    turns += broker.take_turns(sizes * (IN_PROGRESS // sum(sizes)), took_s)
            else:
                for _ in range(repetitions):
                    for size in sizes:
                        turns += broker.pass_through(size, took_s)
            if sizes is TOGETHER:
                heartbeat_s = min(broker.heartbeats(100) for _ in range(5))
                snapshot_s = median(broker.snapshot_s() for _ in range(5))
    rows, main = [turn.features for turn in turns], [turn.main_s for turn in turns]
    costs = fitted(*medians(rows, main))
    io = [(1.0, turn.features[1] + turn.features[2]) for turn in turns if turn.io_s > 0]
    io_costs = fitted(*medians(io, [turn.io_s for turn in turns if turn.io_s > 0]))
    scan_s, check_s = growth()
    return {
        "per": dict(zip(FEATURES, costs, strict=True)),
        "ratios": ratios(rows, main, costs),
        "io_per_turn": io_costs[0],
        "io_per_message": io_costs[1],
        "heartbeat": heartbeat_s,
        "snapshot_per_event": snapshot_s / SNAPSHOT_EVENTS,
        "assign_per_worker": scan_s,
        "check_per_worker": check_s,
        "samples": len(turns),
    }


def growth() -> tuple[float, float]:
    """Seconds per registered worker: of one assignment of jobs to a worker, and of one health check."""
    rows, assign_s, check_s = [], [], []
    for size in SIZES:
        registry = WorkerRegistry()
        for node in range(size):
            registry.register(_name(KINDS[node % 4], node), node, KINDS[node % 4], 1, 0.0)
        job = DispatchJob(
            job="C-1/1", attempt=1, kind=KINDS[0], queue=KINDS[0], program="", cell="", input=msgspec.Raw(b"")
        )
        autoscaler, times = Autoscaler(0, 0), []
        for _ in range(3):
            registry.submit(job, 1.0)
            began_s = time.thread_time()
            ((name, _),) = registry.assign(1.0)
            times.append(time.thread_time() - began_s)
            registry.answered(name, job.job, 1, 0.001, 1.0)
        began_s = time.thread_time()
        registry.hung(1.0)
        list(autoscaler.orders(registry, [], 1.0))
        check_s.append(time.thread_time() - began_s)
        assign_s.append(min(times))
        rows.append((1.0, float(size)))
    return fitted(rows, assign_s)[1], fitted(rows, check_s)[1]


def _spin(for_s: float) -> None:
    """Wait without sleep: a core that has slept is slower for a while."""
    until_s = time.perf_counter() + for_s
    while time.perf_counter() < until_s:
        pass


def _name(kind: WorkerKind, n: int) -> str:
    return f"{kind}@{KINDS.index(kind) + 4 * n}"


def _run_s(threads: list[int]) -> float:
    """Processor time of threads of this process so far."""
    return sum(int(Path(f"/proc/self/task/{tid}/schedstat").read_text().split()[0]) for tid in threads) / 1e9


def _io_threads() -> list[int]:
    """The I/O threads of this process."""
    names = {int(task.name): (task / "comm").read_text() for task in Path("/proc/self/task").iterdir()}
    return [tid for tid, name in names.items() if name.startswith("ZMQbg/IO")]
