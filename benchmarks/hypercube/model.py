"""The model of a cluster: brokers, workers, subsystems and clients, each one thread that takes what has arrived.

A process takes the messages that wait for it as one batch, works for the measured time, and sends its answers. So large
batches form under load, as in the real processes. The broker reads within the limits of `broker.router.ingress`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from random import Random
from typing import Any, NamedTuple

from benchmarks.hypercube.costs import ALONE, BESIDE, REBOUND, Costs, Payload, PeerCosts, WorkerCosts
from benchmarks.hypercube.queues import NORMAL, REAL_TIME, Host, Simulation
from benchmarks.hypercube.registry import Registry, Slot
from benchmarks.hypercube.routing import between
from broker.router.ingress import MAX_EVENTS
from broker.router.loop import CHECK_S
from rtc.protocol.wire import MAX_BATCH
from workers.runtime.worker_loop import HEARTBEAT_S, QUICK_S

EVENTS = ("parsed", "elaborated", "bound", "analyzed")  # of a result, by the kind of the worker
ELABORATOR, BINDER, ANALYZER = 1, 2, 3
SAME_COST = {REBOUND: "bound"}  # events that cost as much as another one, but for their payload


class Command:
    """`beside`: the job of its planner carries a motion of another arm; `planned_beside`: that of the elaborator did.
    `begun`: motions that had begun when the binder's job was created."""

    __slots__ = ("arm", "begun", "beside", "ended_s", "planned_beside", "sent_s", "service_s")

    def __init__(self, arm: int, sent_s: float) -> None:
        self.arm, self.sent_s = arm, sent_s
        self.service_s = self.ended_s = 0.0
        self.beside = self.planned_beside = False
        self.begun = 0

    @property
    def condition(self) -> str:
        """The condition of its job at a planner, as in `benchmarks.hypercube.planner_costs`."""
        words = BESIDE if self.beside else ALONE
        return words if self.beside == self.planned_beside else f"{words}, new way"


class Network:
    """Passes messages. `cubic`: dimension-order routing, whose intermediate nodes store and forward each message."""

    def __init__(self, sim: Simulation, host: Host, costs: Costs, rng: Random, *, tcp: bool, cubic: bool) -> None:
        self._sim, self._host, self._costs, self._rng = sim, host, costs, rng
        self._delays = costs.links["tcp" if tcp else "ipc"]
        self._cubic = cubic
        self._free_at_s: dict[int, float] = {}  # node -> end of its latest relayed message
        self.relay_busy_s: dict[int, float] = {}

    def send(self, io_s: float, source: int, target: int, receive: Callable[..., None], *about: Any) -> None:
        """Deliver a message. `io_s`: processor time of the I/O threads for it. Negative nodes are outside the cube."""
        if self._host.limited:
            self._host.work(NORMAL, io_s, self._travel, io_s, receive, about)
        elif self._cubic and source >= 0 and target >= 0 and source != target:
            path = [*between(source, target), -1]
            self._sim.after(self._delay(), self._arrive, path, 0, receive, about)
        else:
            self._sim.after(self._delay(), receive, *about)

    def _travel(self, io_s: float, receive: Callable[..., None], about: tuple[Any, ...]) -> None:
        self._sim.after(max(0.0, self._delay() - io_s), receive, *about)  # the measured delay contains the I/O

    def _delay(self) -> float:
        return self._delays[int(self._rng.random() * len(self._delays))]

    def _arrive(self, path: list[int], at: int, receive: Callable[..., None], about: tuple[Any, ...]) -> None:
        node = path[at]
        if node < 0:
            receive(*about)
            return
        begin_s = max(self._sim.now_s, self._free_at_s.get(node, 0.0))
        end_s = self._free_at_s[node] = begin_s + self._costs.relay
        self.relay_busy_s[node] = self.relay_busy_s.get(node, 0.0) + self._costs.relay
        self._sim.after(end_s - self._sim.now_s + self._delay(), self._arrive, path, at + 1, receive, about)


class World(NamedTuple):
    """What all processes of a simulation share."""

    sim: Simulation
    host: Host
    network: Network
    costs: Costs
    rng: Random


class Worker:
    """`asleep`: its jobs take time but no processor."""

    def __init__(self, world: World, costs: WorkerCosts, node: int, *, asleep: bool) -> None:
        self._world, self._costs, self._asleep = world, costs, asleep
        self.node = node
        self._inbox: deque[tuple[Broker, Slot, list[Command]]] = deque()  # messages
        self._queue: deque[tuple[Broker, Slot, Command]] = deque()
        self._busy = False
        self._quick = not asleep and sum(costs.service) / len(costs.service) < QUICK_S
        self._woken = False
        self.busy_s = 0.0

    def receive(self, broker: Broker, slot: Slot, jobs: list[Command]) -> None:
        self._inbox.append((broker, slot, jobs))
        if not self._busy:
            self._woken = True
            self._next()

    def _next(self) -> None:
        messages = len(self._inbox)
        for broker, slot, jobs in self._inbox:
            self._queue.extend((broker, slot, job) for job in jobs)
        self._inbox.clear()
        self._busy = bool(self._queue)
        if not self._busy:
            return
        costs, work = self._costs, self._world.host.work
        fixed_s = costs.per_message + self._woken * costs.wake_up
        if self._quick:
            some = list(self._queue)
            self._queue.clear()
            took = [(each, self._service(each[2])) for each in some]
            extra_s = sum(max(0.0, s - costs.per_item) for _, s in took)
            more_s = (messages - 1) * costs.per_message + len(some) * costs.per_item + extra_s
            work(NORMAL, fixed_s + more_s, self._answer, took)
        else:
            job = self._queue.popleft()
            service_s = self._service(job[2])
            self.busy_s += service_s
            if self._asleep:
                self._world.sim.after(service_s, work, NORMAL, fixed_s, self._answer, [(job, service_s)])
            else:
                work(NORMAL, fixed_s + costs.per_item + service_s, self._answer, [(job, service_s)])

    def _service(self, command: Command) -> float:
        times = self._costs.conditions.get(command.condition) or self._costs.service
        return times[int(self._world.rng.random() * len(times))]

    def _answer(self, took: list[tuple[tuple[Broker, Slot, Command], float]]) -> None:
        by_broker: dict[Broker, list[tuple[Slot, Command, float]]] = {}
        for (broker, slot, job), service_s in took:
            by_broker.setdefault(broker, []).append((slot, job, service_s))
        io_s = self._costs.io_per_message + self._woken * self._costs.io_wake_up
        self._woken = False
        for broker, results in by_broker.items():
            send = self._world.network.send
            send(io_s, self.node, broker.node, broker.receive, "results", (self.node & 3, results))
        self._next()


class Peer:
    """Subsystem or client: handles all that waits in one batch; `done(items)` then sends its answers."""

    def __init__(self, world: World, costs: PeerCosts, done: Callable[[list[Any]], None]) -> None:
        self._world, self._costs, self._done = world, costs, done
        self._inbox: list[list[Any]] = []
        self._busy = False

    def receive(self, items: list[Any]) -> None:
        self._inbox.append(items)
        if not self._busy:
            self._next(wakes=True)

    def _next(self, *, wakes: bool = False) -> None:
        self._busy = bool(self._inbox)
        if self._busy:
            costs, messages, items = self._costs, len(self._inbox), [item for some in self._inbox for item in some]
            self._inbox.clear()
            woken_s = wakes * (costs.wake_up + costs.io_wake_up)
            demand_s = woken_s + messages * costs.per_message + len(items) * costs.per_item
            self._world.host.work(NORMAL, demand_s, self._complete, items)

    def _complete(self, items: list[Any]) -> None:
        self._done(items)
        self._next()


class Halt(NamedTuple):
    called_s: float


class Broker:
    """`arms`: performers of its subsystem; each executes one command at a time. `beside`: they share a space, so that
    a step is bound again if another arm has begun to move since its job was created."""

    def __init__(
        self,
        world: World,
        node: int,
        workers: list[tuple[int, Worker]],
        arms: int,
        payload: Payload,
        *,
        beside: bool = False,
    ) -> None:
        self._world, self.node = world, node
        self.registry = Registry(workers)
        self.halts_s: list[float] = []
        self.reply: Callable[[list[Command]], None] = lambda ended: None  # to its client, set by the cluster
        self.accepted: Callable[[], None] = lambda: None
        self.subsystem = Peer(world, world.costs.subsystem, self._report)
        self._inbox: dict[str, deque[Any]] = {
            "halts": deque(),
            "reports": deque(),
            "results": deque(),
            "front": deque(),
        }
        self._lines: list[deque[Command]] = [deque() for _ in range(arms)]  # the first one has the arm
        self._busy = False
        self._background_s = 0.0  # health checks and heartbeats that are due
        self._payload, self._beside = payload, beside
        self._moving: set[int] = set()  # arms, from the order of a motion until its analysis; if they share a space
        self._begun = 0  # motions so far
        self.busy_s = self.io_s = self.background_s = 0.0
        self.turns = 0
        world.sim.after(CHECK_S * (1.0 + world.rng.random()), self._check)

    # --- messages arrive --------------------------------------------------------------------------------

    def receive(self, name: str, message: Any) -> None:
        self._inbox[name].append(message)
        if not self._busy:
            self._turn(wakes=True)

    def _check(self) -> None:
        costs, workers = self._world.costs, self.registry.count
        self._background_s += workers * (costs.check_per_worker + costs.heartbeat * CHECK_S / HEARTBEAT_S)
        self._world.sim.after(CHECK_S, self._check)
        if not self._busy:
            self._turn(wakes=True)

    def _report(self, items: list[Any]) -> None:
        """Answers of the subsystem."""
        self.halts_s += [self._world.sim.now_s - item.called_s for item in items if isinstance(item, Halt)]
        ended = [item for item in items if isinstance(item, Command)]
        io_s = self._world.costs.subsystem.io_per_message
        for first in range(0, len(ended), MAX_BATCH):
            some = ended[first : first + MAX_BATCH]
            self._world.network.send(io_s, -1, -1, self.receive, "reports", some)

    # --- a turn of the loop -----------------------------------------------------------------------------

    def _turn(self, *, wakes: bool = False) -> None:
        """Read, decide, and send at the end of the turn's time. Halts have a turn of their own, before the others.

        `wakes`: the broker has slept before."""
        inbox = self._inbox
        self._busy = any(inbox.values()) or self._background_s > 0.0
        if not self._busy:
            return
        halts = list(inbox["halts"])
        inbox["halts"].clear()
        batch = _Batch(halts, self._payload, wakes=wakes)
        if not halts:
            self._read(batch)
        background_s, self._background_s = self._background_s, 0.0
        self.background_s += background_s
        demand_s = batch.cost_s(self._world.costs, self.registry.count, self._ratio()) + background_s
        self.busy_s += demand_s
        self.turns += 1
        self._world.host.work(REAL_TIME, demand_s, self._end, batch)

    def _ratio(self) -> float:
        ratios = self._world.costs.ratios
        return ratios[int(self._world.rng.random() * len(ratios))]

    def _read(self, batch: _Batch) -> None:
        events = 0
        for name, socket, handle in (
            ("reports", "subsystems", self._reported),
            ("results", "workers", self._finished),
            ("front", "front", self._accept),
        ):
            waiting = self._inbox[name]
            while waiting:
                events += handle(waiting.popleft(), batch)
                batch.messages_in += 1
                if events >= MAX_EVENTS[socket]:
                    break
        for kind, slot, jobs in self.registry.assign():
            batch.jobs.append((kind, slot, jobs))

    def _accept(self, commands: list[Command], batch: _Batch) -> int:
        batch.count("accept", bool(self._moving), len(commands))
        batch.accepted += len(commands)
        self.registry.queues[0].extend(commands)
        return len(commands)

    def _finished(self, message: tuple[int, list[tuple[Slot, Command, float]]], batch: _Batch) -> int:
        kind, results = message
        for slot, command, service_s in results:
            self.registry.answered(kind, slot, service_s)
            command.service_s += service_s
            event = EVENTS[kind]
            if kind == ELABORATOR:
                self._claim(command)
            elif kind == ANALYZER:
                batch.ended.append(command)
                self._release(command)
            elif kind == BINDER:
                event = self._bound(command, batch)
            else:
                command.planned_beside = command.beside = self._is_beside(command)
                self.registry.queues[ELABORATOR].append(command)
            batch.count(event, bool(self._moving))
        return len(results)

    def _is_beside(self, command: Command) -> bool:
        return bool(self._moving - {command.arm})

    def _claim(self, command: Command) -> None:
        line = self._lines[command.arm]
        line.append(command)
        if len(line) == 1:
            self._bind(command)

    def _release(self, command: Command) -> None:
        self._moving.discard(command.arm)
        line = self._lines[command.arm]
        line.popleft()
        if line:
            self._bind(line[0])

    def _bind(self, command: Command) -> None:
        command.beside, command.begun = self._is_beside(command), self._begun
        self.registry.queues[BINDER].append(command)

    def _bound(self, command: Command, batch: _Batch) -> str:
        """Send the primitive, or bind again; the kind of the event."""
        if command.begun != self._begun:
            self._bind(command)
            return REBOUND
        if self._beside:
            self._begun += 1
            self._moving.add(command.arm)
        batch.primitives.append(command)
        return EVENTS[BINDER]

    def _reported(self, commands: list[Command], batch: _Batch) -> int:
        batch.count("reported", bool(self._moving), len(commands))
        batch.acknowledged += len(commands)
        self.registry.queues[ANALYZER].extend(commands)
        return len(commands)

    def _end(self, batch: _Batch) -> None:
        """Send what the turn has produced; then the next turn."""
        world, send = self._world, self._world.network.send
        turn_s = world.costs.io_per_turn + batch.wakes * world.costs.io_wake_up
        io_s = world.costs.io_per_message + turn_s / max(1, batch.messages_out)
        self.io_s += batch.messages_out * io_s
        for halt in batch.halts:
            send(io_s, -1, -1, self.subsystem.receive, [halt])
        for _, slot, jobs in batch.jobs:
            worker = slot.worker
            send(io_s, self.node, worker.node, worker.receive, self, slot, jobs)
        for first in range(0, len(batch.primitives), MAX_BATCH):
            some = batch.primitives[first : first + MAX_BATCH]
            send(io_s, -1, -1, self.subsystem.receive, some)
        if batch.accepted:
            send(io_s, -1, -1, self.accepted)
        if batch.ended:
            send(io_s, -1, -1, self.reply, batch.ended)
        self._turn()


class _Batch:
    """One turn of a broker."""

    def __init__(self, halts: list[Halt], payload: Payload, *, wakes: bool) -> None:
        self.halts, self.wakes, self._payload = halts, wakes, payload
        self.messages_in = len(self.halts)
        self.events: dict[str, int] = {}
        self.payload_s = 0.0  # more than for the events of the trivial workload
        self.jobs: list[tuple[int, Slot, list[Command]]] = []
        self.primitives: list[Command] = []
        self.ended: list[Command] = []
        self.accepted = self.acknowledged = 0

    def count(self, event: str, beside: bool, how_many: int = 1) -> None:
        """`beside`: an arm is in motion, so that messages are longer."""
        self.events[event] = self.events.get(event, 0) + how_many
        if self._payload:
            self.payload_s += how_many * self._payload[BESIDE if beside else ALONE].get(event, 0.0)

    @property
    def messages_out(self) -> int:
        """Messages sent; those for one peer travel together, up to a limit."""
        orders, answers = len(self.primitives) + self.acknowledged, self.accepted + len(self.ended)
        return len(self.halts) + len(self.jobs) + -(-orders // MAX_BATCH) + -(-answers // MAX_BATCH)

    def cost_s(self, costs: Costs, workers: int, ratio: float) -> float:
        """Processor time of the turn."""
        per = costs.broker
        messages_s = self.messages_in * per["message_in"] + self.messages_out * per["message_out"]
        fixed_s = per["turn"] + self.wakes * per["wake_up"] + messages_s
        events_s = self.payload_s
        for event, how_many in self.events.items():
            events_s += how_many * (per[SAME_COST.get(event, event)] + costs.snapshot_per_event)
        scanned_s = len(self.jobs) * costs.assign_per_worker * workers
        empty = not (self.messages_in or self.jobs)
        return (0.0 if empty else (fixed_s + events_s) * ratio) + scanned_s
