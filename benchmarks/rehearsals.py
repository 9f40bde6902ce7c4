"""What does a TEST cost, and does it slow real commands?

    python -m benchmarks.rehearsals [--rounds 4] [--seconds 10]

First the 40 lines of the swap-out are tested as one list in a cluster (`rtc test FILE`), three times: wall time,
processor time of the rehearser, orders to subsystems, and facts written. A line that is refused is tested with its
repairs. Then short motions are commanded one after the other on exact arms, alternately alone and beside a second
client that sends 20 tests a second. Latency: from the sentence to its outcome.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median

from benchmarks.report import finish, percentile, question, spread
from broker.decisions.events import PrimitiveEnded, PrimitiveStarted
from broker.persistence.journal import Journal
from examples.swapout import swapout
from rtc.apps.cli import sentence_files
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.client.rehearsing import rehearse
from rtc.protocol.outcomes import OutcomeKind

SWAP_OUT = swapout.LINES
REPEATED = 3
PER_S = 20.0
BESIDE = "TEST MOVE LEFT-ARM TO CLEAR-POINT-1"
MOTIONS = ("MOVE RIGHT-ARM BY 2 CM ALONG UP", "MOVE RIGHT-ARM BY 2 CM ALONG DOWN")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=10.0, help="of one round")
    parser.add_argument("--beside", metavar="RUN_DIR", help="only send tests to this cluster, until killed")
    chosen = parser.parse_args()
    if chosen.beside:
        send_tests(Path(chosen.beside))
        return
    question("rehearsals", "What does a TEST cost, and does it slow real commands?")
    with own_cluster(cell="servicing", speed="max") as run_dir:
        metrics = the_list(run_dir)
    with own_cluster(mcm="kinematic", speed="max") as run_dir:
        metrics |= beside_motions(run_dir, chosen.rounds, chosen.seconds)
    finish("rehearsals", metrics)


def the_list(run_dir: Path) -> dict[str, float | None]:
    lines = sentence_files.read(SWAP_OUT)
    texts, labels = [line.text for line in lines], [line.label for line in lines]
    wall_s, processor_s = [], []
    with Client(run_dir) as rtc:
        rtc.run(f"TEST {MOTIONS[0]}")
        pid = next(int(row.pid) for row in rtc.status().processes if row.name == "rehearser@0")
        version = rtc.world.view().version
        for _ in range(REPEATED):
            began_s, before_s = time.monotonic(), _processor_s(pid)
            ended = rehearse(rtc, texts, labels, keep_going=True)
            wall_s.append(time.monotonic() - began_s)
            processor_s.append(_processor_s(pid) - before_s)
        written = rtc.world.view().version - version
    events = [event for batch in Journal.read_only(run_dir / "journal.db").batches(0) for event in batch]
    feasible = [one for one in ended if one.outcome.kind is OutcomeKind.SUCCEEDED]
    print(f"  the list: {median(wall_s):.2f} s, {median(processor_s):.2f} s of the rehearser; {len(feasible)} feasible")
    return {
        "lines": len(ended),
        "feasible": len(feasible),
        "list_s": median(wall_s),
        "list_processor_s": median(processor_s),
        "list_first_s": wall_s[0],
        "orders_to_subsystems": sum(isinstance(event, PrimitiveStarted | PrimitiveEnded) for event in events),
        "facts_written": written,
    }


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def beside_motions(run_dir: Path, rounds: int, seconds: float) -> dict[str, float | None]:
    took_s: dict[str, list[float]] = {"alone": [], "beside": []}
    ratios = []
    with Client(run_dir) as rtc:
        _commands(rtc, 2.0)  # the first ones compile programs
        for n in range(rounds):
            order = ("alone", "beside") if n % 2 == 0 else ("beside", "alone")
            found = {how: _round(rtc, run_dir, how, seconds) for how in order}
            for how, samples in found.items():
                took_s[how] += samples
            ratios.append(median(found["beside"]) / median(found["alone"]))
    for how, samples in took_s.items():
        print(f"  {how}: {spread(samples, 1e3, 'ms')}")
    return {
        **{f"{how}_p50_ms": 1e3 * percentile(samples, 50) for how, samples in took_s.items()},
        **{f"{how}_p99_ms": 1e3 * percentile(samples, 99) for how, samples in took_s.items()},
        "p50_ratio": median(ratios),
        "p50_ratio_least": min(ratios),
        "p50_ratio_most": max(ratios),
    }


def _round(rtc: Client, run_dir: Path, how: str, seconds: float) -> list[float]:
    if how == "alone":
        return _commands(rtc, seconds)
    tests = subprocess.Popen([sys.executable, "-m", "benchmarks.rehearsals", "--beside", str(run_dir)])
    try:
        _commands(rtc, 2.0)  # until the other client sends
        return _commands(rtc, seconds)
    finally:
        tests.kill()
        tests.wait()


def _commands(rtc: Client, seconds: float) -> list[float]:
    took_s: list[float] = []
    ends_s = time.monotonic() + seconds
    while time.monotonic() < ends_s or len(took_s) % len(MOTIONS):
        began_s = time.monotonic()
        outcome = rtc.run(MOTIONS[len(took_s) % len(MOTIONS)]).outcome
        assert outcome.kind is OutcomeKind.SUCCEEDED, outcome
        took_s.append(time.monotonic() - began_s)
    return took_s


def send_tests(run_dir: Path) -> None:
    with Client(run_dir) as rtc:
        due_s = time.monotonic()
        while True:
            rtc.run(BESIDE)
            due_s = max(due_s + 1.0 / PER_S, time.monotonic() - 1.0)
            time.sleep(max(0.0, due_s - time.monotonic()))


if __name__ == "__main__":
    main()
