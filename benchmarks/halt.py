"""How long from the operator's halt to the first decelerating tick of a moving arm?

    python -m benchmarks.halt [--halts 200] [--enter 50] [--mcm bullet] [--only saturated]
    python -m benchmarks.halt --after-do [--halts 1000]        # is each halt obeyed right after a sentence was sent?
    python -m benchmarks.halt --bring-up [--starts 20]         # and while the cluster and its arms come up?

The right arm moves to and fro and is halted at a random moment of each motion, `--halts` times in each condition:

idle            nothing else runs
saturated       every core has a busy process, and sentences stream through the workers
planning        the other arm is planned for all the time, and moves
hung_worker     a binder with a job is stopped
broker_stopped  SIGSTOP: only the estop socket is left
operator        an operator in an own process moves the arm, by 50 twists per second
shared          the same, while the program moves it along its path: MAINTAIN SHARED WRIST
compliant       both arms under impedance, the other one holding, and every core has a busy process
carrying        both arms under impedance carry one module, every core has a busy process, and both are halted at once;
                without a cluster: one socket stands for the broker, and sentences play no part

The condition is checked before and after each halt. A halt without it is repeated, and the table shows how many were.
In each condition it is timed twice: `--halts` times from the client's call, of a client whose sockets are connected,
and `--enter` times from Enter. Then each halt is a whole process `rtc halt`, from its start to the receipt of the order
by the MCM, to the first decelerating tick, and to its end, when it has printed that rest is confirmed.

Latency from the call is `decelerating_at_s - called_at_s`, both CLOCK_MONOTONIC of one machine. The former is read when
the MCM has handled the halt, right before the tick in which the arm brakes; until 0.1.0 it was the begin of that tick,
0.3 ms less. Of the slowest halts it prints when they were called, and the time until the MCM received them. Before the
receipt threads waited for a core; after it the MCM waited for its tick. Compare these times with a trace of the
scheduler: `perf sched record -k CLOCK_MONOTONIC`.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks.carrying import carrying
from benchmarks.grasp import wilson
from benchmarks.load import early_halts
from benchmarks.mcm import busy_cores
from benchmarks.report import finish, percentile, question, spread
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.client.halt import HaltResult
from rtc.client.hand_controller import PERIOD_S
from rtc.client.handle import CommandHandle
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.messages import WorkerKind
from rtc.runtime.process_table import processes

SEED = 20
PLACES = ("BAY-2-FRONT", "CLEAR-POINT-1")
MOVE = "MOVE RIGHT-ARM TO {place}"
COMPLIANT = " MAINTAIN STIFFNESS 400 N/M"
#: condition -> the sentence that moves the arm, if it is another one
SENTENCES = {
    "compliant": f"{MOVE}{COMPLIANT}",
    "operator": "GIVE RIGHT-ARM TO OPERATOR",
    "shared": f"{MOVE} MAINTAIN SHARED WRIST",
}
BY_HAND = ("operator", "shared")  # without a halt or DONE these sentences do not end
HAND_M_S, HAND_RAD_S = 0.08, 0.2  # of the operator
COUNTED_S = 0.3  # a message of the operator has counted within this time, also after a halt
MOVING_RAD_S = 0.05  # a faster joint counts as moving
MOTION_S = 20.0  # maximum wait for a motion
LATER_S = 0.15  # the halt comes at a random time within this after the start
LOOK_S = 0.02  # period of checking the job of a worker
SLOWEST = 5  # halts of each condition whose parts are printed
BUSY_S = 0.5  # limit until the stopped worker has a job; otherwise another worker has it

RTC = str(Path(sys.executable).with_name("rtc"))

Holds = Callable[[], bool]  # whether the condition holds
Disturbance = Callable[[Client], AbstractContextManager[Holds]]


class FromEnter(NamedTuple):
    """Times of one process `rtc halt` from its start (s)."""

    received_s: float  # the MCM has the order
    decelerating_s: float
    confirmed_s: float  # rest is confirmed, and the process has ended


class Bench:
    """One cluster, one arm, many halts."""

    def __init__(self, rtc: Client, rng: random.Random) -> None:
        self._rtc = rtc
        self._rng = rng
        self._place = 0
        self.condition = ""
        self.missed = 0  # halts without a latency, or without confirmed rest
        self.undisturbed = 0  # halts that did not count, because the condition did not hold
        self.slowest: list[tuple[float, float, float]] = []  # latency, time until receipt, time of the call; s
        self.by_process = False  # whether each halt is a process `rtc halt`
        self.from_enter: list[FromEnter] = []

    def latencies_s(self, name: str, halts: int, disturbance: Disturbance, *, each: bool) -> list[float]:
        """Latencies from the call. `each`: the disturbance lasts from the start of each motion to its halt; otherwise
        all the time."""
        found: list[float] = []
        began_s = time.monotonic()
        with nullcontext() if each else disturbance(self._rtc) as holds:
            while len(found) < halts:
                one = self._one(disturbance if each else lambda _: nullcontext(holds))
                found += one
                if one and (len(found) % 20 == 0 or len(found) == halts):
                    took_s = time.monotonic() - began_s
                    print(f"  {name}: {len(found)} of {halts}, {spread(found, 1e3, 'ms')}, {took_s:.0f} s", flush=True)
        return found

    def _one(self, disturbance: Disturbance) -> list[float]:
        """One halt of a moving arm; empty if it does not count.

        It does not count if the arm reached its goal before the halt, or if the condition did not hold.
        """
        self._place = 1 - self._place
        samples = self._rtc.telemetry(silence_s=10.0)
        command = self._rtc.submit(SENTENCES.get(self.condition, MOVE).format(place=PLACES[self._place]))
        if not self._wait_for_motion(samples, command):
            if self.condition in BY_HAND:
                self._rtc.halt("RIGHT-ARM")
            command.wait(timeout_s=60.0)
            return []
        with disturbance(self._rtc) as holds:
            time.sleep(self._rng.uniform(0.0, LATER_S))
            held = holds()
            entered_s = time.monotonic()
            result = self._halt_process() if self.by_process else self._rtc.halt("RIGHT-ARM")
            ended_s = time.monotonic()
            held = held and holds()
        command.wait(timeout_s=60.0)
        if result.latency_s is None or not result.confirmed:
            self.missed += 1
            print(f"  missed: {result.message}", flush=True)
            return []
        self.undisturbed += not held
        receipt_s = max((sub.receipt_s or 0.0 for sub in result.subsystems), default=0.0)
        if not (result.moving and held):
            return []
        if self.by_process:
            called_s = result.called_at_s - entered_s
            self.from_enter.append(FromEnter(called_s + receipt_s, called_s + result.latency_s, ended_s - entered_s))
        else:
            self.slowest = sorted([*self.slowest, (result.latency_s, receipt_s, result.called_at_s)])[-SLOWEST:]
        return [result.latency_s]

    def _halt_process(self) -> HaltResult:
        command = [RTC, "halt", "RIGHT-ARM", "--json", "--run-dir", str(self._rtc.run_dir)]
        done = subprocess.run(command, capture_output=True, check=False, timeout=MOTION_S)
        return msgspec.json.decode(done.stdout, type=HaltResult)

    def _wait_for_motion(self, samples: Iterator[m.Telemetry], command: CommandHandle) -> bool:
        """False: no motion was seen, because the goal was near or the command failed."""
        limit_s = time.monotonic() + MOTION_S
        begun = False
        for sample in samples:
            arm = sample.arms["RIGHT-ARM"]
            executing = arm.primitive.startswith(f"{command}.")
            if executing and max(map(abs, arm.velocities)) > MOVING_RAD_S:
                return True
            if begun > executing or time.monotonic() > limit_s:
                break
            begun = executing
        return False


@contextmanager
def nothing(_: Client) -> Iterator[Holds]:
    yield lambda: True


@contextmanager
def saturated(rtc: Client) -> Iterator[Holds]:
    """A busy process per core, and a stream of sentences through parser and elaborator."""
    busy = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(os.cpu_count() or 1)]
    for process in busy:
        process.start()
    with _stream(rtc.run_dir, "LIFT MACS-OLD BY 5 CM WITH LEFT-ARM") as streams:  # refused: the hand is empty
        yield lambda: streams() and all(process.is_alive() for process in busy)
    for process in busy:
        process.kill()
        process.join()


@contextmanager
def planning(rtc: Client) -> Iterator[Holds]:
    """The other arm moves, and paths to unreachable goals are planned for it, one after the other."""
    motions = _stream(rtc.run_dir, "STOW LEFT-ARM", "MOVE LEFT-ARM TO RACK-2-FRONT")
    with motions as moves, _stream(rtc.run_dir, "GRASP MACS-NEW WITH LEFT-ARM") as plans:
        yield lambda: moves() and plans()


@contextmanager
def operator(rtc: Client) -> Iterator[Holds]:
    """A process that moves the arm by hand whenever it is the operator's."""
    over, counted_at_s = multiprocessing.Event(), multiprocessing.Value("d", 0.0)
    process = multiprocessing.Process(target=_operate, args=(rtc.run_dir, over, counted_at_s), daemon=True)
    process.start()
    try:
        yield lambda: process.is_alive() and time.monotonic() - counted_at_s.value < COUNTED_S
    finally:
        over.set()
        process.join()


def _operate(run_dir: Path, over: Event, counted_at_s: Any) -> None:
    """Move up and turn in one request, down and back in the next."""
    with Client(run_dir) as rtc, rtc.hand("RIGHT-ARM", "BENCH") as hand:
        sign, grant = 1.0, ""
        while not over.wait(PERIOD_S):
            if not hand.request:
                continue
            assert hand.state is not None
            if hand.state.primitive != grant:
                sign, grant = -sign, hand.state.primitive
            if not hand.move([0.0, 0.0, sign * HAND_M_S, 0.0, 0.0, sign * HAND_RAD_S]):
                counted_at_s.value = time.monotonic()


@contextmanager
def hung_worker(rtc: Client) -> Iterator[Holds]:
    """Stop all binders (there may be more than at the start); one of them has a job that it has not begun."""
    with ExitStack() as stopped:
        names = [name for name in processes(rtc.run_dir) if name.startswith(f"{WorkerKind.BINDER}@")]
        hang = {name: stopped.enter_context(_stopped(rtc, name)) for name in names}
        command = rtc.submit("STOW LEFT-ARM")
        limit_s = time.monotonic() + BUSY_S
        while not (hung := _who_has(rtc, command, hang)) and time.monotonic() < limit_s:
            time.sleep(LOOK_S)
        yield lambda: bool(hung) and hang[hung]()
    command.wait(timeout_s=60.0)


@contextmanager
def broker_stopped(rtc: Client) -> Iterator[Holds]:
    with _stopped(rtc, "broker") as is_stopped:
        yield is_stopped


@contextmanager
def compliant(rtc: Client) -> Iterator[Holds]:
    with saturated(rtc) as busy:
        command = rtc.submit(f"HOLD LEFT-ARM{COMPLIANT}")
        limit_s = time.monotonic() + MOTION_S
        while not (begun := _executes(rtc, command)) and time.monotonic() < limit_s:
            time.sleep(LOOK_S)
        if not begun:
            raise SystemExit(f"{command} does not hold the arm: {command.wait(timeout_s=1.0).outcome.message}")
        yield lambda: busy() and _executes(rtc, command)
        rtc.halt("LEFT-ARM")
        command.wait(timeout_s=60.0)


def _executes(rtc: Client, command: CommandHandle) -> bool:
    return any(name.startswith(f"{command}.") for row in rtc.status().subsystems for name in row.executing)


@contextmanager
def _stopped(rtc: Client, name: str) -> Iterator[Holds]:
    """Signal by a file descriptor: the supervisor may kill the hung process, and its name and pid may be reused."""
    pid = processes(rtc.run_dir)[name].pid
    process = os.pidfd_open(pid)
    signal.pidfd_send_signal(process, signal.SIGSTOP)
    try:
        yield lambda: _is_stopped(pid)
    finally:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(process, signal.SIGCONT)
        os.close(process)


def _is_stopped(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b") ")[2].startswith(b"T")
    return False


def _who_has(rtc: Client, command: CommandHandle, names: Iterable[str]) -> str:
    """The worker among these that has a job of this command; empty if there is none."""
    busy = {worker.name: str(worker.busy_with) for worker in rtc.status().workers}
    return next((name for name in names if busy.get(name, "").startswith(f"{command}/")), "")


@contextmanager
def _stream(run_dir: Path, *texts: str) -> Iterator[Holds]:
    """A client in a process of its own that submits these sentences repeatedly."""
    over = multiprocessing.Event()
    process = multiprocessing.Process(target=_submit, args=(run_dir, texts, over), daemon=True)
    process.start()
    try:
        yield process.is_alive
    finally:
        over.set()
        process.join()


def _submit(run_dir: Path, texts: tuple[str, ...], over: Event) -> None:
    with Client(run_dir) as rtc:
        while not over.is_set():
            rtc.run_many(texts, parallel=False, timeout_s=60.0)


def _spin() -> None:
    while True:
        pass


def carried(halts: int, rng: random.Random) -> list[tuple[float, float, float]]:
    """Halts of two arms that carry one module: latency, time until receipt, time of the call; s."""
    found: list[tuple[float, float, float]] = []
    with carrying(Cell.load("swapout"), rng) as both, busy_cores():
        while len(found) < halts:
            found.append(both.halt_once())
            if len(found) % 20 == 0 or len(found) == halts:
                print(f"  {CARRYING}: {len(found)} of {halts}, {spread(_latencies(found), 1e3, 'ms')}", flush=True)
    return found


def _latencies(halts: Iterable[tuple[float, float, float]]) -> list[float]:
    return [latency_s for latency_s, _, _ in halts]


CARRYING = "carrying"
CONDITIONS: dict[str, tuple[Disturbance, bool]] = {  # name -> (disturbance, whether it starts anew for each halt)
    "idle": (nothing, False),
    "saturated": (saturated, False),
    "planning": (planning, False),
    "hung_worker": (hung_worker, True),
    "broker_stopped": (broker_stopped, True),
    "compliant": (compliant, False),
    "operator": (operator, False),
    "shared": (operator, False),
}


Figures = tuple[dict[str, float | None], list[tuple[str, str]]]  # metrics, rows


def latency(mcm: str, halts: int, enter: int, only: str | None) -> Figures:
    """How fast halts are in each condition, from the client's call and from Enter."""
    metrics: dict[str, float | None] = {}
    rows: list[tuple[str, str]] = []

    def measured(name: str, found: list[float], slowest: list[tuple[float, float, float]]) -> None:
        metrics[f"{name}_p50_ms"] = percentile(found, 50) * 1e3
        metrics[f"{name}_p99_ms"] = percentile(found, 99) * 1e3
        metrics[f"{name}_worst_ms"] = max(found) * 1e3
        for latency_s, receipt_s, at_s in reversed(slowest):
            print(f"  {name}: {latency_s * 1e3:.2f} ms, {receipt_s * 1e3:.2f} of them until receipt, at {at_s:.6f} s")
        rows.append((f"{name}: from the client's call", spread(found, 1e3, "ms")))

    def measured_from_enter(name: str, found: list[FromEnter]) -> None:
        words = {"received": "order with the MCM", "decelerating": "decelerating", "confirmed": "confirmed"}
        for (what, shown), times in zip(words.items(), zip(*found, strict=True), strict=True):
            metrics[f"{name}_enter_{what}_p50_ms"] = percentile(times, 50) * 1e3
            metrics[f"{name}_enter_{what}_p99_ms"] = percentile(times, 99) * 1e3
            rows.append((f"{name}: from Enter, {shown}", spread(times, 1e3, "ms")))

    if only != CARRYING:
        with own_cluster(mcm=mcm) as run_dir, Client(run_dir) as rtc:
            assert rtc.halt_ready()
            bench = Bench(rtc, random.Random(SEED))
            for name, (disturbance, each) in CONDITIONS.items():
                if only not in (None, name):
                    continue
                bench.slowest, bench.from_enter, bench.condition, bench.by_process = [], [], name, False
                measured(name, bench.latencies_s(name, halts, disturbance, each=each), bench.slowest)
                bench.by_process = True
                if enter:
                    bench.latencies_s(f"{name}, from Enter", enter, disturbance, each=each)
                    measured_from_enter(name, bench.from_enter)
            metrics["missed"] = bench.missed
            rows.append(("missed", str(bench.missed)))
            rows.append(("repeated: the condition did not hold", str(bench.undisturbed)))
    if only in (None, CARRYING) and mcm == "bullet":  # exact arms cannot comply
        carrying_halts = sorted(carried(halts, random.Random(SEED)))
        measured(CARRYING, _latencies(carrying_halts), carrying_halts[-SLOWEST:])
    return metrics, rows


def early(found: list[early_halts.Early], good: str) -> Figures:
    """How many early halts were as they must be, and what came of each."""
    right = sum(not one.wrong for one in found)
    low, high = wilson(right, len(found))
    metrics: dict[str, float | None] = {"halts": len(found), "right": right, "low": low, "high": high}
    rows = [(good, f"{right} of {len(found)} (Wilson {100 * low:.1f} to {100 * high:.1f} %)")]
    return metrics, [*rows, ("what came of them", early_halts.counted(found))]


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m benchmarks.halt", description=__doc__)
    arguments.add_argument("--halts", type=int, help="in each condition; default 200, and 1000 with --after-do")
    arguments.add_argument("--enter", type=int, default=50, help="halts from Enter in each condition")
    arguments.add_argument("--starts", type=int, default=20, help="of a cluster, with --bring-up")
    arguments.add_argument("--mcm", default="bullet", choices=("bullet", "kinematic"))
    which = arguments.add_mutually_exclusive_group()
    which.add_argument("--only", choices=(*CONDITIONS, CARRYING), help="one condition; results in halt_NAME")
    which.add_argument("--after-do", action="store_true", help="halts right after a sentence was sent")
    which.add_argument("--bring-up", action="store_true", help="halts while a cluster comes up")
    given = arguments.parse_args()
    rng = random.Random(SEED)
    if given.after_do:
        question(
            "halt", f"Is each halt obeyed in the first {early_halts.AFTER_S} s after a sentence was sent?", seed=SEED
        )
        with own_cluster(mcm=given.mcm) as run_dir:
            found = early_halts.after_do(run_dir, given.halts or 1000, rng)
        finish("halt_after_do", *early(found, "obeyed"))
    elif given.bring_up:
        question("halt", "Is each halt obeyed, or refused with a true reason, while a cluster comes up?", seed=SEED)
        found = early_halts.bring_up(given.mcm, given.starts, rng)
        finish("halt_bring_up", *early(found, "obeyed, or refused with a true reason"))
    else:
        question("halt", "How long from the halt to the first decelerating tick of a moving arm?", seed=SEED)
        figures = latency(given.mcm, given.halts or 200, given.enter, given.only)
        finish("halt" if given.only is None else f"halt_{given.only}", *figures)


if __name__ == "__main__":
    main()
