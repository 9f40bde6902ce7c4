"""How long from the operator's halt to the first decelerating tick of a moving arm?

    python -m benchmarks.halt [--halts 200] [--mcm bullet]

The right arm goes to and fro; at a random moment of each motion it is halted. Five conditions: `idle` (nothing else
goes on), `saturated` (every core has a busy process, and sentences stream through the workers), `hung_worker` (a binder
is stopped while it has a job in hand), `broker_stopped` (SIGSTOP: only the estop socket is left), `planning` (the other
arm's motions are being planned). Latency is `decelerating_at_s - called_at_s`, both CLOCK_MONOTONIC of one machine.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from benchmarks.report import finish, percentile, question, spread
from rtc import messages as m
from rtc.client import Client
from rtc.demos.own_cluster import own_cluster

SEED = 20
PLACES = ("BAY-2-FRONT", "CLEAR-POINT-1")
MOVING_RAD_S = 0.05  # a joint faster than this moves
LATER_S = 0.15  # the halt comes at a random moment within this after the start
SHARE = 4  # the conditions after the first two get one halt for every so many

Disturbance = Callable[[Client], AbstractContextManager[None]]


class Bench:
    """One cluster, one arm, many halts."""

    def __init__(self, rtc: Client, rng: random.Random) -> None:
        self._rtc = rtc
        self._rng = rng
        self._place = 0
        self.missed = 0  # halts without a latency, or without confirmed rest

    def latencies_s(self, name: str, halts: int, disturbance: Disturbance, *, each: bool) -> list[float]:
        """`each`: the disturbance begins when the arm moves, and ends with the halt; otherwise it lasts throughout."""
        found: list[float] = []
        with nullcontext() if each else disturbance(self._rtc):
            while len(found) < halts:
                found += self._one(disturbance if each else None)
                if len(found) % 20 == 0:
                    print(f"  {name}: {len(found)} of {halts}", flush=True)
        return found

    def _one(self, disturbance: Disturbance | None) -> list[float]:
        """One halt of a moving arm; empty when the arm had come to its goal before the halt reached it."""
        self._place = 1 - self._place
        samples = self._rtc.telemetry(silence_s=10.0)
        command = self._rtc.submit(f"MOVE RIGHT-ARM TO {PLACES[self._place]}")
        moving = self._wait_for_motion(samples, command)
        if moving:
            with disturbance(self._rtc) if disturbance else nullcontext():
                time.sleep(self._rng.uniform(0.0, LATER_S))
                result = self._rtc.halt("RIGHT-ARM")
        self._rtc.wait(command, timeout_s=60.0)
        if not moving:
            return []
        if result.latency_s is None or not result.confirmed:
            self.missed += 1
            print(f"  missed: {result.message}", flush=True)
            return []
        return [result.latency_s] if result.moving else []

    def _wait_for_motion(self, samples: Iterator[m.Telemetry], command: str) -> bool:
        for sample in samples:
            arm = sample.arms["RIGHT-ARM"]
            if arm.primitive.startswith(f"{command}.") and max(map(abs, arm.velocities)) > MOVING_RAD_S:
                return True
        return False


@contextmanager
def nothing(_: Client) -> Iterator[None]:
    yield


@contextmanager
def saturated(rtc: Client) -> Iterator[None]:
    """A busy process for every core, and a stream of sentences through parser and elaborator."""
    busy = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(os.cpu_count() or 1)]
    for process in busy:
        process.start()
    with _stream(rtc.run_dir, "LIFT MACS-OLD BY 5 CM WITH LEFT-ARM"):  # refused: the hand is empty
        yield
    for process in busy:
        process.kill()
        process.join()


@contextmanager
def planning(rtc: Client) -> Iterator[None]:
    """The other arm is sent about, so that elaborator and binder plan all the time."""
    with _stream(rtc.run_dir, "STOW LEFT-ARM", "MOVE LEFT-ARM TO RACK-2-FRONT"):
        yield


@contextmanager
def hung_worker(rtc: Client) -> Iterator[None]:
    """The binder stops; a job for it is under way."""
    with _stopped(rtc, "binder@2"):
        command = rtc.submit("STOW LEFT-ARM")
        yield
    rtc.wait(command, timeout_s=60.0)


@contextmanager
def broker_stopped(rtc: Client) -> Iterator[None]:
    with _stopped(rtc, "broker"):
        yield


@contextmanager
def _stopped(rtc: Client, name: str) -> Iterator[None]:
    status = rtc.status()
    pid = next(p["pid"] for p in [*status["processes"], *status["workers"]] if p["name"] == name)
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


@contextmanager
def _stream(run_dir: Path, *texts: str) -> Iterator[None]:
    """A client of its own that says these sentences over and over."""
    over = threading.Event()

    def say() -> None:
        with Client(run_dir) as other:
            while not over.is_set():
                other.run_many(texts, parallel=False, timeout_s=60.0)

    thread = threading.Thread(target=say)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _spin() -> None:
    while True:
        pass


CONDITIONS: dict[str, tuple[Disturbance, bool, int]] = {  # name -> (what disturbs, for each halt anew?, one in)
    "idle": (nothing, False, 1),
    "saturated": (saturated, False, 1),
    "planning": (planning, False, SHARE),
    "hung_worker": (hung_worker, True, SHARE),
    "broker_stopped": (broker_stopped, True, SHARE),
}


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m benchmarks.halt", description=__doc__)
    arguments.add_argument("--halts", type=int, default=200)
    arguments.add_argument("--mcm", default="bullet", choices=("bullet", "kinematic"))
    given = arguments.parse_args()
    question("halt", "How long from the halt to the first decelerating tick of a moving arm?", seed=SEED)
    metrics: dict[str, float | None] = {}
    rows: list[tuple[str, str]] = []
    with own_cluster(mcm=given.mcm) as run_dir, Client(run_dir) as rtc:
        assert rtc.halt_ready()
        bench = Bench(rtc, random.Random(SEED))
        for name, (disturbance, each, one_in) in CONDITIONS.items():
            found = bench.latencies_s(name, max(1, given.halts // one_in), disturbance, each=each)
            metrics[f"{name}_p50_ms"] = percentile(found, 50) * 1e3
            metrics[f"{name}_p99_ms"] = percentile(found, 99) * 1e3
            rows.append((name, spread(found, 1e3, "ms")))
        metrics["missed"] = bench.missed
        rows.append(("missed", str(bench.missed)))
    finish("halt", metrics, rows)


if __name__ == "__main__":
    main()
