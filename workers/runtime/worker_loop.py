"""Worker loop, the same for all four kinds: receive jobs, call the worker function once per job, send results.

The loop fetches the inputs of the function: its program, the cell's models and one grouped view of the world. It
commits an analyzer's changes before it answers. Every call becomes a result: a product, a refusal or the evidence of a
crash. The loop makes no decisions and knows neither commands nor scripts.

Jobs run in order. Results of quick jobs are sent in one batch after at most FLUSH_S; a result never waits for a job
that may be slow. After a reconnection the worker sends a new hello and discards all jobs of the previous session. It
does the same after an empty JobBatch: the broker does not know this worker.
"""

from __future__ import annotations

import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Protocol

import msgspec

from rtc.model.cells.cell import Cell
from rtc.plugins import guard
from rtc.plugins.guard import PluginError
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import ClusterError, ProgramError, Refusal, RefusalReason, Refused, WireError, refuse_if
from rtc.runtime.link import Link
from rtc.runtime.process import Every, Process, inbox, now_s, send, show_name
from rtc.world.client import WorldClient
from rtc.world.model import World
from workers.runtime import arithmetic
from workers.runtime.contact import BrokerContact
from workers.runtime.pulse import Pulse

HEARTBEAT_S = 0.5
HELLO_AGAIN_S = 0.3  # one hello answers several empty JobBatches; shorter than a heartbeat, which repeats them
FLUSH_S = 0.002  # longest delay of a quick job's result for batching
QUICK_S = 0.0005  # a worker is quick if its recent jobs took less than this
LISTEN_S = 0.001  # minimum interval between two reads of the socket while jobs are queued
FRESH_S = 0.002  # longest use of a world view, for jobs that had arrived before it was read
PROGRAM_LIMIT_S = 5.0  # time limit to fetch a program; long enough for a broker restart
ASK_AGAIN_S = 0.5
MAX_COMPILED = 16  # maximum number of cached programs, and of cached cells
EVIDENCE_CHARS = 4000


class WorkerFunction(Protocol):
    """Interface of a worker module."""

    INPUT: Any
    NEEDS_WORLD: bool
    NEEDS_CELL: bool

    def compile(self, program: bytes) -> Any:
        """Check and compile the program. Raises ProgramError."""

    def run(self, compiled: Any, cell: Any, world: World | None, data: Any) -> Any:
        """Compute the product, or a Refusal. Pure."""


class StopRequested(Exception):
    """A stop was requested during a job. The job is not answered; the broker assigns it to another worker."""


class WorkerLoop:
    """One worker. `link` is its connection to the broker; `build_cell` builds the models of a cell; `programs` and
    `cells` are preloaded, keyed by digest. A remote worker has a `contact`: nothing else ends it if its broker is
    lost. A rehearser has `compilers` of the programs of all kinds; any other worker that of its function."""

    def __init__(
        self,
        me: Process,
        hello: m.WorkerHello,
        function: WorkerFunction,
        link: Link,
        world: WorldClient,
        build_cell: Callable[[Cell], Any],
        programs: Mapping[str, Any] = MappingProxyType({}),
        cells: Mapping[str, Any] = MappingProxyType({}),
        contact: BrokerContact | None = None,
        compilers: Mapping[m.WorkerKind, Callable[[bytes], Any]] = MappingProxyType({}),
        world_version: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._me, self._hello, self._function = me, hello, function
        self._link, self._socket = link, link.socket
        self._read = wire.reader(m.BrokerToWorker)
        self._read_input = wire.decoder(function.INPUT)
        self._queue: deque[tuple[m.Job, float]] = deque()  # job and arrival time (s)
        self._results: list[m.JobResult] = []
        self._first_result_s = 0.0
        self._slow_s = 1.0  # slowly decaying maximum of recent job durations
        self._wanted = ""  # the digest being fetched; `_bodies` collects its bodies
        self._bodies: list[bytes | None] = []
        compilers = compilers or {hello.kind: function.compile}
        self._programs = {kind: CompiledCache(compile, programs) for kind, compile in compilers.items()}
        self._cells = CompiledCache(lambda body: build_cell(Cell.from_bytes(body)), cells)
        self._view = WorldView(world, world_version)
        self._contact = contact
        self._retiring = False
        self._why = ""  # reason of an end that this process did not receive as a signal
        self._heartbeat = Every(HEARTBEAT_S)
        self._hello_sent_s = 0.0
        self._socket_read_s = 0.0
        self._worked_s = 0.0  # end of the latest job
        self._inside = self._announced = ""  # the code of a package that runs; that was last announced for this job
        self._died = False  # the job has ended a worker before
        self._round_trip_s: float | None = None  # of the latest heartbeat, until it is reported

    def run(self) -> str:
        """Run until a stop is requested, or until the queue is empty after a Shutdown message.

        Returns the reason if a remote worker was rejected or has lost its broker; otherwise an empty text."""
        if self._contact is not None:
            self._contact.worked(now_s())  # the preparation of the worker does not count
        self._pulse = Pulse(self._beat)
        guard.tell(self._calls)
        while not self._me.stopping and not (self._retiring and not self._queue):
            if not self._queue:
                self._me.wait(self._heartbeat.left_s(now_s()))
                if self._link.newly_connected():
                    self._begin_anew()
                if self._heartbeat.due(now := now_s()) and self._link.is_up:
                    self._send_heartbeat(now)
            if not self._queue or now_s() - self._socket_read_s > LISTEN_S:
                self._listen()
            if self._queue:
                job, came_s = self._queue.popleft()
                self._do(job, came_s)
                self._worked_s = now_s()
                if self._contact is not None:
                    self._contact.worked(self._worked_s)
            self._flush(late=not self._queue)
            if not self._queue and self._contact is not None and (why := self._why_lost(self._contact)):
                self._why = why
                break
        self._end()
        return self._why

    def _why_lost(self, contact: BrokerContact) -> str:
        """The reason for which a remote worker must end: its key is refused, or no answer in time; else empty."""
        if self._link.key_refused:  # libzmq does not connect again after a refusal
            return self._link.diagnose()
        if not contact.lost(now_s()):
            return ""
        return f"the broker has not answered {self._hello.name} for {contact.limit_s:g} s: {self._link.diagnose()}"

    def _end(self) -> None:
        """Send the results that are left. A remote worker takes leave: its other jobs need not wait for a limit."""
        self._pulse.close()
        self._flush(late=True)
        if self._contact is not None and not self._why:
            self._send(m.WorkerGone(name=self._hello.name, in_order=True))
        self._link.close()

    # --- to and from the broker ------------------------------------------------------------------------

    def _send(self, message: Any) -> None:
        if not send(self._socket, message):
            self._me.log.error("no room for %s: dropped", type(message).__name__)

    def _send_heartbeat(self, now: float) -> None:
        """A remote worker requests an answer, and reports how long the latest one took."""
        if self._contact is None:
            self._send(m.Heartbeat(name=self._hello.name))
        else:
            self._send(m.Heartbeat(name=self._hello.name, at_s=now, round_trip_s=self._round_trip_s))
            self._round_trip_s = None

    def _beat(self, worked_s: float) -> None:
        """A heartbeat during a job that has used the processor for `worked_s`."""
        self._send(m.Heartbeat(name=self._hello.name, own_s=worked_s, inside=self._inside))
        if self._contact is not None:
            self._contact.working(worked_s, now_s())

    def _calls(self, name: str) -> None:
        """Code of an installed package begins, or has ended (""). It is announced after a first death in this job."""
        self._inside = name
        if self._died and name and name != self._announced:
            self._announced = name
            self._me.calls(name)
            self._pulse.beat()  # if it holds the interpreter, the last one

    def _listen(self) -> None:
        self._socket_read_s = now_s()
        for parts in inbox(self._socket):
            try:
                self._handle(self._read(parts))
            except WireError as error:
                self._me.log.warning("dropped a message of the broker: %s", error)

    def _handle(self, message: m.BrokerToWorker) -> None:
        match message:
            case m.HelloWanted():
                if now_s() - self._hello_sent_s >= HELLO_AGAIN_S:  # otherwise the last hello crossed this request
                    self._begin_anew()
            case m.JobBatch(jobs=jobs):
                came_s = now_s()
                self._queue.extend((job, came_s) for job in jobs)
                self._answered()
            case m.Heartbeat(at_s=at_s):
                self._answered()
                if at_s > self._worked_s:  # during a job no answer is read
                    self._round_trip_s = now_s() - at_s
            case m.WorkerAddress(name=name, node=node):
                self._hello = msgspec.structs.replace(self._hello, name=name, node=node)
                show_name(name)
            case m.CancelJobs(jobs=unwanted):
                self._drop(unwanted)
            case m.ProgramBody(digest=digest, body=body):
                if digest == self._wanted:
                    self._bodies.append(body)
                self._answered()
            case m.Shutdown(why=why):
                self._retire(why or "see logs/gate.log of the cluster")
            case m.Declined(refusal=refusal) if self._contact is None:  # a restart would not help: it waits
                self._me.log.error("the broker refuses this worker: %s", refusal.message)
            case m.Declined(refusal=refusal):
                self._retire(refusal.message)

    def _retire(self, why: str) -> None:
        """End when the queue is empty. `why`: for a remote worker, which reports it to the program that started it."""
        self._retiring = True
        if self._contact is not None:
            self._why = f"the cluster rejects {self._hello.name}: {why}"

    def _answered(self) -> None:
        """The broker knows this worker. The gateway alone sends other messages too."""
        if self._contact is not None:
            if self._contact.worker != self._hello.name:
                self._me.log.info("joined as %s", self._hello.name)
            self._contact.answered(self._hello.name, now_s())

    def _begin_anew(self) -> None:
        self._queue.clear()
        self._results.clear()
        self._send_hello()

    def _send_hello(self) -> None:
        self._hello_sent_s = now_s()
        self._send(self._hello)

    def _drop(self, unwanted: list[str]) -> None:
        """Refuse unwanted jobs that have not started, so that the broker can reuse their places in the queue."""
        entries, self._queue = self._queue, deque()
        for entry in entries:
            job = entry[0]
            if job.id in unwanted:
                refusal = Refusal(reason=RefusalReason.STATE, message="dropped: no longer wanted")
                self._answer(m.JobRefused(id=job.id, attempt=job.attempt, refusal=refusal))
            else:
                self._queue.append(entry)

    def _flush(self, late: bool) -> None:
        """Send the results, unless more are expected within FLUSH_S."""
        if not self._results:
            return
        if late or self._slow_s > QUICK_S or now_s() - self._first_result_s > FLUSH_S:
            self._send(m.ResultBatch(name=self._hello.name, results=self._results))
            self._results = []

    # --- one job ---------------------------------------------------------------------------------------

    def _do(self, job: m.Job, came_s: float) -> None:
        started_s = time.perf_counter()
        self._died, self._announced = job.attempt > 1, ""
        guard.begin_anew()
        result: m.JobDone | m.JobRefused
        try:
            result = m.JobDone(id=job.id, attempt=job.attempt, product=self._work(job, came_s))
        except StopRequested:
            return
        except Refused as refused:
            result = m.JobRefused(id=job.id, attempt=job.attempt, refusal=refused.refusal)
        except PluginError as error:
            failed = Refusal(
                reason=RefusalReason.PROGRAM, message=str(error), clears=by_person("correct or uninstall its package")
            )
            result = m.JobRefused(id=job.id, attempt=job.attempt, refusal=failed)
        except ClusterError as error:  # the world database is unavailable; the broker decides on a retry
            lost = Refusal(reason=RefusalReason.TIMEOUT, message=str(error))
            result = m.JobRefused(id=job.id, attempt=job.attempt, refusal=lost)
        except arithmetic.ERRORS as error:
            self._me.log.exception("job %s attempt %d: its arithmetic has failed", job.id, job.attempt)
            failed = arithmetic.refusal(self._hello.kind.value, error, self._read_input(job.input), self._view.doubtful)
            result = m.JobRefused(id=job.id, attempt=job.attempt, refusal=failed)
        except Exception:
            self._me.log.exception("job %s attempt %d crashed", job.id, job.attempt)
            evidence = traceback.format_exc()[-EVIDENCE_CHARS:]
            self._answer(m.JobCrashed(id=job.id, attempt=job.attempt, evidence=evidence))
            return
        took_s = time.perf_counter() - started_s
        self._slow_s = max(took_s, 0.9 * self._slow_s)
        world = self._view.version if self._function.NEEDS_WORLD else 0
        self._answer(msgspec.structs.replace(result, took_s=took_s, world=world))

    def _work(self, job: m.Job, came_s: float) -> msgspec.Raw:
        """Run the function and commit the changes of its product; returns the encoded product. Raises Refused."""
        if job.doubt:
            if job.lease is not None:
                self._view.make_suspect(job.lease, job.doubt)
            return wire.raw(None)  # the broker does not read it
        function = self._function
        program = self._program_of(job)
        cell = self._made(self._cells, job.cell) if function.NEEDS_CELL and job.cell else None
        world = self._view.at(came_s) if function.NEEDS_WORLD else None
        data = self._input_of(job)
        with self._pulse:
            product = function.run(program, cell, world, data)
        if isinstance(product, Refusal):
            raise Refused(product)
        if isinstance(product, m.Assessment) and product.changes:
            if job.lease is None:
                message = f"it wants to write {product.changes[0].key}, but its script names nothing that is written"
                raise Refused.because(RefusalReason.PROGRAM, message)
            refuse_if(self._view.commit(job.lease, product, source=job.id))
        return wire.raw(product)

    def _program_of(self, job: m.Job) -> Any:
        """The compiled program of the job; of a rehearsal those of all kinds. Raises Refused."""
        if job.programs:
            return {kind: self._made(cache, job.programs[kind]) for kind, cache in self._programs.items()}
        return self._made(self._programs[self._hello.kind], job.program)

    def _input_of(self, job: m.Job) -> Any:
        """Raises Refused for an input with a key that this version does not know: it may restrict a motion."""
        try:
            return self._read_input(job.input)
        except WireError as error:
            message = f"{self._hello.name} cannot read this job, which is of another version: {error}"
            raise Refused.because(RefusalReason.STATE, message, clears="run one version on all machines") from None

    def _answer(self, result: m.JobResult) -> None:
        if not self._results:
            self._first_result_s = now_s()
        self._results.append(result)

    def _made(self, kept: CompiledCache, digest: str) -> Any:
        """The compiled program or cell of this digest, from the cache or the broker. Raises Refused."""
        if digest not in kept:
            self._flush(late=True)
            kept.make(digest, self._body(digest))
        made = kept[digest]
        if isinstance(made, Refusal):
            raise Refused(made)
        return made

    def _body(self, digest: str) -> bytes:
        """Fetch a body from the broker and wait for it; other messages are handled as usual meanwhile.

        Raises Refused."""
        self._wanted, self._bodies = digest, []
        end_s, again = now_s() + PROGRAM_LIMIT_S, Every(ASK_AGAIN_S)
        while not self._bodies and now_s() < end_s:
            if self._me.stopping:
                raise StopRequested
            if again.due(now_s()):
                self._send(m.ProgramWanted(digest=digest))
            self._me.wait(again.left_s(now_s()))
            self._listen()
        self._wanted = ""
        if not self._bodies:
            message = f"the broker did not send program or cell {digest} within {PROGRAM_LIMIT_S:g} s"
            raise Refused.because(RefusalReason.TIMEOUT, message, where=digest)
        if (body := self._bodies[0]) is None:
            message = f"the broker has no program or cell {digest}"
            raise Refused.because(RefusalReason.PROGRAM, message, where=digest)
        return body


class CompiledCache(dict[str, Any]):
    """Cache of compiled bodies by digest, at most MAX_COMPILED. Of one that fails to compile the Refusal is kept."""

    def __init__(self, maker: Callable[[bytes], Any], made: Mapping[str, Any]) -> None:
        super().__init__(made)
        self._maker = maker

    def make(self, digest: str, body: bytes) -> None:
        try:
            self[digest] = self._maker(body)
        except ProgramError as error:
            self[digest] = Refusal(reason=RefusalReason.PROGRAM, message=str(error), where=digest)
        while len(self) > MAX_COMPILED:
            del self[next(iter(self))]


class WorldView:
    """The worker's copy of the world, updated by reading only the changes since its version.

    `version_now`: the version on disk, as `Handover.world_version`; None if it is not known without a read."""

    def __init__(self, client: WorldClient, version_now: Callable[[], int | None]) -> None:
        self._client = client
        self._version_now = version_now
        self._world = World()
        self._read_at_s = -1.0

    @property
    def version(self) -> int:
        """Of the copy that the latest job read."""
        return self._world.version

    @property
    def doubtful(self) -> str:
        """A fact of it that no computation bears, or ''."""
        return arithmetic.doubtful(self._world)

    def at(self, came_s: float) -> World:
        """The current world, for a job that arrived at `came_s`.

        A view read after the job arrived contains all commits made before the job was sent. The jobs of one batch
        therefore share a view for FRESH_S. Raises ClusterError if the database is unavailable.
        """
        if came_s > self._read_at_s or now_s() - self._read_at_s > FRESH_S:
            read_at_s = now_s()
            if self._version_now() != self._world.version:
                self._world = self._world.updated(self._client.stored(since=self._world.version))
            self._read_at_s = read_at_s
        return self._world

    def make_suspect(self, lease: m.Lease, why: str) -> None:
        """Raises ClusterError if the database is unavailable."""
        self._read_at_s = -1.0
        self._client.doubt(lease, why)

    def commit(self, lease: m.Lease, assessment: m.Assessment, source: str) -> Refusal | None:
        self._read_at_s = -1.0  # the next job of this batch must read this commit
        answer = self._client.commit(lease, assessment.changes, source)
        return answer if isinstance(answer, Refusal) else None
