"""Times worker, subsystem, client and links alone: one real process each, and this process as its only peer.

The costs are processor time from the kernel (`schedstat`), apart for the main thread and the I/O thread of ZeroMQ. The
duration of a job is what the worker itself reports with its result.
"""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import zmq

from benchmarks.hypercube.fit import fitted, medians, quantiles
from benchmarks.load.trivial import bind, elaborate, parse
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import Outcome, OutcomeKind, StopReason
from rtc.protocol.sentence import ParsedCommand
from rtc.runtime.process import die_with_parent, open_socket
from rtc.runtime.settings import Settings, prepare_run_dir
from rtc.world.lease import KEY_BYTES, KEY_FILE

KINDS = tuple(WorkerKind)
BATCHES = (1, 4, 16, 64)  # jobs, primitives or answers in one message
ASLEEP_S = (0.001, 0.004)
ITEMS = 16  # least number of items per repetition, so that a block is longer than a tick of the kernel
BLOCKS = 7  # the median of so many blocks of repetitions is taken, so that a disturbed one does not count
LIMIT_MS = 5_000
AHEAD = 2  # jobs at a worker whose jobs take some milliseconds: one in progress, one ahead
RELAY_MESSAGES = 64  # in flight through a relay


class Peer:
    """A child process, and this process's ROUTER for it."""

    def __init__(self, endpoint: str, *command: str) -> None:
        folder = tempfile.TemporaryDirectory(prefix="rtc-bench-")
        self._folder, run_dir = folder, prepare_run_dir(Path(folder.name) / "run")
        self.settings = Settings(run_dir=str(run_dir), run=secrets.token_hex(4))
        self.settings.save()
        (run_dir / KEY_FILE).write_bytes(secrets.token_bytes(KEY_BYTES))
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.socket = open_socket(self.context, zmq.ROUTER, self.settings.endpoint(endpoint), bind=True)
        me = os.getpid()
        self.process = subprocess.Popen(
            [sys.executable, *command, "--run-dir", str(run_dir)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: die_with_parent(me),
        )
        self.identity, *_ = self.receive()  # its hello

    def receive(self) -> list[bytes]:
        if not self.socket.poll(LIMIT_MS * 4):
            raise SystemExit(f"{self.process.args!r} does not answer")
        return self.socket.recv_multipart()

    def send(self, parts: Sequence[bytes]) -> None:
        self.socket.send_multipart([self.identity, *parts])

    def used_s(self) -> tuple[float, float]:
        return used_s(self.process.pid)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.context.destroy(linger=0)
        self._folder.cleanup()


@contextmanager
def peer(endpoint: str, *command: str) -> Iterator[Peer]:
    made = Peer(endpoint, *command)
    try:
        yield made
    finally:
        made.close()


def used_s(pid: int) -> tuple[float, float]:
    """Processor time of a process so far (s): all other threads, and those of ZeroMQ's I/O."""
    main_s = io_s = 0.0
    for task in Path(f"/proc/{pid}/task").iterdir():
        run_s = int((task / "schedstat").read_text().split()[0]) / 1e9
        if (task / "comm").read_text().startswith("ZMQbg/IO"):
            io_s += run_s
        else:
            main_s += run_s
    return main_s, io_s


def costs_of(process: Peer, act: Callable[[int], None], repetitions: int) -> dict[str, float]:
    """Costs (s) of `act(n)`, a message of n items: per message, per item, and of the I/O thread per message."""
    rows, main, io = [], [], []
    for _ in range(3):
        act(BATCHES[-1])
    for size in BATCHES:
        times = repetitions * max(1, ITEMS // size)
        for _ in range(BLOCKS):
            before = process.used_s()
            for _ in range(times):
                act(size)
            after = process.used_s()
            if after[0] > before[0]:  # the kernel may update a running process only at its next tick
                rows.append((1.0, float(size)))
                main.append((after[0] - before[0]) / times)
                io.append((after[1] - before[1]) / times)
    per_message, per_item = fitted(*medians(rows, main))
    return {"per_message": per_message, "per_item": per_item, "io_per_message": median(io)}


# --- workers ------------------------------------------------------------------------------------------


def inputs() -> dict[WorkerKind, Any]:
    """An input of each trivial function."""
    parsed = parse(m.ParserInput(text="MOVE LOAD-1"))
    assert isinstance(parsed, ParsedCommand)
    script = elaborate(m.ElaboratorInput(command="C-1", parsed=parsed))
    binder = m.BinderInput(primitive_id="C-1.1", context=script.context, step=script.steps[0], bindings={})
    bound = bind(binder)
    assert bound.primitive is not None
    assert bound.evaluation is not None
    report = m.EndReport(
        primitive="C-1.1",
        performer="LOAD-1",
        reason=StopReason.GOAL,
        at_s=1.0,
        duration_s=0.0,
        joints=[0.0] * 6,
        tcp_pose=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        wrench=[0.0] * 6,
        hand_width_m=0.0,
        hand_force_n=0.0,
    )
    return {
        WorkerKind.PARSER: m.ParserInput(text="MOVE LOAD-1"),
        WorkerKind.ELABORATOR: m.ElaboratorInput(command="C-1", parsed=parsed),
        WorkerKind.BINDER: binder,
        WorkerKind.ANALYZER: m.AnalyzerInput(evaluation=bound.evaluation, report=report),
    }


def worker(kind: WorkerKind, data: Any, asleep_s: float, repetitions: int) -> dict[str, Any]:
    """Costs of one worker process, and the durations of its jobs (s)."""
    command = ["-m", "benchmarks.load.worker", "--kind", kind, "--node", str(KINDS.index(kind))]
    read, took_s = wire.reader(m.WorkerToBroker), []
    with peer("workers", *command, "--asleep-s", str(asleep_s)) as process:
        program = "0" * 16
        process.send(wire.frames(m.ProgramBody(digest=program, body=b"any")))
        body = wire.raw(data)

        def act(size: int) -> None:
            jobs = [m.Job(id=f"C-1/{n}", attempt=1, program=program, input=body) for n in range(size)]
            process.send(wire.frames(m.JobBatch(jobs=jobs)))
            while size > 0:
                message = read(process.receive()[1:])
                if isinstance(message, m.ResultBatch):
                    size -= len(message.results)
                    took_s.extend(r.took_s for r in message.results if isinstance(r, m.JobDone))
                elif isinstance(message, m.ProgramWanted):
                    process.send(wire.frames(m.ProgramBody(digest=message.digest, body=b"any")))

        if not asleep_s:
            return {**costs_of(process, act, repetitions), "service": quantiles(took_s)}
        act(AHEAD)
        took_s.clear()
        main, io = [], []
        for _ in range(BLOCKS):
            before = process.used_s()
            took_s += stream(read, process, Jobs(program, "", [body]), repetitions)
            main_s, io_s = (now - then for now, then in zip(process.used_s(), before, strict=True))
            main.append(main_s / repetitions)
            io.append(io_s / repetitions)
        costs = {"per_message": median(main), "per_item": 0.0, "io_per_message": median(io)}
        return {**costs, "service": quantiles(took_s)}


class Jobs(NamedTuple):
    """Jobs of one kind: digests of program and cell, and inputs to be taken in turn."""

    program: str
    cell: str
    inputs: Sequence[Any]


def stream(read: Any, process: Peer, jobs: Jobs, how_many: int) -> list[float]:
    """Pass jobs one by one, AHEAD of them at the worker, as the broker does with jobs of some milliseconds; their
    durations (s). Raises SystemExit if one has no product."""
    sent, took_s = 0, []
    while len(took_s) < how_many:
        while sent < how_many and sent - len(took_s) < AHEAD:
            body = jobs.inputs[sent % len(jobs.inputs)]
            job = m.Job(id=f"C-1/{sent}", attempt=1, program=jobs.program, cell=jobs.cell, input=body)
            process.send(wire.frames(m.JobBatch(jobs=[job])))
            sent += 1
        message = read(process.receive()[1:])
        if isinstance(message, m.ResultBatch):
            failed = [result for result in message.results if not isinstance(result, m.JobDone)]
            if failed:
                raise SystemExit(f"{process.process.args!r}: {failed[0]}")
            took_s.extend(result.took_s for result in message.results if isinstance(result, m.JobDone))
    return took_s


# --- subsystem and client -------------------------------------------------------------------------------


def subsystem(repetitions: int) -> dict[str, float]:
    """Costs of the instant subsystem: a message of n primitives, answered by reports and acknowledged."""
    bound = bind(inputs()[WorkerKind.BINDER])
    assert bound.primitive is not None
    read = wire.reader_of_many(m.SubsystemToBroker)
    with peer("subsystems", "-m", "benchmarks.load.subsystem") as process:

        def act(size: int) -> None:
            orders = [m.Execute(primitive=bound.primitive) for _ in range(size)]  # type: ignore[arg-type]
            acks = [m.ReportAck(primitive="C-1.1") for _ in range(size)]
            for parts in wire.together(orders) + wire.together(acks):
                process.send(parts)
            while size > 0:
                size -= sum(isinstance(one, m.EndReport) for one in read(process.receive()[1:]))

        return costs_of(process, act, repetitions)


def client(repetitions: int) -> dict[str, float]:
    """Costs of the load client: n commands sent, accepted and ended."""
    read = wire.reader_of_many(m.ClientToBroker)
    outcome = Outcome(kind=OutcomeKind.SUCCEEDED)
    with peer("front", "-m", "benchmarks.hypercube.idle_client", "--window", str(BATCHES[-1])) as process:
        waiting: list[str] = []

        def act(size: int) -> None:
            while len(waiting) < size:
                waiting.extend(one.request for one in read(process.receive()[1:]) if isinstance(one, m.CommandText))
            some = waiting[:size]
            del waiting[:size]
            accepted = [m.Accepted(request=name, command=f"C-{name}") for name in some]
            ended = [
                m.CommandEnded(
                    seq=1, at_s=1.0, command=f"C-{n}", request=n, text="MOVE LOAD-1", outcome=outcome, took_s=0.1
                )
                for n in some
            ]
            for parts in wire.together(accepted) + wire.together(ended):
                process.send(parts)

        return costs_of(process, act, repetitions)


# --- links ----------------------------------------------------------------------------------------------


def link(endpoint: str, repetitions: int) -> list[float]:
    """One-way times of a lone message (s): half the round trip to an echo, without the processor time of both main
    threads."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.DEALER)
    port = socket.bind_to_random_port("tcp://127.0.0.1") if endpoint == "tcp" else None
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        address = f"tcp://127.0.0.1:{port}" if port else f"ipc://{folder}/echo.sock"
        if not port:
            socket.bind(address)
        process = subprocess.Popen([sys.executable, "-m", "benchmarks.hypercube.echo", address])
        body, times_s = bytes(200), []
        try:
            for n in range(repetitions + 50):
                if n == 50:
                    begun = used_s(process.pid)[0], time.thread_time()
                    times_s.clear()
                began_s = time.perf_counter()
                socket.send(body)
                if not socket.poll(LIMIT_MS):
                    raise SystemExit(f"no echo over {endpoint}")
                socket.recv()
                times_s.append(time.perf_counter() - began_s)
            work_s = (used_s(process.pid)[0] - begun[0] + time.thread_time() - begun[1]) / repetitions
        finally:
            process.kill()
            process.wait()
            context.destroy(linger=0)
    return quantiles([max(1e-6, 0.5 * (t - work_s)) for t in times_s])


def relay(repetitions: int) -> dict[str, float]:
    """Costs of a node that receives a message and sends it on (s per message), in Python: main and I/O thread."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.DEALER)
    port = socket.bind_to_random_port("tcp://127.0.0.1")
    process = subprocess.Popen([sys.executable, "-m", "benchmarks.hypercube.echo", f"tcp://127.0.0.1:{port}"])
    body = bytes(200)
    try:
        for n in range(repetitions + 1):
            if n == 1:
                before = used_s(process.pid)
            for _ in range(RELAY_MESSAGES):
                socket.send(body)
            for _ in range(RELAY_MESSAGES):
                if not socket.poll(LIMIT_MS):
                    raise SystemExit("no echo")
                socket.recv()
        main_s, io_s = (now - then for now, then in zip(used_s(process.pid), before, strict=True))
    finally:
        process.kill()
        process.wait()
        context.destroy(linger=0)
    return {"main": main_s / repetitions / RELAY_MESSAGES, "io": io_s / repetitions / RELAY_MESSAGES}


def measure(repetitions: int) -> dict[str, Any]:
    data = inputs()
    workers: dict[str, Any] = {"trivial": {k: worker(k, data[k], 0.0, repetitions) for k in KINDS}}
    for asleep_s in ASLEEP_S:
        found = worker(WorkerKind.PARSER, data[WorkerKind.PARSER], asleep_s, repetitions)
        workers[f"asleep-{round(1e3 * asleep_s)}ms"] = dict.fromkeys(KINDS, found)
    return {
        "workers": workers,
        "subsystem": subsystem(repetitions),
        "client": client(repetitions),
        "links": {name: link(name, 20 * repetitions) for name in ("ipc", "tcp")},
        "relay": relay(repetitions),
    }
