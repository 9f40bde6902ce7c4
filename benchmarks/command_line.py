"""How long does a person at a terminal wait for `rtc`, from Enter to its order or its first line?

    python -m benchmarks.command_line [--runs 20]

Each command is a whole process, started as a shell starts it, in turn with an empty `python -c pass` of the same
environment. Ratios are those to this empty process. The cluster has exact arms (`--mcm kinematic`). `halt` is timed
until its order is on the wire: a socket of this benchmark stands there in the place of the broker's. The others are
timed until the first byte that they print; so what the cluster does for them is part of it. The conditions: idle, and
every core with a busy process.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import zmq

from benchmarks.report import finish, percentile, question
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import OutcomeKind

LIMIT_S = 30.0
RTC = str(Path(sys.executable).with_name("rtc"))
EMPTY, HALT = "python -c pass", "halt"
SENTENCE = "HOLD RIGHT-ARM FOR 0.1 SEC"
COMMANDS: dict[str, list[str]] = {
    "do": ["do", SENTENCE],
    "status": ["status"],
    "why": ["why", "C-1"],
    "parse": ["parse", SENTENCE],
    "names": ["names", "places"],
    "test": ["test", SENTENCE],
    "--version": ["--version"],
}
TARGETS = {HALT: (2.0, 3.0)} | dict.fromkeys(COMMANDS, (4.0, None))  # p50, p99: times the empty process

Timed = Callable[[], float]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.command_line", description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="of each command, in each condition")
    given = parser.parse_args()
    question("command_line", "how long from Enter to the order or the first line of rtc?")
    metrics: dict[str, float | None] = {}
    rows: list[tuple[str, str]] = []
    with own_cluster(mcm="kinematic") as run_dir, Client(run_dir) as rtc, _order_socket() as until_order:
        assert rtc.run(SENTENCE).outcome.kind is OutcomeKind.SUCCEEDED  # C-1, for `why`; workers are warm
        environment = {**os.environ, "RTC_RUN_DIR": str(run_dir)}
        timed: dict[str, Timed] = {EMPTY: _until_end, HALT: until_order}
        timed |= {name: _until_line([RTC, *words], environment) for name, words in COMMANDS.items()}
        for condition, busy in (("idle", 0), ("busy", os.cpu_count() or 1)):
            with _busy(busy):
                found = _in_turn(timed, given.runs)
            for name, took_s in found.items():
                rows.append(_row(condition, name, took_s, found[EMPTY], metrics))
                print(f"  {rows[-1][0]}: {rows[-1][1]}", flush=True)
    finish("command_line", metrics, rows)


def _in_turn(timed: dict[str, Timed], runs: int) -> dict[str, list[float]]:
    """The times of each command (s), one after the other, so that all meet the same load."""
    found: dict[str, list[float]] = {name: [] for name in timed}
    for _ in range(runs):
        for name, measure in timed.items():
            found[name].append(measure())
    return found


def _row(
    condition: str, name: str, took_s: list[float], empty_s: list[float], metrics: dict[str, float | None]
) -> tuple[str, str]:
    """The row of a command, whose figures are added to the metrics."""
    times = [percentile(took_s, p) / percentile(empty_s, p) for p in (50, 99)]
    key = f"{condition}_{'empty' if name == EMPTY else name.strip('-')}"
    metrics[f"{key}_p50_ms"], metrics[f"{key}_p50_times"], metrics[f"{key}_p99_times"] = (
        1e3 * percentile(took_s, 50),
        *times,
    )
    words = f"p50 {1e3 * percentile(took_s, 50):.0f} ms, p99 {1e3 * percentile(took_s, 99):.0f} ms of {len(took_s)}"
    if name == EMPTY:
        return f"{condition}: {name}", words
    targets = [f"{most:g}" for most in TARGETS[name] if most is not None]
    return (
        f"{condition}: rtc {name}",
        f"{words}; {times[0]:.2f} and {times[1]:.2f} times (target {' and '.join(targets)})",
    )


def _until_end() -> float:
    began_s = time.perf_counter()
    subprocess.run([sys.executable, "-c", "pass"], check=True, timeout=LIMIT_S)
    return time.perf_counter() - began_s


def _until_line(command: list[str], environment: dict[str, str]) -> Timed:
    """Times a command until the first byte that it prints."""

    def timed() -> float:
        began_s = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment) as process:
            assert process.stdout is not None
            assert os.read(process.stdout.fileno(), 1), f"{command} prints nothing"
            took_s = time.perf_counter() - began_s
            process.stdout.read()
        assert process.returncode == 0, command
        return took_s

    return timed


@contextmanager
def _order_socket() -> Iterator[Timed]:
    """Times `rtc halt` until a socket in the place of the broker's has its order."""
    with (
        tempfile.TemporaryDirectory(prefix="rtc-") as folder,
        zmq.Context() as context,
        context.socket(zmq.ROUTER) as broker,
    ):
        broker.bind(f"ipc://{folder}/halt.sock")

        def timed() -> float:
            began_s = time.perf_counter()
            command = [RTC, "halt", "--timeout", "0.01", "--run-dir", folder]
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL):
                assert broker.poll(1e3 * LIMIT_S), "no order has come"
                took_s = time.perf_counter() - began_s
                broker.recv_multipart()
            return took_s

        yield timed


@contextmanager
def _busy(processes: int) -> Iterator[None]:
    spinning = [multiprocessing.Process(target=_spin, daemon=True) for _ in range(processes)]
    for process in spinning:
        process.start()
    yield
    for process in spinning:
        process.kill()
        process.join()


def _spin() -> None:
    while True:
        pass


if __name__ == "__main__":
    main()
