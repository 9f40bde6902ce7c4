"""At which rate, and how exactly, does S&P follow a slowly turning satellite in a running cluster?

The satellite turns by itself about an axis through its face (`rtc inject drift`). TRACK sends its pose at the period of
REPORT EVERY 0.1 SEC; each pose is compared with the truth at the time of its exposure. The arms rest, with exact
kinematics. With --busy N so many processes without pauses take the processors, with the priority of the cluster.

    python -m benchmarks.track [--seconds 20] [--busy 6]
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import threading
import time
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.report import finish, percentile, question
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.faults import Drifting
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

BODY, CAMERA = "SATELLITE", "CAMERA-3"
RATE_DEG_S = 1.0
STEP_S = 0.02  # between two readings of the truth
LIMIT_S = 120.0
TICKS_S = os.sysconf("SC_CLK_TCK")

Truth = tuple[float, list[float]]  # time, pose


@contextmanager
def turning(run_dir: Path, rate_deg_s: float = RATE_DEG_S) -> Iterator[list[Truth]]:
    """The satellite turns; the list has its true poses."""
    truths: list[Truth] = []
    end = threading.Event()

    def read() -> None:
        with Client(run_dir) as bench:
            while not end.wait(STEP_S):
                truth = bench.truth()
                truths.append((truth.at_s, truth.poses[BODY]))

    thread = threading.Thread(target=read)
    with Client(run_dir) as rtc:
        fault = Drifting(object=BODY, velocity=[0.0, 0.0, 0.0, math.radians(rate_deg_s), 0.0, 0.0])
        rtc.inject(fault)
        thread.start()
        try:
            yield truths
        finally:
            end.set()
            thread.join()
            rtc.undo_fault(fault.name)


@contextmanager
def busy(count: int) -> Iterator[None]:
    spinners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()


def at(truths: list[Truth], at_s: float) -> Array:
    """The true pose at this time, between two readings."""
    n = min(max(1, bisect_right(truths, at_s, key=lambda one: one[0])), len(truths) - 1)
    (before_s, before), (after_s, after) = truths[n - 1 : n + 1]
    return geometry.interpolate_all(before, after, np.array([(at_s - before_s) / (after_s - before_s)]))[0]


def processor_s(status: m.Status) -> float:
    """Processor time of S&P and of its drawing process, so far."""
    (station,) = [row.pid for row in status.processes if row.name == "S&P"]
    used = 0.0
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue  # not a process, or one that has just ended
        if entry.name == str(station) or fields[1] == str(station):
            used += (int(fields[11]) + int(fields[12])) / TICKS_S
    return used


def main() -> None:
    words = argparse.ArgumentParser(prog="python -m benchmarks.track", description=__doc__)
    words.add_argument("--seconds", type=float, default=20.0, help="duration of TRACK")
    words.add_argument("--busy", type=int, default=0, help="number of processes that take the processors")
    given = words.parse_args()
    seconds = given.seconds
    question("track", __doc__.split("\n", 1)[0])
    seen: list[tuple[float, m.ProgressNote]] = []

    def note(one: m.ProgressNote) -> None:
        if one.measured is not None and one.measured.sighting is not None:
            seen.append((time.monotonic(), one))

    with own_cluster(mcm="kinematic") as run_dir, Client(run_dir) as rtc:
        rtc.run(f"LOCATE {BODY} VIA {CAMERA}", timeout_s=LIMIT_S)  # starts the drawing process
        with turning(run_dir) as truths, busy(given.busy):
            before_s = processor_s(rtc.status())
            sentence = f"TRACK {BODY} FOR {seconds:g} SEC VIA {CAMERA} REPORT POSE AND EVERY 0.1 SEC"
            ended = rtc.run(sentence, note, LIMIT_S + seconds)
            used_s = processor_s(rtc.status()) - before_s
            load = os.getloadavg()[0]
    last = ended.outcome.measured.sighting if ended.outcome.measured is not None else None
    if last is None or len(seen) < 2:
        raise SystemExit(f"{sentence}: {ended.outcome.kind}, {ended.outcome.message}")
    off_mm, off_deg, late_ms, exposures = [], [], [], []
    for got_s, one in seen:
        sighting = one.measured.sighting  # type: ignore[union-attr]
        assert sighting is not None
        exposed_s = one.at_s - sighting.age_s
        true = at(truths, exposed_s)
        exposures.append(exposed_s)
        off_mm.append(1e3 * geometry.distance(sighting.pose, true))
        off_deg.append(math.degrees(geometry.angle(sighting.pose, true)))
        late_ms.append(1e3 * (got_s - exposed_s))
    hz = (len(seen) - 1) / (seen[-1][0] - seen[0][0])
    gaps_ms = [1e3 * (b - a) for a, b in pairwise(exposures)]
    rate_deg_s = math.degrees(math.hypot(*(last.velocity or [0.0] * 6)[3:]))
    metrics: dict[str, float | None] = {
        "rate_hz": hz,
        "gap_ms_p95": percentile(gaps_ms, 95),
        "gap_ms_max": max(gaps_ms),
        "processor_ms": 1e3 * used_s / last.pictures,
        "busy": given.busy,
        "load": load,
        "off_mm_p50": percentile(off_mm, 50),
        "off_mm_p95": percentile(off_mm, 95),
        "off_deg_p50": percentile(off_deg, 50),
        "off_deg_p95": percentile(off_deg, 95),
        "late_ms_p50": percentile(late_ms, 50),
        "late_ms_p95": percentile(late_ms, 95),
        "turn_deg_s": rate_deg_s,
    }
    gaps = f"between two exposures p95 {metrics['gap_ms_p95']:.0f} ms, at most {metrics['gap_ms_max']:.0f} ms"
    rows = [
        ("rate", f"{hz:.2f} Hz over {seconds:g} s at load {load:.1f}; {gaps}"),
        ("processor time of a picture", f"{metrics['processor_ms']:.1f} ms, S&P and the drawing process"),
        (
            "error",
            f"median {metrics['off_mm_p50']:.2f} mm, {metrics['off_deg_p50']:.2f} deg; "
            f"p95 {metrics['off_mm_p95']:.2f} mm, {metrics['off_deg_p95']:.2f} deg",
        ),
        ("from exposure to client", f"median {metrics['late_ms_p50']:.0f} ms, p95 {metrics['late_ms_p95']:.0f} ms"),
        ("rate of turning", f"{rate_deg_s:.2f} deg/s measured, {RATE_DEG_S:g} deg/s true"),
    ]
    finish("track", metrics, rows)


if __name__ == "__main__":
    main()
