"""How long does a killed process delay the work of a cluster, and is anything lost, repeated or reported wrongly?

    python -m benchmarks.recovery [--kills 100]
    python -m benchmarks.recovery --namespaces [--delay-ms 0]      # needs root

A real cluster (exact arms in real time, two workers of each kind) runs short commands on both arms all the time. A
client sends invalid sentences. One process after the other is killed with SIGKILL at a random moment. Measured is:

    worker   that has a job: until the job runs on another worker
    broker   until the new one receives results again (journal replayed, workers and MCM connected)
    world    until a read of the world is answered
    mcm      until the broker is connected to the new one and knows that it is at rest

With --namespaces the killed workers are on another host, in a network namespace behind a link with this delay. The
cluster has elaborators and binders only there. A worker there has no supervisor: its closed connection is the sign.

Then all reported outcomes are compared with the journal and the MCM's log (`benchmarks.load.verdict`).
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from pathlib import Path

from benchmarks.load.errands import Errands
from benchmarks.load.two_hosts import TwoHosts, Unavailable, inside, two_hosts
from benchmarks.load.verdict import JournalReader, judge
from benchmarks.report import finish, percentile, question, spread
from broker.decisions.events import BrokerRestarted, Event, JobDeclined, JobFinished, JobLost, SubsystemConnected
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.runtime.process_table import processes
from tests.campaigns.chaos import Chaos, Strike

SEED = 20
PAUSE_S = (0.6, 0.9)  # between two kills: some work is done, and no process counts as in a crash loop
LIMIT_S = 20.0
LOOK_S = 0.002
FRESH_S, FAR_FRESH_S = 0.002, 0.02  # older notes of a dispatch are ignored
IN_HAND_S = 0.004  # a worker is killed within this time after it got a job; most jobs of these kinds take longer
FAR_NODES = (17, 18, 21, 22)  # two elaborators and two binders on the other host
PHASES = {m.Phase.ELABORATING: "elaborator", m.Phase.BINDING: "binder"}


class Bench:
    """One cluster under load; its processes are killed one after the other."""

    def __init__(self, run_dir: Path, rng: random.Random, hosts: TwoHosts | None = None) -> None:
        self._run_dir, self._rng = run_dir, rng
        self.hosts = hosts
        self.chaos = Chaos(run_dir, rng)
        self.journal = JournalReader(run_dir)
        self.journal.follow()
        self.loss_known_s: list[float] = []
        self._marked = 0

    def run(self, kind: str, kills: int) -> list[float]:
        """Times (s) from a kill until the work continues."""
        found: list[float] = []
        kill = KILLS[kind]
        for took_s in kill(self):
            found.append(took_s)
            if len(found) % 20 == 0 or len(found) == kills:
                print(f"  {kind}: {len(found)} of {kills}, {spread(found, 1e3, 'ms')}", flush=True)
            if len(found) == kills:
                break
            self._rest()
        return found

    # --- one kind each ---------------------------------------------------------------------------------

    def worker(self) -> Iterator[float]:
        """Kills of a worker with a job; others delay nothing and do not count."""
        with Client(self._run_dir) as asking:
            for holder in self._holders(asking):
                time.sleep(self._rng.uniform(0.0, IN_HAND_S))
                self._mark()
                strike = self.chaos.strike("worker", holder)
                if strike is not None:
                    self._await_back(strike)  # the broker knows long before
                    yield from self._begun_by_another(strike)

    def far_worker(self) -> Iterator[float]:
        """The same on the other host. The worker is killed as soon as it has a job: the link delays it anyway."""
        assert self.hosts is not None
        with Client(self._run_dir) as asking:
            for holder in self._holders(asking):
                if holder not in self.hosts.workers:
                    continue
                self._mark()
                pid = self.hosts.workers[holder]
                strike = Strike(name=holder, pid=pid, at_s=self.hosts.kill(holder))
                self.chaos.strikes.append(strike)
                while holder in {row.name for row in asking.status().workers}:
                    time.sleep(LOOK_S)
                time.sleep(LOOK_S)  # the broker has journalled the loss
                took_s = list(self._begun_by_another(strike))
                strike.new_pid = self._start_far(asking, int(holder.partition("@")[2]))
                strike.back_s = time.monotonic() - strike.at_s
                yield from took_s

    def start_far(self) -> None:
        with Client(self._run_dir) as asking:
            self._start_far(asking, *FAR_NODES)

    def _start_far(self, rtc: Client, *nodes: int) -> int:
        """Start workers on the other host and wait until they are registered; returns the pid of the last."""
        assert self.hosts is not None
        names = {self.hosts.fork_worker(self._run_dir, node) for node in nodes}
        limit_s = time.monotonic() + LIMIT_S
        while not names <= {row.name for row in rtc.status().workers}:
            if time.monotonic() > limit_s:
                raise SystemExit(f"{', '.join(names)} did not register within {LIMIT_S} s")
            self.journal.read()
            time.sleep(10 * LOOK_S)
        return self.hosts.workers[names.pop()]

    def _holders(self, asking: Client) -> Iterator[str]:
        """Workers that have just got a job."""
        fresh_s = FAR_FRESH_S if self.hosts else FRESH_S
        with Client(self._run_dir) as rtc:
            for note in rtc.events(silence_s=LIMIT_S):
                if not isinstance(note, m.ProgressNote) or note.phase not in PHASES:
                    continue
                if time.monotonic() - note.at_s < fresh_s and (holder := self._holder(asking, note)) is not None:
                    yield holder

    def _holder(self, rtc: Client, note: m.ProgressNote) -> str | None:
        for worker in rtc.status().workers:
            if worker.kind == PHASES[note.phase] and worker.busy_with.partition("/")[0] == note.command:
                return str(worker.name)
        return None

    def _begun_by_another(self, strike: Strike) -> Iterator[float]:
        """The time when another worker began its job; None if it had none."""
        self.journal.read()
        lost = next((e for e in self._events() if isinstance(e, JobLost) and e.node == strike.name and e.blamed), None)
        if lost is not None:
            done = self._await(strike, lambda e: isinstance(e, JobFinished | JobDeclined) and e.job == lost.job)
            if isinstance(done, JobFinished):
                self.loss_known_s.append(lost.at_s - strike.at_s)
                yield done.at_s - done.took_s - strike.at_s

    def broker(self) -> Iterator[float]:
        while True:
            strike = self._strike("broker")
            restarted = self._await(strike, lambda e: isinstance(e, BrokerRestarted))
            going_on = self._await(
                strike,
                lambda e: e.at_s > restarted.at_s and isinstance(e, JobFinished | JobDeclined),  # noqa: B023
            )
            yield going_on.at_s - strike.at_s
            self._await_back(strike)

    def world(self) -> Iterator[float]:
        with Client(self._run_dir) as rtc:
            rtc.world.view()
            while True:
                strike = self._strike("world")
                rtc.world.view()
                yield time.monotonic() - strike.at_s
                self._await_back(strike)

    def mcm(self) -> Iterator[float]:
        while True:
            strike = self._strike("mcm")
            self._await_back(strike)
            known = self._await(
                strike,
                lambda e: isinstance(e, SubsystemConnected) and e.hello.pid == strike.new_pid and e.hello.at_rest,  # noqa: B023
            )
            yield known.at_s - strike.at_s

    # --- inside ----------------------------------------------------------------------------------------

    def _strike(self, kind: str) -> Strike:
        limit_s = time.monotonic() + LIMIT_S
        self._mark()
        while time.monotonic() < limit_s:
            if (strike := self.chaos.strike(kind)) is not None:
                return strike
            time.sleep(LOOK_S)
        raise SystemExit(f"no {kind} started within {LIMIT_S} s: {processes(self._run_dir)}")

    def _await_back(self, strike: Strike) -> None:
        limit_s = time.monotonic() + LIMIT_S
        while strike.back_s is None:
            if time.monotonic() > limit_s:
                raise SystemExit(f"{strike.name} did not come back within {LIMIT_S} s")
            self.chaos.returned()
            time.sleep(LOOK_S)

    def _mark(self) -> None:
        self.journal.read()
        self._marked = len(self.journal.events)

    def _events(self) -> list[Event]:
        """The events since the mark."""
        return self.journal.events[self._marked :]

    def _await(self, strike: Strike, wanted: Callable[[Event], bool]) -> Event:
        """The first such event since the mark and the kill. Raises SystemExit if there is none in time."""
        limit_s = time.monotonic() + LIMIT_S
        while time.monotonic() < limit_s:
            for event in self._events():
                if event.at_s >= strike.at_s and wanted(event):
                    return event
            time.sleep(LOOK_S)
            self.journal.read()
        raise SystemExit(f"{strike.name} was killed, and the work did not continue within {LIMIT_S} s")

    def _rest(self) -> None:
        time.sleep(self._rng.uniform(*PAUSE_S))
        self.journal.read()


KILLS: dict[str, Callable[[Bench], Iterator[float]]] = {
    "worker": Bench.worker,
    "broker": Bench.broker,
    "world": Bench.world,
    "mcm": Bench.mcm,
    "far_worker": Bench.far_worker,
}
HERE = ("worker", "broker", "world", "mcm")  # kinds without --namespaces


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.recovery", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=100, help="of each kind")
    parser.add_argument("--kinds", default=",".join(HERE), help="some of: " + ",".join(HERE))
    parser.add_argument("--namespaces", action="store_true", help="kill workers on another host instead")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="of the link to the other host, each way")
    given = parser.parse_args()
    try:
        with ExitStack() as stack:
            hosts = stack.enter_context(two_hosts(given.delay_ms / 1e3)) if given.namespaces else None
            run(stack, given.kills, ["far_worker"] if hosts else given.kinds.split(","), hosts)
    except Unavailable as why:
        raise SystemExit(f"no second host on this machine: {why}") from None


def run(stack: ExitStack, kills: int, kinds: list[str], hosts: TwoHosts | None) -> None:
    """Run the benchmark and report it; the cluster and its clients end with `stack`."""
    name = "recovery_hosts" if hosts else "recovery"
    question(name, "How long does a killed process delay the work, and is anything lost?", seed=SEED)
    metrics: dict[str, float | None] = {}
    rows: list[tuple[str, str]] = []
    with inside(hosts.near) if hosts else nullcontext():
        cluster = (
            own_cluster(mcm="kinematic", listen=hosts.address, least=0, most=1)
            if hosts
            else own_cluster(mcm="kinematic", dim=3)
        )
        run_dir = stack.enter_context(cluster)
    bench = Bench(run_dir, random.Random(SEED), hosts)
    if hosts:
        bench.start_far()
    with Errands(run_dir) as errands:
        time.sleep(2.0)  # each kind of job has run once
        for kind in kinds:
            found = bench.run(kind, kills)
            metrics |= {
                f"{kind}_p50_ms": percentile(found, 50) * 1e3,
                f"{kind}_p99_ms": percentile(found, 99) * 1e3,
            }
            rows.append((f"{kind} killed", spread(found, 1e3, "ms")))
            if "worker" in kind:
                metrics |= {
                    f"{kind}_known_p50_ms": percentile(bench.loss_known_s, 50) * 1e3,
                    f"{kind}_known_p99_ms": percentile(bench.loss_known_s, 99) * 1e3,
                }
                rows.append(("  of which until the broker knows", spread(bench.loss_known_s, 1e3, "ms")))
    bench.journal.close()
    verdict = judge(errands.done, bench.journal, run_dir, bench.chaos.strikes)
    verdict.print_faults()
    metrics |= {
        "commands_lost": len(verdict.lost),
        "commands_repeated": len(verdict.repeated),
        "wrong_outcomes": len(verdict.wrong),
        "outcomes_not_seen": len(verdict.not_seen),
        "commands": len(errands.done),
        "kills": len(bench.chaos.strikes),
    }
    rows += [
        ("commands", f"{len(errands.done)}: {', '.join(f'{n} {kind}' for kind, n in verdict.outcomes.most_common())}"),
        ("lost, repeated, reported wrongly", f"{len(verdict.lost)}, {len(verdict.repeated)}, {len(verdict.wrong)}"),
        ("not seen; missed batches of the journal", f"{len(verdict.not_seen)}; {verdict.missed}"),
    ]
    finish(name, metrics, rows)
    sys.exit(0 if verdict.faultless else 1)


if __name__ == "__main__":
    main()
