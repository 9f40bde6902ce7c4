"""At which rate, and how exactly, does S&P follow a slowly turning satellite in a running cluster?

The satellite is turned in small steps about an axis through its face, by the test bench. TRACK sends its pose at the
period of REPORT EVERY 0.1 SEC; each pose is compared with the truth at the time of its exposure. The arms rest, with
exact kinematics.

    python -m benchmarks.track [--seconds 20]
"""

from __future__ import annotations

import argparse
import math
import threading
import time
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.report import finish, percentile, question
from rtc.client.client import Client
from rtc.demos.own_cluster import own_cluster
from rtc.protocol import messages as m
from rtc.robot import geometry

BODY, CAMERA = "SATELLITE", "CAMERA-3"
RATE_DEG_S = 1.0
STEP_S = 0.025  # between two steps of the satellite
LIMIT_S = 120.0

Truth = tuple[float, list[float]]  # time, pose


@contextmanager
def turning(run_dir: Path) -> Iterator[list[Truth]]:
    """The satellite turns; the list has its true poses."""
    truths: list[Truth] = []
    end = threading.Event()

    def turn() -> None:
        with Client(run_dir) as bench:
            begun_s, turned = time.monotonic(), 0.0
            while not end.wait(STEP_S):
                wanted = math.radians(RATE_DEG_S) * (time.monotonic() - begun_s)
                bench.displace(BODY, [0.0, 0.0, 0.0, wanted - turned, 0.0, 0.0])
                turned = wanted
                truths.append((time.monotonic(), bench.truth().poses[BODY]))

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        yield truths
    finally:
        end.set()
        thread.join()


def main() -> None:
    words = argparse.ArgumentParser(prog="python -m benchmarks.track", description=__doc__)
    words.add_argument("--seconds", type=float, default=20.0, help="duration of TRACK")
    seconds = words.parse_args().seconds
    question("track", __doc__.split("\n", 1)[0])
    seen: list[tuple[float, m.ProgressNote]] = []

    def note(one: m.ProgressNote) -> None:
        if one.measured is not None and one.measured.sighting is not None:
            seen.append((time.monotonic(), one))

    with own_cluster(mcm="kinematic") as run_dir, Client(run_dir) as rtc:
        rtc.run(f"LOCATE {BODY} VIA {CAMERA}", timeout_s=LIMIT_S)  # starts the drawing process
        with turning(run_dir) as truths:
            sentence = f"TRACK {BODY} FOR {seconds:g} SEC VIA {CAMERA} REPORT POSE AND EVERY 0.1 SEC"
            ended = rtc.run(sentence, note, LIMIT_S + seconds)
    if ended.outcome.measured is None or ended.outcome.measured.sighting is None or len(seen) < 2:
        raise SystemExit(f"{sentence}: {ended.outcome.kind}, {ended.outcome.message}")
    times = [at_s for at_s, _ in truths]
    off_mm, off_deg, late_ms = [], [], []
    for got_s, one in seen:
        sighting = one.measured.sighting  # type: ignore[union-attr]
        assert sighting is not None
        exposed_s = one.at_s - sighting.age_s
        true = truths[min(bisect_left(times, exposed_s), len(truths) - 1)][1]
        off_mm.append(1e3 * geometry.distance(sighting.pose, true))
        off_deg.append(math.degrees(geometry.angle(sighting.pose, true)))
        late_ms.append(1e3 * (got_s - exposed_s))
    hz = (len(seen) - 1) / (seen[-1][0] - seen[0][0])
    velocity = ended.outcome.measured.sighting.velocity or [0.0] * 6
    rate_deg_s = math.degrees(math.hypot(*velocity[3:]))
    metrics: dict[str, float | None] = {
        "rate_hz": hz,
        "off_mm_p50": percentile(off_mm, 50),
        "off_deg_p50": percentile(off_deg, 50),
        "off_deg_p95": percentile(off_deg, 95),
        "late_ms_p50": percentile(late_ms, 50),
        "late_ms_p95": percentile(late_ms, 95),
        "turn_deg_s": rate_deg_s,
    }
    rows = [
        ("rate", f"{hz:.1f} Hz over {seconds:g} s"),
        ("error", f"median {metrics['off_mm_p50']:.2f} mm, {metrics['off_deg_p50']:.2f} deg"),
        ("from exposure to client", f"median {metrics['late_ms_p50']:.0f} ms, p95 {metrics['late_ms_p95']:.0f} ms"),
        ("rate of turning", f"{rate_deg_s:.2f} deg/s measured, {RATE_DEG_S:g} deg/s true"),
    ]
    finish("track", metrics, rows)


if __name__ == "__main__":
    main()
