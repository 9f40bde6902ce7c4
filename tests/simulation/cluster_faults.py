"""The faults of the simulated cluster: kills, stops, hung workers, repeated requests, an absent world database."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rtc.protocol import messages as m
from tests.simulation.processes import MIN_SHARE

if TYPE_CHECKING:
    from tests.simulation.cluster import Cluster


def _kill_broker(cluster: Cluster) -> None:
    broker, random = cluster.broker, cluster.random
    if broker is None or not broker.alive:
        return
    cluster.faults["broker"] += 1
    way = random.choice(("now", "before", "after", "sending", "sending"))
    cluster.log(f"the broker is about to be killed: {way}")
    if way == "now":
        cluster.kill(broker, "between two turns")
    elif way == "sending":
        broker.sends_left = random.randint(0, 6)
    else:
        broker.dies_in_journal = way


def _stop_broker(cluster: Cluster) -> None:
    broker = cluster.broker
    if broker is not None and broker.alive and not broker.stopped:
        cluster.faults["broker stopped"] += 1
        for_s = cluster.random.choice((0.3, 2.5, 6.0))
        cluster.log(f"the broker stands still for {for_s} s")
        broker.stopped = True
        cluster.clock.after(for_s, broker.resume)


def _kill_worker(cluster: Cluster) -> None:
    worker = cluster.random.choice(list(cluster.workers.values()))
    cluster.faults["worker"] += 1
    cluster.kill(worker)


def _hang_worker(cluster: Cluster) -> None:
    """It waits without end, or gives no sign of life. Only where the limit is short: the others are found the same
    way."""
    workers = [w for w in cluster.workers.values() if w.kind in (m.WorkerKind.PARSER, m.WorkerKind.ANALYZER)]
    worker = cluster.random.choice(workers)
    cluster.faults["worker"] += 1
    worker.hung, worker.stopped = True, cluster.random.random() < 0.3
    cluster.log(f"{worker.name} {worker.pid} {'is stopped' if worker.stopped else 'hangs'}")


def _slow_worker(cluster: Cluster) -> None:
    """A busy machine."""
    cluster.random.choice(list(cluster.workers.values())).slowed = True


def _kill_mcm(cluster: Cluster) -> None:
    if cluster.mcm is not None and cluster.mcm.alive:
        cluster.faults["MCM"] += 1
        cluster.kill(cluster.mcm)


def _stop_mcm(cluster: Cluster) -> None:
    mcm = cluster.mcm
    if mcm is not None and mcm.alive and not mcm.stopped:
        cluster.faults["MCM"] += 1
        for_s = cluster.random.choice((0.05, 0.3, 2.5, 4.0))
        cluster.log(f"the MCM stands still for {for_s} s")
        mcm.stop()
        cluster.clock.after(for_s, mcm.resume)


def _slow_mcm(cluster: Cluster) -> None:
    """A busy machine: it ticks, and late."""
    mcm = cluster.mcm
    if mcm is not None and mcm.alive and not mcm.stopped:
        cluster.log("the MCM gets little of a processor")
        mcm.run_at(MIN_SHARE)
        cluster.clock.after(cluster.random.uniform(1.0, 20.0), lambda: None if mcm.stopped else mcm.run_at(1.0))


def _repeat(cluster: Cluster) -> None:
    """A client repeats all its requests without need."""
    client = cluster.random.choice(cluster.clients)
    cluster.log(f"{client.name} repeats all its requests")
    client.connected()


def _stop_world(cluster: Cluster) -> None:
    away_s = cluster.random.choice((0.2, 2.0, 6.0, 20.0, 80.0))
    cluster.faults["world"] += 1
    cluster.log(f"the world database stands still for {away_s:g} s")
    cluster.world_back_s = max(cluster.world_back_s, cluster.clock.now_s + away_s)


FAULTS = (
    *(_kill_broker, _kill_broker, _stop_broker, _kill_worker, _kill_worker),
    *(_hang_worker, _slow_worker, _kill_mcm, _stop_mcm, _slow_mcm, _repeat, _stop_world),
)
