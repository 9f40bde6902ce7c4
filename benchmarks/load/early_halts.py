"""Halts that come early: right after a sentence was sent, and while a cluster comes up. Judged by telemetry.

A halt is obeyed if its rest is confirmed, the sentence that was sent before it ends halted, and no joint moves for
`WATCHED_S` after the confirmation. Nothing else may come of a halt but a refusal whose reason is true.
"""

from __future__ import annotations

import random
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Container
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec
import zmq

from rtc.client.client import Client
from rtc.client.halt import HaltResult
from rtc.client.handle import CommandHandle
from rtc.protocol import messages as m
from rtc.protocol.outcomes import ClusterError, OutcomeKind
from rtc.protocol.wire import reader
from rtc.runtime.settings import ENDPOINTS
from tests.campaigns.chaos import Chaos

AFTER_S = 0.2  # halts after a sentence come within this time
STILL_RAD_S = 0.01  # a slower joint rests: an arm that holds against gravity in physics stays below 0.005
WATCHED_S = 0.1
ENDS_S = 20.0  # maximum wait for the end of a halted command
UP_S = 120.0
AFTER_READY_S = 1.0  # halts go on this long after `rtc up -d` has returned, and after the kill of the MCM
PAUSE_S = 0.1  # maximum pause between two halts, and between a sentence and its halt
SENTENCES = (
    "MOVE RIGHT-ARM TO BAY-2-FRONT",
    "GRASP MACS-NEW WITH RIGHT-ARM",
    "MOVE RIGHT-ARM TO CLEAR-POINT-1",
    "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SPEED 2 CM/S",
)
RTC = str(Path(sys.executable).with_name("rtc"))
CALLED = ("ALL", "RIGHT-ARM", "the command")  # scopes, in turn
OBEYED = "obeyed"

_read = reader(m.Telemetry)


class Arms:
    """What telemetry shows of the arms of a run directory, also of one whose cluster is not there yet."""

    def __init__(self, run_dir: Path) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.setsockopt(zmq.RECONNECT_IVL, 10)  # ms
        self._socket.subscribe(b"")
        self._socket.connect(f"ipc://{run_dir / ENDPOINTS['telemetry']}")

    def since(self, at_s: float) -> list[m.Telemetry]:
        """The samples that have arrived and are not older."""
        samples = []
        while self._socket.poll(0):
            samples.append(_read(self._socket.recv_multipart()))
        return [sample for sample in samples if sample.at_s >= at_s]

    def moves(self, from_s: float) -> str:
        """Which arm moves from then on until `WATCHED_S` from now; empty: none."""
        time.sleep(WATCHED_S)
        for sample in self.since(from_s):
            for name, arm in sample.arms.items():
                if (speed := max(map(abs, arm.velocities))) > STILL_RAD_S:
                    return f"{name} moves at {speed:.3f} rad/s, {sample.at_s - from_s:.3f} s later, {arm.primitive}"
        return ""

    def close(self) -> None:
        self._context.destroy(linger=0)


class Early(NamedTuple):
    """One halt. `came_to`: "obeyed", why it was refused, or what is wrong (`wrong`)."""

    after_s: float  # since the sentence was sent, or since `rtc up`
    came_to: str
    wrong: bool = False


def after_do(run_dir: Path, halts: int, rng: random.Random) -> list[Early]:
    """Halts in the first `AFTER_S` after a sentence was sent, evenly spread. A sentence that ended before its halt
    was called is given again."""
    delays_s = [AFTER_S * (n + rng.random()) / halts for n in range(halts)]
    rng.shuffle(delays_s)
    found: list[Early] = []
    arms = Arms(run_dir)
    with Client(run_dir) as rtc:
        assert rtc.halt_ready()
        while len(found) < halts:
            n = len(found)
            if (one := _after_one(rtc, arms, n, delays_s[n])) is not None:
                found.append(one)
                if one.wrong:
                    print(f"  {one}", flush=True)
                if len(found) % 100 == 0:
                    print(f"  {len(found)} of {halts}: {counted(found)}", flush=True)
    arms.close()
    return found


def _after_one(rtc: Client, arms: Arms, n: int, delay_s: float) -> Early | None:
    """None: the sentence had ended before the halt."""
    scope = CALLED[n % len(CALLED)]
    sent_s = time.monotonic()
    command = rtc.begin(SENTENCES[n // len(CALLED) % len(SENTENCES)])
    if scope == "the command":  # its number must be known
        rtc.receive_until(lambda: command.answered, ENDS_S, "the sentence was not accepted")
        scope = command.number
    time.sleep(max(0.0, sent_s + delay_s - time.monotonic()))
    if command.ended is not None:
        return None
    called_s = time.monotonic()
    came_to, wrong = _came_to(rtc.halt(scope), command, arms, {OutcomeKind.HALTED})
    return Early(called_s - sent_s, came_to, wrong=wrong or came_to != OBEYED)


def _came_to(
    result: HaltResult, command: CommandHandle | None, arms: Arms, ends: Container[OutcomeKind]
) -> tuple[str, bool]:
    """What came of a halt whose order was taken, and whether that is wrong. `ends`: how its sentence may end."""
    rest_s = result.called_at_s + max((one.rest_s or 0.0 for one in result.subsystems), default=0.0)
    if result.confirmed and (moves := arms.moves(rest_s)):
        return f"confirmed, and {moves}", True
    outcome = None if command is None else command.wait(ENDS_S).outcome
    if outcome is not None and outcome.kind not in ends:
        return f"its sentence {outcome.kind}: {outcome.message}", True
    return (OBEYED if result.confirmed else f"not confirmed: {result.message}"), False


def counted(found: list[Early]) -> str:
    return ", ".join(f"{count} {words}" for words, count in Counter(one.came_to for one in found).most_common())


# --- while a cluster comes up ------------------------------------------------------------------------


def bring_up(mcm: str, ups: int, rng: random.Random) -> list[Early]:
    """Halts by `rtc halt` from the start of `rtc up -d` on, and while a killed MCM comes up again. Sentences are sent
    as soon as the broker takes them."""
    found: list[Early] = []
    for n in range(ups):
        with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
            found += _one_up(Path(folder), mcm, rng)
        print(f"  {n + 1} of {ups} starts, {len(found)} halts: {counted(found)}", flush=True)
    return found


def _one_up(run_dir: Path, mcm: str, rng: random.Random) -> list[Early]:
    found: list[Early] = []
    starting = subprocess.Popen([RTC, "up", "--mcm", mcm, "--run-dir", str(run_dir), "-d"], stdout=subprocess.DEVNULL)
    arms, sender = Arms(run_dir), _Sender(run_dir)
    try:
        began_s = time.monotonic()
        _halts(found, run_dir, arms, sender, rng, lambda: starting.poll() is None, began_s)
        assert starting.wait() == 0, "rtc up failed"
        _halts(found, run_dir, arms, sender, rng, lambda: False, began_s)
        Chaos(run_dir, rng).strike("mcm")
        _halts(found, run_dir, arms, sender, rng, lambda: False, began_s)
    finally:
        starting.wait(UP_S)
        sender.close()
        arms.close()
        subprocess.run([RTC, "down", "--run-dir", str(run_dir)], stdout=subprocess.DEVNULL, timeout=UP_S)
    return found


class _Sender:
    """A client that connects as soon as the broker answers, in a thread, and then has one sentence in progress."""

    def __init__(self, run_dir: Path) -> None:
        self._run_dir, self._over = run_dir, threading.Event()
        self._client: Client | None = None
        self._command: CommandHandle | None = None
        self._count = 0
        self._thread = threading.Thread(target=self._connect)
        self._thread.start()

    def _connect(self) -> None:
        while not self._over.is_set() and self._client is None:
            with suppress(ClusterError, OSError):
                self._client = Client(self._run_dir)

    def send(self) -> CommandHandle | None:
        """The sentence in progress, a new one if none was; None: the broker takes none yet."""
        if self._client is None:
            return None
        if self._command is None or self._command.ended is not None:
            self._count += 1
            self._command = self._client.submit(SENTENCES[self._count % len(SENTENCES)])
        return self._command

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        if self._client is not None:
            self._client.close()


def _halts(
    found: list[Early],
    run_dir: Path,
    arms: Arms,
    sender: _Sender,
    rng: random.Random,
    goes_on: Callable[[], bool],
    began_s: float,
) -> None:
    """Halts while something goes on, and `AFTER_READY_S` longer."""
    over_s = 0.0
    while goes_on() or time.monotonic() < (over_s := over_s or time.monotonic() + AFTER_READY_S):
        command = sender.send()
        time.sleep(rng.uniform(0.0, PAUSE_S))
        listened, alive = _listens(run_dir), bool(arms.since(0.0))
        called_s = time.monotonic()
        done = subprocess.run([RTC, "halt", "--json", "--run-dir", str(run_dir)], capture_output=True, text=True)
        came_to, wrong = _judged(done, command, arms, listened and _listens(run_dir), alive)
        found.append(Early(called_s - began_s, came_to, wrong))
        if wrong:
            print(f"  {found[-1]}", flush=True)


def _listens(run_dir: Path) -> bool:
    """Whether a process takes halts at one of the sockets for them."""
    for name in ("halt", "estop"):
        with socket.socket(socket.AF_UNIX) as probe, suppress(OSError):
            probe.connect(str(run_dir / ENDPOINTS[name]))
            return True
    return False


def _judged(
    done: subprocess.CompletedProcess[str], command: CommandHandle | None, arms: Arms, listened: bool, alive: bool
) -> tuple[str, bool]:
    """What came of the halt, and whether that is wrong. `listened`: a socket for halts was there before and after it.
    `alive`: the arms had sent telemetry right before it. Its reason is true if the halt could not be obeyed."""
    try:
        result = msgspec.json.decode(done.stdout, type=HaltResult)
    except msgspec.DecodeError:
        true = done.returncode != 0 and bool(done.stderr) and not listened
        reason = re.sub(r" (in|--run-dir) /[^ ;]*", "", done.stderr.strip().removeprefix("rtc: "))
        return f"refused: {reason}", not true
    came_to, wrong = _came_to(result, command, arms, set(OutcomeKind) - {OutcomeKind.SUCCEEDED})
    alive = alive and bool(arms.since(result.called_at_s))
    silent = not result.confirmed and (alive or done.returncode == 0)
    return came_to + ("" if command else ", no sentence given yet"), wrong or silent
