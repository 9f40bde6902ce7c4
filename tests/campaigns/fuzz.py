"""Does a cluster stay alive, small and quick while its sockets receive malformed and hostile messages?

    python -m tests.campaigns.fuzz [--seconds 120] [--seed 1]

A cluster (kinematic arms) is attacked in turn. Every socket receives malformed messages, incomplete connections and
well-formed messages with wrong values (tests/campaigns/hostile.py). Then follow floods of sentences, queries, halts and
frames of the maximum size. Meanwhile a second client sends sentences; a third calls halts at the broker and the MCM, or
at the broker alone. Three questions for each attack: Did a process die? How much memory did it cost? How long did the
other clients wait? The status must count every dropped message.
"""

from __future__ import annotations

import argparse
import multiprocessing
import random
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from benchmarks.report import finish, percentile, question
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import OutcomeKind, RtcError
from rtc.protocol.versions import VERSION
from rtc.runtime.process_table import processes
from rtc.runtime.settings import Settings
from tests.campaigns import RESULTS, hostile

WATCHED = ("broker", "world", "MCM")
SENTENCE = "STOW LEFT-ARM"
LIMIT_S = 30.0
SERVED = {OutcomeKind.SUCCEEDED, OutcomeKind.HALTED, OutcomeKind.ABORTED}  # an attacker may halt and abort
PART = 200  # messages at a time


# --- attacks: each runs in a process of its own until it is killed ------------------------------------------


def endpoint(settings: Settings, rng: random.Random, name: str) -> None:
    """All families of bad messages, sent to one socket."""
    context: zmq.Context[Any] = zmq.Context()
    attacker = hostile.Attacker(context, settings, name, rng)
    while True:
        for _ in range(10):
            attacker.send(PART)
            hostile.stream_garbage(settings, name, rng)
            time.sleep(0.001)
        attacker.send(1, hostile.heavy_messages(rng))
        attacker.come_anew()


def sentences(settings: Settings, _: random.Random) -> None:
    """Valid sentences without end, from one client that never reads the answers."""
    _flood(settings, "front", lambda n: m.CommandText(request=str(n), text="STOW RIGHT-ARM", progress=True))


def nonsense(settings: Settings, _: random.Random) -> None:
    """Invalid sentences without end: each is refused at once, so the next one is admitted."""
    _flood(settings, "front", lambda n: m.CommandText(request=str(n), text="STOW " + "THE LEFT LEG " * 100))


def questions(settings: Settings, _: random.Random) -> None:
    kinds = (
        lambda n: m.StatusQuery(request=str(n)),
        lambda n: m.TraceQuery(request=str(n), command="C-1"),
        lambda n: m.ProgramText(request=str(n), kind=m.WorkerKind.BINDER, name="x", body=b"[" * 100_000),
    )
    _flood(settings, "front", lambda n: kinds[n % 3](n))


def reads(settings: Settings, _: random.Random) -> None:
    """Reads of the whole world without end; the replies are never read."""
    _flood(settings, "world", lambda n: m.ReadView(request=str(n)))


def halts(settings: Settings, _: random.Random) -> None:
    """Halts at the broker's halt socket, each with a new id."""
    _flood(settings, "halt", lambda n: m.HaltOrder(halt=f"H-{n}", scope=("ALL", "RIGHT-ARM", f"C-{n}")[n % 3]))


def estops(settings: Settings, _: random.Random) -> None:
    """Halts at the MCM's estop socket, each with a new id."""
    _flood(settings, "estop", lambda n: m.HaltOrder(halt=f"H-{n}", scope=("RIGHT-ARM", f"C-{n}")[n % 2]))


def truths(settings: Settings, _: random.Random) -> None:
    _flood(settings, "bench", lambda n: m.SimTruth(request=str(n)))


def large(settings: Settings, rng: random.Random) -> None:
    """Frames of the maximum size, and larger."""
    context: zmq.Context[Any] = zmq.Context()
    attackers = [hostile.Attacker(context, settings, name, rng) for name in ("front", "workers", "world")]
    heavy = hostile.heavy_messages(rng)
    while True:
        for attacker in attackers:
            attacker.send(5, heavy)
        time.sleep(0.001)


def subscriptions(settings: Settings, rng: random.Random) -> None:
    """Subscriptions to 100,000 unused topics."""
    context: zmq.Context[Any] = zmq.Context()
    socket = context.socket(zmq.XSUB)
    socket.connect(settings.endpoint("events"))
    for n in range(100_000):
        socket.send(b"\1" + str(n).encode())
    time.sleep(3600)


def _flood(settings: Settings, where: str, message: Callable[[int], Any]) -> None:
    """Send as fast as the socket accepts; never read the answers."""
    context: zmq.Context[Any] = zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.setsockopt(zmq.RCVHWM, 10)
    socket.connect(settings.endpoint(where))
    if where == "front":  # sentences of strangers are declined
        socket.send_multipart(wire.frames(m.ClientHello(protocol=VERSION, client="flood", at_s=time.monotonic())))
    n = 0
    while True:
        n += 1
        socket.send_multipart(wire.frames(message(n)))


ATTACKS: dict[str, Callable[..., None]] = {
    **dict.fromkeys(hostile.ACCEPTED, endpoint),
    **{f.__name__: f for f in (sentences, nonsense, questions, reads, halts, estops, truths, large, subscriptions)},
}


@contextmanager
def attacked(run_dir: Path, name: str, seed: int) -> Iterator[None]:
    process = multiprocessing.Process(target=_attack, args=(run_dir, name, seed), daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def _attack(run_dir: Path, name: str, seed: int) -> None:
    given = (name,) if ATTACKS[name] is endpoint else ()
    ATTACKS[name](Settings.load(run_dir), random.Random(seed), *given)


# --- what other clients observe -------------------------------------------------------------------------------


@dataclass
class Noticed:
    """What other clients observed during one attack."""

    commands_s: list[float] = field(default_factory=list)  # how long a command took
    halts_s: list[float] = field(default_factory=list)  # from the call to its receipt at the MCM, by the faster way
    broker_halts_s: list[float] = field(default_factory=list)  # call -> answer, through the broker alone
    wrong: list[str] = field(default_factory=list)
    died: list[str] = field(default_factory=list)
    growth_mb: float = 0.0


class Others:
    """A client that sends sentences and one that calls halts; watches the processes of the cluster."""

    def __init__(self, run_dir: Path) -> None:
        self._run_dir = run_dir
        self.rtc = Client(run_dir)
        self._context: zmq.Context[Any] = zmq.Context()
        self._halt = self._context.socket(zmq.DEALER)
        self._halt.connect(Settings.load(run_dir).endpoint("halt"))
        self._read = wire.reader(m.FromHalt)

    def notice(self, for_s: float) -> Noticed:
        noticed, before, end_s = Noticed(), self.pids(), time.monotonic() + for_s
        memory_mb = self.memory_mb()
        while time.monotonic() < end_s:
            self._command(noticed)
            self._halts(noticed)
            now_mb = self.memory_mb()
            noticed.growth_mb = max(noticed.growth_mb, *(now_mb[name] - memory_mb[name] for name in WATCHED))
        after = self.pids()  # the autoscaler may have started or retired workers
        noticed.died = [name for name in before.keys() & after.keys() if before[name] != after[name]]
        return noticed

    def _command(self, noticed: Noticed) -> None:
        began_s = time.monotonic()
        try:
            ended = self.rtc.run(SENTENCE, timeout_s=LIMIT_S)
        except RtcError as error:
            noticed.wrong.append(f"a command: {error}")
            return
        noticed.commands_s.append(time.monotonic() - began_s)
        if ended.outcome.kind not in SERVED:
            noticed.wrong.append(f"a command {ended.outcome.kind}: {ended.outcome.message}")

    def _halts(self, noticed: Noticed) -> None:
        halted = self.rtc.halt("LEFT-ARM")
        if not halted.confirmed or halted.latency_s is None:
            noticed.wrong.append(f"a halt: {halted.message}")
        else:
            noticed.halts_s.append(halted.latency_s)
        began_s, name = time.monotonic(), f"H-{uuid.uuid4().hex}"
        self._halt.send_multipart(wire.frames(m.HaltOrder(halt=name, scope="LEFT-ARM", called_at_s=began_s)))
        while self._halt.poll(5000):
            answer = self._read(self._halt.recv_multipart())
            if isinstance(answer, m.HaltStarted) and answer.halt == name:
                noticed.broker_halts_s.append(time.monotonic() - began_s)
                return
        noticed.wrong.append("a halt through the broker was not answered within 5 s")

    def pids(self) -> dict[str, int]:
        """Process ids by name, without the fork servers."""
        return {name: row.pid for name, row in processes(self._run_dir).items() if "template" not in name}

    def memory_mb(self) -> dict[str, float]:
        """Resident memory."""
        pids = self.pids()
        return {name: int(Path(f"/proc/{pids[name]}/statm").read_text().split()[1]) / 256 for name in WATCHED}

    def close(self) -> None:
        self.rtc.close()
        self._context.destroy(linger=0)


# --- the report -------------------------------------------------------------------------------------------


def main() -> int:
    arguments = argparse.ArgumentParser(prog="python -m tests.campaigns.fuzz", description=__doc__)
    arguments.add_argument("--seconds", type=float, default=120.0, help="for all attacks together")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--attack", action="append", choices=[*ATTACKS], help="only this one (may be repeated)")
    given = arguments.parse_args()
    names = given.attack or [*ATTACKS]
    question(
        "fuzz",
        "Does a cluster stay alive, small and quick while its sockets receive hostile messages?",
        seed=given.seed,
    )
    rows, all_noticed = [], []
    with own_cluster(mcm="kinematic") as run_dir:
        others = Others(run_dir)
        others.notice(2.0)
        for name in names:
            with attacked(run_dir, name, given.seed):
                noticed = others.notice(given.seconds / len(names))
            all_noticed.append(noticed)
            rows.append((name, _in_words(noticed)))
            print(f"  {name:<14} {rows[-1][1]}", flush=True)
        counters = others.rtc.status().counters
        others.close()
    dropped = {name: n for name, n in counters.items() if name.startswith("dropped_")}
    print(f"  dropped: {dropped}")
    commands_s = [s for noticed in all_noticed for s in noticed.commands_s]
    metrics: dict[str, float | None] = {
        "died": float(sum(len(noticed.died) for noticed in all_noticed)),
        "wrong": float(sum(len(noticed.wrong) for noticed in all_noticed)),
        "halt_p99_ms": 1e3 * percentile([s for noticed in all_noticed for s in noticed.halts_s], 99),
        "broker_halt_p99_ms": 1e3 * percentile([s for noticed in all_noticed for s in noticed.broker_halts_s], 99),
        "command_p50_ms": 1e3 * percentile(commands_s, 50),
        "command_p99_ms": 1e3 * percentile(commands_s, 99),
        "growth_mb": max(noticed.growth_mb for noticed in all_noticed),
        "dropped": float(sum(dropped.values())),
    }
    finish("fuzz", metrics, rows, RESULTS)
    return int(bool(metrics["died"] or metrics["wrong"]))


def _in_words(noticed: Noticed) -> str:
    def worst(samples: list[float]) -> str:
        return f"{1e3 * percentile(samples, 50):.3g}/{1e3 * percentile(samples, 99):.3g} ms" if samples else "none"

    parts = [
        f"command p50/p99 {worst(noticed.commands_s)}, halt {worst(noticed.halts_s)}",
        f"through the broker {worst(noticed.broker_halts_s)}, +{noticed.growth_mb:.0f} MB",
        *([f"DIED {', '.join(noticed.died)}"] if noticed.died else []),
        *([f"WRONG {len(noticed.wrong)}: {noticed.wrong[0]}"] if noticed.wrong else []),
    ]
    return ", ".join(parts)


if __name__ == "__main__":
    sys.exit(main())
