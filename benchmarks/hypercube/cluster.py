"""One simulation of a cluster: its size, load and routing in, its throughput and times out. Pure.

result = simulate(costs, Plan(dim=5, workload="asleep-4ms", window=128, cores=2), seconds=2.0, seed=1)
"""

from __future__ import annotations

from itertools import count
from random import Random
from typing import NamedTuple

from benchmarks.hypercube.costs import Costs
from benchmarks.hypercube.model import Broker, Command, Halt, Network, Peer, Worker, World
from benchmarks.hypercube.queues import Host, Simulation
from benchmarks.hypercube.routing import homes, hops
from benchmarks.report import percentile
from rtc.protocol.wire import MAX_BATCH

ARMS = 1024  # of one broker: so many that commands do not wait for one
HALT_PERIOD_S = 0.03
FULL_BEFORE, FULL_DURING = 1.5, 2.0  # times the window: commands of the warm-up, and of the measurement, at least
MAX_S = 20.0


class Plan(NamedTuple):
    """What is simulated."""

    dim: int  # 2^dim workers
    workload: str  # a key of Costs.workers
    window: int = 1000  # commands in progress, of each broker
    brokers: int = 1
    shared: bool = True  # all brokers assign jobs to all workers; False: each has an equal part of them
    nearest: bool = False  # among equally loaded workers a broker takes the nearest one; False: the lowest address
    cubic: bool = False  # dimension-order routing; False: direct links
    cores: int | None = None  # of the one host; None: each process has a core of its own
    tcp: bool = False  # links between hosts
    arms: int = ARMS  # of each broker
    beside: bool = False  # the arms of a broker share a space, and plan beside each other's motions
    rate: float = 0.0  # commands per second of each broker, at random times; 0: the window is kept full


class Result(NamedTuple):
    """Times in ms. Halts: from the call to the receipt by the subsystem, through the broker."""

    commands_per_s: float
    latency_p50_ms: float
    latency_p99_ms: float
    waiting_p50_ms: float
    waiting_mean_ms: float
    halt_p50_ms: float
    halt_p99_ms: float
    broker_busy: float  # share of time, mean of the brokers
    broker_us: float  # its processor time per command, with its I/O thread
    background: float  # of it health checks and heartbeats
    worker_busy: float  # share of time in slow jobs, mean of the workers of the busiest kind
    relay_busy: float  # share of time, the busiest node
    backlog: int  # commands in progress at the end
    events: int


class Client:
    """Keeps the window of its broker full, or sends commands at random times."""

    def __init__(self, world: World, broker: Broker, plan: Plan) -> None:
        self._world, self._broker, self._plan = world, broker, plan
        self._peer = Peer(world, world.costs.client, self._done)
        self._arms = count()
        self.ended: list[Command] = []
        self.sent = 0
        broker.reply = self._peer.receive
        broker.accepted = lambda: self._peer.receive([])
        if plan.rate:
            self._arrive()
        else:
            self._send(plan.window)
        world.sim.after(HALT_PERIOD_S * world.rng.random(), self._halt)

    def _done(self, ended: list[Command]) -> None:
        now_s = self._world.sim.now_s
        for command in ended:
            command.ended_s = now_s
        self.ended += ended
        if not self._plan.rate:
            self._send(len(ended))

    def _send(self, how_many: int) -> None:
        now_s, send = self._world.sim.now_s, self._world.network.send
        self.sent += how_many
        commands = [Command(next(self._arms) % self._plan.arms, now_s) for _ in range(how_many)]
        for first in range(0, how_many, MAX_BATCH):
            some = commands[first : first + MAX_BATCH]
            send(self._world.costs.client.io_per_message, -1, -1, self._broker.receive, "front", some)

    def _arrive(self) -> None:
        self._world.sim.after(self._world.rng.expovariate(self._plan.rate), self._arrive)
        if self.sent:
            self._send(1)
        else:
            self.sent = 1  # the first arrival is a random time after the start

    def _halt(self) -> None:
        sim = self._world.sim
        io_s = self._world.costs.client.io_per_message
        self._world.network.send(io_s, -1, -1, self._broker.receive, "halts", Halt(sim.now_s))
        sim.after(HALT_PERIOD_S * self._world.rng.uniform(0.9, 1.1), self._halt)


def simulate(costs: Costs, plan: Plan, *, seconds: float, seed: int, warm_up_s: float = 0.3) -> Result:
    """Run one plan. The same seed gives the same result."""
    sim, rng, costs = Simulation(), Random(seed), costs.of(plan.workload)
    host = Host(sim, plan.cores)
    world = World(sim, host, Network(sim, host, costs, rng, tcp=plan.tcp, cubic=plan.cubic), costs, rng)
    kinds, asleep = costs.workers[plan.workload], plan.workload.startswith("asleep")
    workers = [(node, Worker(world, kinds[node % 4], node, asleep=asleep)) for node in range(1 << plan.dim)]
    share = len(workers) // plan.brokers
    clients, brokers = [], []
    for n, node in enumerate(homes(plan.brokers, plan.dim)):
        own = workers if plan.shared else workers[n * share : (n + 1) * share]
        if plan.nearest:
            own = sorted(own, key=lambda worker: (hops(worker[0], node), worker[0] ^ node))
        payload = costs.lengthy[plan.workload].payload if plan.workload in costs.lengthy else {}
        brokers.append(Broker(world, node, own, plan.arms, payload, beside=plan.beside))
        clients.append(Client(world, brokers[-1], plan))
    _run_until(sim, clients, warm_up_s, FULL_BEFORE * plan.window if plan.rate == 0.0 else 0)
    for client, broker in zip(clients, brokers, strict=True):
        client.ended.clear()
        broker.halts_s.clear()
        broker.busy_s = broker.io_s = broker.background_s = 0.0
    for _, worker in workers:
        worker.busy_s = 0.0
    world.network.relay_busy_s.clear()
    in_progress = sum(client.sent for client in clients)
    began_s = sim.now_s
    _run_until(sim, clients, began_s + seconds, FULL_DURING * plan.window if plan.rate == 0.0 else 0)
    seconds = sim.now_s - began_s
    ended = [command for client in clients for command in client.ended]
    halts_ms = [1e3 * halt_s for broker in brokers for halt_s in broker.halts_s] or [float("inf")]
    times_ms = [1e3 * (command.ended_s - command.sent_s) for command in ended] or [float("inf")]
    service_ms = 1e3 * sum(command.service_s for command in ended) / max(1, len(ended))
    p50_ms = percentile(times_ms, 50)
    return Result(
        commands_per_s=len(ended) / seconds,
        latency_p50_ms=p50_ms,
        latency_p99_ms=percentile(times_ms, 99),
        waiting_p50_ms=max(0.0, p50_ms - service_ms),
        waiting_mean_ms=sum(times_ms) / len(times_ms) - service_ms,
        halt_p50_ms=percentile(halts_ms, 50),
        halt_p99_ms=percentile(halts_ms, 99),
        broker_busy=sum(broker.busy_s for broker in brokers) / seconds / len(brokers),
        broker_us=1e6 * sum(broker.busy_s + broker.io_s for broker in brokers) / max(1, len(ended)),
        background=sum(broker.background_s for broker in brokers) / seconds / len(brokers),
        worker_busy=max(sum(w.busy_s for _, w in workers[kind::4]) for kind in range(4))
        / seconds
        / (len(workers) // 4),
        relay_busy=max(world.network.relay_busy_s.values(), default=0.0) / seconds,
        backlog=sum(client.sent for client in clients) - in_progress - len(ended),
        events=sim.events,
    )


def _run_until(sim: Simulation, clients: list[Client], until_s: float, ended: float) -> None:
    """Run until this time, and longer until each client has seen so many ends on average, at most MAX_S longer."""
    sim.run(until_s)
    while sum(len(client.ended) for client in clients) < ended * len(clients) and sim.now_s < until_s + MAX_S:
        sim.run(sim.now_s + 0.05)
