"""Do commands continue, or tell the truth, when workers, broker and MCM are killed, and at a halt under full load?

    python -m tests.campaigns.faults [--speed 1]

Each chapter says what it does, and checks what follows, with times. `chaos` kills processes from outside.
At real speed, because it strikes in the middle of motions: two minutes. `tests/processes/test_faults.py` has most of it
as tests.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

from rich.console import Console

from rtc.apps.demos.narrator import Narrator
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.runtime.process import die_with_parent
from rtc.runtime.process_table import processes
from tests.campaigns.chaos import Chaos, Strike

SEED = 20
STOWS = ["STOW RIGHT-ARM", "STOW LEFT-ARM"]
FAR = {"RIGHT-ARM": "MOVE RIGHT-ARM TO JOINTS -60 110 -160 0 50 0 DEG JOINT-MOTION",
       "LEFT-ARM": "MOVE LEFT-ARM TO JOINTS 60 110 -160 0 50 0 DEG JOINT-MOTION"}  # fmt: skip
PAIRS = [FAR["RIGHT-ARM"], FAR["LEFT-ARM"], *STOWS]
REFUSED = "LIFT MACS-OLD BY 5 CM"  # no hand holds it; it is parsed and planned before it is refused

COMMAND_S = 1200.0  # time limit of a command, on a machine with many busy processes
REST_S = 60.0  # limit for the arms to come to rest, on such a machine
# The next five are for an idle machine; on a busy one they are longer (`slowdown`).
BACK_S = 15.0
JOB_AGAIN_S = 1.0  # limit until another worker has done the job of a killed one; the time is printed
HUNG_S = 6.0  # limit until a stopped worker is detected and replaced
BROKER_S = 1.0
MCM_S = 3.0
HALT_S = 0.05  # from the call to the first decelerating tick, all cores busy
MOVING_RAD_S = 0.05
AT_SPEED_RAD_S = 0.2  # reached only between the start and the end of a motion
JUDGED_S = 0.25  # minimum time of observing an arm: a broker may be back before the next telemetry sample
PROBE_S = 0.02  # processor time of a measurement of the slowdown
TRIES = 4  # attempts to meet a worker in the milliseconds of a bind


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.campaigns.faults",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--speed", default="1", help="simulated seconds per second")
    narrator = Narrator(Console())
    narrator.chapter(
        "A cluster: broker, world database, eight workers (two of each kind), and two arms that move exactly"
    )
    with own_cluster(mcm="kinematic", speed=parser.parse_args().speed, dim=3) as run_dir:
        with Client(run_dir) as rtc, Client(run_dir) as asking:
            narrator.line(f"ready, run directory {run_dir}")
            _Faults(narrator, rtc, asking, Chaos(run_dir, random.Random(SEED))).run()
        pids = [row.pid for row in processes(run_dir).values() if row.pid]
    left = [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    narrator.check(f"the cluster has ended, {len(left)} of its {len(pids)} processes are left", not left)
    sys.exit(0 if narrator.passed() else 1)


class _Faults:
    """`rtc` submits the commands; `asking` queries the cluster meanwhile."""

    def __init__(self, narrator: Narrator, rtc: Client, asking: Client, chaos: Chaos) -> None:
        self.narrator, self.rtc, self.asking, self.chaos = narrator, rtc, asking, chaos

    def run(self) -> None:
        self.parallel()
        self.worker_killed()
        self.worker_hung()
        self.broker_killed()
        self.mcm_killed()
        self.halt_under_load()
        self.restarts()

    # --- the chapters ----------------------------------------------------------------------------------

    def parallel(self) -> None:
        self.narrator.chapter("Four commands at once: those for different arms run at the same time, the others wait")
        began_s = time.monotonic()
        ends = self.rtc.run_many([*STOWS, *PAIRS[:2]], timeout_s=COMMAND_S)
        took_s = time.monotonic() - began_s
        alone_s = sum(end.took_s for end in ends[2:])  # each includes the time of the command before it
        self.narrator.check("all four succeeded", all(end.outcome.kind is OutcomeKind.SUCCEEDED for end in ends))
        self.narrator.check(f"they took {took_s:.1f} s; one after the other {alone_s:.1f} s", took_s < 0.75 * alone_s)

    def worker_killed(self) -> None:
        self.narrator.chapter("kill -9 of a binder in the middle of a bind")
        caught = next(filter(None, map(self._strike_in_bind, TRIES * STOWS)), None)
        if caught is None:
            self.narrator.check("a binder was killed while it had a job", False)
            return
        strike, end, lost, done = caught
        self.narrator.line(f"{strike.name} (pid {strike.pid}) killed while it was binding {end.command}")
        self.narrator.line(f"{_ms(lost.at_s - strike.at_s)} later the broker knew and assigned its job to another")
        took_s = done.at_s - strike.at_s
        self.narrator.check(f"{done.node} finished it {_ms(took_s)} after the kill", took_s < JOB_AGAIN_S * slowdown())
        self.narrator.check(f"{end.command} {end.outcome.kind.value}", end.outcome.kind is OutcomeKind.SUCCEEDED)
        self._check_back(strike, BACK_S)

    def worker_hung(self) -> None:
        self.narrator.chapter("A binder hangs: SIGSTOP, alive but doing nothing")
        stopper = Chaos(self.rtc.run_dir, random.Random(SEED), stop=True)
        strike = stopper.strike("worker", "binder@2")
        if strike is None:
            self.narrator.check("a binder was stopped", False)
            return
        self.narrator.line(f"{strike.name} (pid {strike.pid}) stopped; now commands that need it")
        ends = self.rtc.run_many(PAIRS, timeout_s=COMMAND_S)
        self.narrator.check("four commands succeeded", all(end.outcome.kind is OutcomeKind.SUCCEEDED for end in ends))
        self._check_back(strike, HUNG_S, stopper)

    def broker_killed(self) -> None:
        self.narrator.chapter("kill -9 of the broker in the middle of a motion")
        arm = "RIGHT-ARM"
        with _watch(self.rtc, arm) as speeds:
            command = self.rtc.submit(FAR[arm])
            speeds.await_motion()
            strike = self.chaos.strike("broker")
            assert strike is not None
            self.narrator.line(f"broker (pid {strike.pid}) killed while {command} moves {arm}")
            end = command.wait(COMMAND_S)
        self._check_back(strike, BROKER_S)
        slowest = judged_speed_rad_s(speeds.samples, strike.at_s, strike.back_s or 0.0)
        self.narrator.check(f"the arm moved on meanwhile, at {slowest:.2f} rad/s or more", slowest > MOVING_RAD_S)
        self.narrator.check(f"the result still arrived: {end.command} {end.outcome.kind.value}",
                         end.outcome.kind is OutcomeKind.SUCCEEDED)  # fmt: skip
        started = [note for note in self.asking.trace(command.number).notes if note.kind is m.NoteKind.STARTED]
        self.narrator.check("it was sent to the arm once", len(started) == 1)

    def mcm_killed(self) -> None:
        self.narrator.chapter("kill -9 of the MCM itself in the middle of a motion")
        arm = "RIGHT-ARM"
        with _watch(self.rtc, arm) as speeds:
            command = self.rtc.submit("STOW RIGHT-ARM")
            speeds.await_motion()
            time.sleep(0.5)  # let it leave its last known position
            strike = self.chaos.strike("mcm")
            assert strike is not None
            end = command.wait(COMMAND_S)
        self.narrator.line(f"MCM (pid {strike.pid}) killed; {command}: {end.outcome.message}")
        self.narrator.check(
            f"{command} is reported as {end.outcome.kind.value}", end.outcome.kind is OutcomeKind.LOST_SUBSYSTEM
        )
        fact = self.rtc.world.view(keys=[f"{arm}.joints"]).facts[0]
        self.narrator.check(
            f"the world's position of {arm} is {fact.validity.value}", fact.validity is m.Validity.SUSPECT
        )
        self._check_back(strike, MCM_S)
        first = self.rtc.run("STOW RIGHT-ARM", timeout_s=COMMAND_S)
        if first.outcome.kind is OutcomeKind.FAILED:
            self.narrator.line(f"{first.command}: {first.outcome.message[:100]}... now the position is known")
            first = self.rtc.run("STOW RIGHT-ARM", timeout_s=COMMAND_S)
        self.narrator.check(f"the arm can be used again: {first.command} {first.outcome.kind.value}",
                         first.outcome.kind is OutcomeKind.SUCCEEDED)  # fmt: skip

    def halt_under_load(self) -> None:
        self.narrator.chapter("HALT ALL under full load: both arms move, every core is busy with planning")
        with _load(self.rtc.run_dir), _watch(self.rtc, "RIGHT-ARM") as speeds:
            commands = [self.rtc.submit(FAR[arm]) for arm in FAR]
            speeds.await_motion()
            time.sleep(0.3)
            halted = self.rtc.halt("ALL", timeout_s=REST_S)
            ends = [command.wait(COMMAND_S) for command in commands]
        latency_s = halted.latency_s if halted.latency_s is not None else float("inf")
        moving = ", ".join(halted.moving) or "nothing"
        self.narrator.check(
            f"first decelerating tick {_ms(latency_s)} after the call ({moving} moved)", latency_s < HALT_S
        )
        rest_s = max((sub.rest_s or 0.0 for sub in halted.subsystems), default=0.0)
        self.narrator.check(f"rest is confirmed, {_ms(rest_s)} after the call", halted.confirmed)
        known = {end.outcome.kind for end in ends}
        self.narrator.check("the commands are reported as halted", known == {OutcomeKind.HALTED})
        end = self.rtc.run("STOW RIGHT-ARM", timeout_s=COMMAND_S)
        self.narrator.check(f"a new command works at once: {end.command} {end.outcome.kind.value}",
                         end.outcome.kind is OutcomeKind.SUCCEEDED)  # fmt: skip

    def restarts(self) -> None:
        self.narrator.chapter("What the supervisor did")
        for row in processes(self.rtc.run_dir).values():
            if row.restarts:
                self.narrator.line(f"{row.name}: {row.restarts} restart{'s' * (row.restarts > 1)}, {row.state}")
        live = self.asking.status().commands_live
        self.narrator.check(f"{live} commands have no end", live == 0)

    # --- inside ----------------------------------------------------------------------------------------

    def _strike_in_bind(self, text: str) -> tuple[Strike, m.CommandEnded, m.ProgressNote, m.ProgressNote] | None:
        """Run this sentence, and kill the binder that has its job; None if the binder was faster.

        Returns the strike, the end, the note about the new assignment, and the note of the worker that did the job.
        """
        struck: list[Strike] = []

        def on_note(note: m.ProgressNote) -> None:
            if note.phase is m.Phase.BINDING and not struck:
                for worker in self.asking.status().workers:
                    if worker.kind == "binder" and worker.busy_with.partition("/")[0] == note.command:
                        strike = self.chaos.strike("worker", worker.name)
                        struck.extend([strike] if strike else [])

        end = self.rtc.run(text, on_note, COMMAND_S)
        notes = self.asking.trace(end.command).notes
        for lost, done in pairwise(notes):
            if struck and lost.kind is m.NoteKind.WORKER_LOST and lost.about == struck[0].name:
                return struck[0], end, lost, done
        return None

    def _check_back(self, strike: Strike, limit_s: float, chaos: Chaos | None = None) -> None:
        chaos = chaos or self.chaos
        slower = slowdown()
        give_up_s = time.monotonic() + BACK_S * slower
        while strike.back_s is None and time.monotonic() < give_up_s:
            chaos.returned()
            time.sleep(0.002)
        if strike.back_s is None:
            self.narrator.check(f"{strike.name} is back", False)
        else:
            took = f"{strike.name} was back, as pid {strike.new_pid}, after {_ms(strike.back_s)}"
            self.narrator.check(took, strike.back_s < limit_s * slower)


def slowdown() -> float:
    """How much longer a computation takes now than on an idle machine: by the clock over processor time, at least 1."""
    began_s, worked_s = time.monotonic(), time.thread_time()
    while time.thread_time() - worked_s < PROBE_S:
        pass
    return max(1.0, (time.monotonic() - began_s) / (time.thread_time() - worked_s))


class _Speeds:
    """Speed of an arm, sample by sample, received in a thread of its own."""

    def __init__(self, rtc: Client, arm: str) -> None:
        self._client = Client(rtc.run_dir, need_broker=False)
        self._arm, self.samples = arm, list[tuple[float, float]]()  # (time, rad/s)
        self._moves, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        for sample in self._client.telemetry():
            speed = max(map(abs, sample.arms[self._arm].velocities))
            self.samples.append((sample.at_s, speed))
            if speed > AT_SPEED_RAD_S:
                self._moves.set()
            if self._over:
                break

    def await_motion(self) -> None:
        self._moves.wait(COMMAND_S)

    def close(self) -> None:
        self._over = True
        self._thread.join(2.0)
        self._client.close()


def judged_speed_rad_s(samples: Iterable[tuple[float, float]], struck_s: float, back_s: float) -> float:
    """The lowest speed of the samples (time, rad/s) from a strike until the process was back; 0 without samples.

    At least JUDGED_S are observed.
    """
    until_s = struck_s + max(back_s, JUDGED_S)
    return min((speed for at_s, speed in samples if struck_s <= at_s <= until_s), default=0.0)


@contextmanager
def _watch(rtc: Client, arm: str) -> Iterator[_Speeds]:
    speeds = _Speeds(rtc, arm)
    try:
        yield speeds
    finally:
        speeds.close()


@contextmanager
def _load(run_dir: Path) -> Iterator[None]:
    """A busy process per core, and a continuous stream of sentences through parsers and elaborators."""
    over = threading.Event()

    def submit() -> None:
        with Client(run_dir) as other:
            while not over.is_set():
                other.run_many([REFUSED] * 4, timeout_s=COMMAND_S)

    talker = threading.Thread(target=submit)
    me = os.getpid()
    burn = [sys.executable, "-c", "while True: pass"]
    burning = [subprocess.Popen(burn, preexec_fn=lambda: die_with_parent(me)) for _ in range(os.cpu_count() or 1)]
    talker.start()
    try:
        yield
    finally:
        over.set()
        for process in burning:
            process.kill()
            process.wait()
        talker.join()


def _ms(seconds: float) -> str:
    return (
        f"{seconds * 1e3:.1f} ms" if seconds < 0.1 else f"{seconds * 1e3:.0f} ms" if seconds < 2 else f"{seconds:.1f} s"
    )


if __name__ == "__main__":
    main()
