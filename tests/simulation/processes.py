"""The processes round a simulated broker: workers, the MCM, clients, those who halt, the supervisor.

Each follows the rules of the real one in the file named at its head. What is real is used as it is: the MCM's
`McmSubsystem` with its executors, the world database's `Server` and `Store`, every message through `rtc.protocol.wire`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rtc.client.core import ClientCore, SubmittedCommand
from rtc.client.liveness import BrokerLiveness
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.primitive import ControlLaw
from rtc.protocol.versions import VERSION
from rtc.subsystems.base.subsystem import BROKER, REPEAT_S
from rtc.subsystems.motion.arm import HandCommand, Motion, Sample, Traits
from rtc.subsystems.motion.subsystem import McmSubsystem
from rtc.world.client import LIMIT_S
from tests.simulation import skills
from tests.simulation.network import Dealer, Frames

if TYPE_CHECKING:
    from tests.simulation.cluster import Cluster

ARMS = ("LEFT-ARM", "RIGHT-ARM")
MIN_SHARE = 0.05  # of a processor, that a process gets on a busy machine
read_worker = wire.reader(m.BrokerToWorker)
read_mcm = wire.reader_of_many(m.BrokerToSubsystem)
read_client = wire.reader_of_many(m.BrokerToClient)
read_halt = wire.reader(m.FromHalt)
read_supervisor = wire.reader(m.BrokerToSupervisor)


class Worker:
    """workers/runtime/worker_loop.py: jobs in order, an empty batch begins anew, what was dropped is answered unless
    begun. Heartbeats carry the processor time of a job; a blocked worker uses none, and a stopped one gives no sign."""

    HEARTBEAT_S = 0.5
    HELLO_AGAIN_S = 0.3

    def __init__(self, cluster: Cluster, name: str, node: int, kind: m.WorkerKind, pid: int) -> None:
        self.cluster, self.name, self.node, self.kind, self.pid = cluster, name, node, kind, pid
        self.alive, self.hung, self.stopped = True, False, False
        self.slowed = False  # its next job gets little of a processor
        self.since_s = cluster.clock.now_s
        self.queue: deque[m.Job] = deque()
        self.busy = False
        self._share = 1.0  # of a processor, while a job runs
        self._began_s = self._worked_s = 0.0
        self._hello_sent_s = -1.0
        self.line = Dealer(cluster.clock, name.encode(), self._receive)
        cluster.attach("workers", self.line)
        self._send_hello()
        cluster.clock.after(self.HEARTBEAT_S, self._beat)

    def die(self) -> None:
        self.alive = False
        self.line.close()

    def _send(self, message: m.WorkerToBroker) -> None:
        if self.alive:
            self.line.send(wire.frames(message))

    def _send_hello(self) -> None:
        self._hello_sent_s = self.cluster.clock.now_s
        rehearses = self.name.startswith(m.REHEARSER)
        self._send(
            m.WorkerHello(
                protocol=VERSION, name=self.name, node=self.node, kind=self.kind, pid=self.pid, rehearses=rehearses
            )
        )

    def _beat(self) -> None:
        if not self.alive or self.cluster.over:
            return
        if self.busy and not self.stopped:
            if not self.hung:
                self._worked_s = self._share * (self.cluster.clock.now_s - self._began_s)
            self._send(m.Heartbeat(name=self.name, own_s=self._worked_s))
        elif not self.hung:
            self._send(m.Heartbeat(name=self.name))
        self.cluster.clock.after(self.HEARTBEAT_S, self._beat)

    def _receive(self, parts: Frames) -> None:
        if self.hung:
            return
        match read_worker(parts):
            case m.HelloWanted():
                if self.cluster.clock.now_s - self._hello_sent_s >= self.HELLO_AGAIN_S:
                    self.queue.clear()
                    self._send_hello()
            case m.JobBatch(jobs=jobs):
                self.queue.extend(jobs)
                self._begin()
            case m.CancelJobs(jobs=unwanted):
                dropped = [job for job in self.queue if job.id in unwanted]
                self.queue = deque(job for job in self.queue if job.id not in unwanted)
                refusal = Refusal(reason=RefusalReason.STATE, message="dropped: no longer wanted")
                self._answer([m.JobRefused(id=job.id, attempt=job.attempt, refusal=refusal) for job in dropped])

    def _begin(self) -> None:
        if self.queue and not self.busy and not self.hung:
            self.busy = True
            job = self.queue.popleft()
            random = self.cluster.random
            took_s = random.uniform(0.0002, 0.004) if random.random() < 0.95 else random.uniform(0.01, 0.1)
            self._share, self._began_s, self._worked_s = 1.0, self.cluster.clock.now_s, 0.0
            if self.slowed:
                self.slowed = False
                took_s, self._share = random.uniform(1.0, 25.0), MIN_SHARE
                self.cluster.log(f"{self.name} does {job.id} on a busy machine, in {took_s:.1f} s")
            self.cluster.clock.after(took_s, self._done, job, took_s)

    def _done(self, job: m.Job, took_s: float, waited_s: float = 0.0) -> None:
        """`waited_s`: for the world database."""
        if not self.alive or self.hung:
            return
        product: Any = None
        try:
            if not job.doubt:
                product = skills.FUNCTIONS[self.name.partition("@")[0]](job.input)
        except skills.Kill:
            self.cluster.kill(self, f"by {job.id}")
            return
        writes = bool(job.doubt) or isinstance(product, m.Assessment)
        if writes and job.lease is not None and self.cluster.world_away_s > 0.0:
            if waited_s >= LIMIT_S:
                product = Refusal(reason=RefusalReason.TIMEOUT, message="the world database did not answer")
            else:
                left_s = min(self.cluster.world_away_s, LIMIT_S - waited_s) + 1e-6
                self.cluster.clock.after(left_s, self._done, job, took_s + left_s, waited_s + left_s)
                return
        elif writes and job.lease is not None:
            changes = None if job.doubt else product.changes
            refusal = self.cluster.commit(job.lease, changes)
            if refusal is not None:
                product = refusal
            if self.cluster.random.random() < self.cluster.dies_after_commit:
                self.cluster.kill(self, f"with {job.id} written and not answered")
                return
        self.busy = False
        if isinstance(product, Refusal):
            self._answer([m.JobRefused(id=job.id, attempt=job.attempt, refusal=product, took_s=took_s)])
        else:
            self._answer([m.JobDone(id=job.id, attempt=job.attempt, product=wire.raw(product), took_s=took_s)])
        self._begin()

    def _answer(self, results: Sequence[m.JobResult]) -> None:
        if results:
            self._send(m.ResultBatch(name=self.name, results=list(results)))


class TinyArm:
    """Two joints that follow exactly, and a hand that is always there."""

    def __init__(self, name: str) -> None:
        self.traits = Traits(
            name=name,
            joint_names=["a", "b"],
            lower=[-1.0] * 2,
            upper=[1.0] * 2,
            velocity=[50.0] * 2,
            acceleration=[1e5] * 2,  # its motions take some ticks
            payload_kg=10.0,
            max_opening_m=0.08,
            max_grip_n=50.0,
            hand_speed_m_s=0.05,
        )
        self.motion: Motion = ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])

    def read(self) -> Sample:
        joints, velocities, _ = self.motion
        return Sample(joints, velocities, [0.0] * 6, (0.04, 0.04), (0.0, 0.0), (0.0, 0.0))

    def follow(self, motion: Motion) -> None:
        self.motion = motion

    def brake(self, on: bool) -> None: ...

    def use_law(self, law: ControlLaw) -> None: ...

    def feel(self, wrench: list[float]) -> None: ...

    def command_hand(self, command: HandCommand) -> None: ...

    def tcp_pose(self, joints: Sequence[float]) -> Any:
        return POSE

    def fault(self) -> str:
        return ""

    def untouched(self) -> bool:
        return True

    def arm_touches(self) -> dict[str, float]:
        return {}

    def touches(self) -> dict[str, float]:
        return {}

    def near(self, within_m: float) -> Sequence[Any]:
        return ()


class _Pose(list[float]):
    def tolist(self) -> list[float]:
        return list(self)


POSE = _Pose([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class Mcm:
    """sim_mcm/__main__.py and sockets.py: halts first, then the broker, then a tick.

    Nothing is kept for an absent broker; a new one gets a hello. A tick takes TICK_S of the cluster's time.
    """

    HEARTBEAT_S = 0.25
    TICK_S = 0.004

    def __init__(self, cluster: Cluster, pid: int) -> None:
        self.cluster, self.name, self.pid = cluster, "MCM", pid
        self.alive, self.stopped = True, False
        self._own_s, self._own_at_s, self._share = 0.0, cluster.clock.now_s, 1.0
        self.subsystem = McmSubsystem({name: TinyArm(name) for name in ARMS}, pid=pid)
        self._callers: dict[bytes, Callable[[Frames], None]] = {}
        self._waiting: deque[tuple[bytes, Any]] = deque()  # read in the next tick
        self._ticking = False
        self.line = Dealer(cluster.clock, cluster.handed.identity("MCM").encode(), self._from_broker, self._greet)
        cluster.attach("subsystems", self.line)
        cluster.clock.after(self.HEARTBEAT_S, self._beat)
        cluster.clock.after(REPEAT_S, self._look_again)

    def die(self) -> None:
        self.alive = False
        self.line.close()

    def recv_estop(self, caller: bytes, order: m.HaltOrder, answer: Callable[[Frames], None]) -> None:
        self._callers[caller] = answer
        self._wait(caller, order)

    def run_at(self, share: float) -> None:
        """How fast its own time passes from now on: below 1 on a busy machine."""
        now_s = self.cluster.clock.now_s
        self._own_s += self._share * (now_s - self._own_at_s)
        self._own_at_s, self._share = now_s, share

    def stop(self) -> None:
        """SIGSTOP."""
        self.stopped = True
        self.run_at(0.0)

    def resume(self) -> None:
        """After SIGSTOP: everything that came meanwhile is read at once."""
        self.stopped = False
        self.run_at(1.0)
        self._tick_soon()

    # --- inside ---

    def _greet(self) -> None:
        self._send(self.subsystem.hello())

    def _from_broker(self, parts: Frames) -> None:
        for order in read_mcm(parts):
            self._wait(BROKER, order)

    def _wait(self, peer: bytes, order: Any) -> None:
        self._waiting.append((peer, order))
        self._tick_soon()

    def _tick_soon(self) -> None:
        if not self._ticking:
            self._ticking = True
            self.cluster.clock.after(0.0002, self._tick)

    def _tick(self) -> None:
        self._ticking = False
        if not self.alive or self.stopped or self.cluster.over:
            return
        now_s, subsystem = self.cluster.clock.now_s, self.subsystem
        waiting = sorted(self._waiting, key=lambda entry: entry[0] == BROKER)  # halts at the estop socket first
        self._waiting.clear()
        for peer, order in waiting:
            if isinstance(order, m.HaltOrder):
                self.cluster.ledger.halted(self, order, now_s)
            answers = subsystem.handle(order, peer, now_s)
            if isinstance(order, m.HaltOrder):
                self.cluster.ledger.obeyed(self, order)
            self._send(answers)
        self._send(subsystem.tick(now_s))
        if not subsystem.idle or subsystem._open_halts:
            self._ticking = True
            self.cluster.clock.after(self.TICK_S / max(self._share, MIN_SHARE), self._tick)

    def _look_again(self) -> None:
        """Idle, it ticks for nothing but reports that are due to be repeated."""
        if self.alive and not self.cluster.over:
            if self.subsystem.outstanding:
                self._tick_soon()
            self.cluster.clock.after(REPEAT_S, self._look_again)

    def _beat(self) -> None:
        if self.alive and not self.cluster.over:
            if not self.stopped:
                self.run_at(self._share)
                self._send([(BROKER, m.Heartbeat(name="MCM", own_s=self._own_s))])
            self.cluster.clock.after(self.HEARTBEAT_S, self._beat)

    def _send(self, sent: list[tuple[bytes, m.Message]]) -> None:
        for peer, message in sent:
            self.cluster.ledger.sent(self, message)
            if peer != BROKER:
                self.cluster.clock.after(self.cluster.clock.delay_s(), self._callers[peer], wire.frames(message))
            elif self.line.router is not None:
                self.line.send(wire.frames(message))


class Client:
    """A real `ClientCore`, and its connection."""

    LOOK_S = 0.5
    key_refused = lost = is_slow = False

    def __init__(self, cluster: Cluster, name: str) -> None:
        self.cluster, self.name = cluster, name
        self.texts: dict[str, m.CommandText] = {}
        self.command_of: dict[str, str] = {}
        self.results: dict[str, m.CommandEnded | m.Declined] = {}
        self.handshakes = 0
        self.core = ClientCore(name, self, BrokerLiveness(), cluster.clock.now_s, "simulated", False, 1 << 18)
        self.line = Dealer(cluster.clock, name.encode(), self._receive, self.connected)
        cluster.attach("front", self.line)
        self._send()
        cluster.clock.after(self.LOOK_S, self._look)

    @property
    def is_up(self) -> bool:
        return self.line.router is not None

    def diagnose(self) -> str:
        return ""

    @property
    def open(self) -> bool:
        return self.texts.keys() != self.results.keys()

    def submit(self, text: str) -> None:
        request = f"{self.name}/{len(self.texts) + 1}"
        sentence = m.CommandText(request=request, text=text, sent_at_s=self.cluster.clock.now_s)
        self.texts[request] = sentence
        self.core.submit(SubmittedCommand(text), sentence, self.cluster.clock.now_s)
        self._send()

    def connected(self) -> None:
        """The first connection repeats nothing; every later one repeats what is open."""
        self.handshakes += 1
        self.core.connected(self.cluster.clock.now_s)
        self._send()

    def _send(self) -> None:
        for parts in self.core.frames_to_send():
            self.line.send(parts)

    def _look(self) -> None:
        if not self.cluster.over:
            self.core.tick(self.cluster.clock.now_s)
            self._send()
            self.cluster.clock.after(self.LOOK_S, self._look)

    def _receive(self, parts: Frames) -> None:
        now_s = self.cluster.clock.now_s
        for message in read_client(parts):
            self._check(message)
        self.core.receive(parts, now_s)
        while self.core.take_next(now_s):
            pass
        self._send()

    def _check(self, message: m.BrokerToClient) -> None:
        match message:
            case m.Accepted():
                before = self.command_of.setdefault(message.request, message.command)
                if before != message.command:
                    self.cluster.wrong(f"{message.request} was accepted twice: {before}, {message.command}")
            case m.CommandEnded() | m.Declined():
                known = self.results.setdefault(message.request, message)
                if known != message:
                    self.cluster.wrong(f"{message.request} got two outcomes: {known}, {message}")


class Caller:
    """rtc/client/halt.py: the same order to the broker and to the MCM; a closed endpoint is tried again; never
    kept.
    Or an emergency switch, which knows the MCM's socket alone."""

    LIMIT_S = 2.0
    RETRY_S = 0.02

    def __init__(self, cluster: Cluster, number: int, halt: str, scope: str, *, knows_broker: bool) -> None:
        self.cluster = cluster
        now_s = cluster.clock.now_s
        self.order = m.HaltOrder(halt=halt, scope=scope, called_at_s=now_s)
        self.limit_s = now_s + self.LIMIT_S
        self.sent_to: set[str] = set() if knows_broker else {"halt"}
        self.at_rest = False
        self.line = Dealer(cluster.clock, b"\0%d" % number, self._receive, immediate=True)
        cluster.attach("halt", self.line)
        self._send_order()

    def _send_order(self) -> None:
        cluster = self.cluster
        if "halt" not in self.sent_to and self.line.send(wire.frames(self.order)):
            self.sent_to.add("halt")
        mcm = cluster.mcm
        if "estop" not in self.sent_to and mcm is not None and mcm.alive:
            self.sent_to.add("estop")
            cluster.clock.after(cluster.clock.delay_s(), self._at_estop, mcm)
        if len(self.sent_to) < 2 and cluster.clock.now_s < self.limit_s:
            cluster.clock.after(self.RETRY_S, self._send_order)

    def _at_estop(self, mcm: Mcm) -> None:
        if mcm.alive:
            mcm.recv_estop(self.line.identity, self.order, self._receive)

    def _receive(self, parts: Frames) -> None:
        message = read_halt(parts)
        if isinstance(message, m.HaltAtRest) and message.halt == self.order.halt:
            self.at_rest |= message.at_rest


class Supervisor:
    """deploy/supervisor.py: tells the broker of every death, starts anew, kills what the broker finds hung."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster = cluster
        self.line = Dealer(
            cluster.clock, cluster.handed.identity("supervisor").encode(), self._receive, self.send_table
        )
        cluster.attach("supervisor", self.line)

    def died(self, name: str, pid: int) -> None:
        self.line.send(wire.frames(m.ProcessExited(name=name, pid=pid, status=-9)))
        self.send_table()

    def send_table(self) -> None:
        """What runs; also after every start."""
        rows = [
            m.ProcessRow(name=worker.name, pid=worker.pid, state="ready", since_s=worker.since_s)
            for worker in self.cluster.workers.values()
            if worker.alive
        ]
        self.line.send(wire.frames(m.ProcessTable(processes=rows)))

    def _receive(self, parts: Frames) -> None:
        message = read_supervisor(parts)
        if isinstance(message, m.KillProcess):
            process = self.cluster.process(message.name)
            if process is not None and process.pid == message.pid:
                self.cluster.kill(process, message.why)
