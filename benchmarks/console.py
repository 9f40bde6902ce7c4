"""How old are the poses on a page, what do four open pages cost the cluster, and how fast is a page's halt?

    python -m benchmarks.console [--pages 4] [--rounds 3] [--seconds 8] [--halts 40]

An arm moves without end, in physics. Each round measures the same twice, without and with pages; every other round
begins with pages. A page is a connection that acknowledges each frame at once; drawing is the browser's own time. The
age of a frame is the time from the measurement in the MCM to its arrival at the page. Costs are processor time per
second. A halt of a page goes through the socket of the gateway; its latency ends with the first decelerating tick.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any
from urllib.request import Request, urlopen

from websockets.sync.client import ClientConnection, connect

from benchmarks.report import finish, percentile, question
from rtc.apps.console.pose_frame import HEADER
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.client.handle import CommandHandle
from rtc.runtime.process import CLOCK_TICKS_HZ

MOVES = ("MOVE RIGHT-ARM TO BAY-2-FRONT", "STOW RIGHT-ARM")
PROCESSES = ("broker", "MCM")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pages", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=8.0, help="of each half of a round")
    parser.add_argument("--halts", type=int, default=40)
    given = parser.parse_args()
    question("console", f"age of poses and cost of {given.pages} pages; halts of a page")
    ages_s: list[float] = []
    cost: dict[tuple[str, bool], list[float]] = {}
    with own_cluster() as run_dir, Client(run_dir) as client:
        for number in range(given.rounds):
            for watched in (False, True) if number % 2 else (True, False):
                with console(run_dir, given.pages if watched else 0) as (gateway, found):
                    for name, share in measure(client, given.seconds, gateway):
                        cost.setdefault((name, watched), []).append(share)
                    ages_s += found
            print(f"  round {number + 1} done", flush=True)
        with console(run_dir, given.pages) as (gateway, _):
            halts_s = list(halts(client, gateway, given.halts))
    report(given, ages_s, cost, halts_s)


class Gateway:
    """`rtc console` with an admitted cookie."""

    def __init__(self, run_dir: Path) -> None:
        command = [
            sys.executable,
            "-P",
            "-m",
            "rtc.apps.cli.entry",
            "console",
            "--port",
            "0",
            "--run-dir",
            str(run_dir),
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.base, _, token = self.process.stdout.readline().strip().partition("/#")
        body, headers = json.dumps({"token": token}).encode(), {"Origin": self.base}
        with urlopen(Request(f"{self.base}/session", body, headers), timeout=10) as answer:
            self._cookie = answer.headers["set-cookie"].partition(";")[0]

    def socket(self, path: str) -> ClientConnection:
        address = self.base.replace("http", "ws") + path
        made = connect(address, origin=self.base, additional_headers={"Cookie": self._cookie}, compression=None)  # type: ignore[arg-type]
        return made.__enter__()


@contextmanager
def console(run_dir: Path, pages: int) -> Iterator[tuple[Gateway | None, list[float]]]:
    """A gateway with open pages, and the ages (s) of the frames that they get; without pages there is no gateway."""
    ages_s: list[float] = []
    if not pages:
        yield None, ages_s
        return
    gateway = Gateway(run_dir)
    sockets = [gateway.socket(path) for _ in range(pages) for path in ("/poses", "/story")]
    over = threading.Event()
    threads = [threading.Thread(target=_read, args=(socket, over, ages_s), daemon=True) for socket in sockets]
    for thread in threads:
        thread.start()
    try:
        yield gateway, ages_s
    finally:
        over.set()
        for thread in threads:
            thread.join()
        gateway.process.terminate()
        gateway.process.wait()


def _read(socket: ClientConnection, over: threading.Event, ages_s: list[float]) -> None:
    last_s = 0.0
    while not over.is_set():
        try:
            frame = socket.recv(timeout=0.2)
        except TimeoutError:
            continue
        if isinstance(frame, bytes):
            measured_s = HEADER.unpack_from(frame)[2]
            if measured_s > last_s:  # otherwise a repetition of the last frame
                ages_s.append(time.monotonic() - measured_s)
            last_s = measured_s
            socket.send("ack")


def measure(client: Client, for_s: float, gateway: Gateway | None) -> Iterator[tuple[str, float]]:
    """Processor time per second of broker, MCM and gateway while the arms move."""
    pids = {row.name: int(row.pid) for row in client.status().processes if row.name in PROCESSES}
    if gateway is not None:
        pids["gateway"] = gateway.process.pid
    before, began_s = {name: processor_s(pid) for name, pid in pids.items()}, time.monotonic()
    number = 0
    while time.monotonic() < began_s + for_s:
        client.run(MOVES[number % len(MOVES)])
        number += 1
    took_s = time.monotonic() - began_s
    for name, pid in pids.items():
        yield name, (processor_s(pid) - before[name]) / took_s


def processor_s(pid: int) -> float:
    """Processor time of all threads of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS_HZ


def moving(client: Client, number: int) -> CommandHandle:
    """A command whose arm moves."""
    while True:
        handle = client.submit(MOVES[number % len(MOVES)])
        while handle.ended is None:
            if any(motion.started_ago_s for motion in client.status().motions):
                return handle
        number += 1


def halts(client: Client, gateway: Gateway | None, how_many: int) -> Iterator[float]:
    """Latencies (s) of halts of moving arms through the socket of a page."""
    assert gateway is not None
    line = gateway.socket("/halt")
    for number in range(how_many):
        handle = moving(client, number)
        called_s = time.monotonic()
        line.send(json.dumps({"id": number}))
        result: dict[str, Any] = json.loads(line.recv())["result"]
        way_s = time.monotonic() - called_s - result["took_s"]  # to the gateway and back
        if result["moving"]:
            yield result["latency_s"] + way_s
        handle.wait()
    line.close()


def report(
    given: argparse.Namespace, ages_s: list[float], cost: dict[tuple[str, bool], list[float]], halts_s: list[float]
) -> None:
    ages_ms, halts_ms = [1e3 * age for age in ages_s], [1e3 * one for one in halts_s]
    metrics: dict[str, float | None] = {
        "frame_p50_ms": percentile(ages_ms, 50),
        "frame_p99_ms": percentile(ages_ms, 99),
        "frames_per_page_s": len(ages_s) / (given.pages * given.rounds * given.seconds),
        "halt_p50_ms": percentile(halts_ms, 50),
        "halt_p99_ms": percentile(halts_ms, 99),
        "gateway_share": median(cost["gateway", True]),
    }
    rows = [
        (
            "age of a frame, ms",
            f"p50 {metrics['frame_p50_ms']:.1f}, p99 {metrics['frame_p99_ms']:.1f}, worst {max(ages_ms):.1f}",
        ),
        (
            "halt of a page, ms",
            f"p50 {metrics['halt_p50_ms']:.2f}, p99 {metrics['halt_p99_ms']:.2f}, of {len(halts_s)}",
        ),
    ]
    for name in PROCESSES:
        alone, watched = median(cost[name, False]), median(cost[name, True])
        metrics[f"{name.lower()}_share_without"], metrics[f"{name.lower()}_share_with"] = alone, watched
        each = [f"{a:.3f}/{b:.3f}" for a, b in zip(cost[name, False], cost[name, True], strict=True)]
        rows.append((f"{name}, s per s without / with", f"{alone:.3f} / {watched:.3f}  ({', '.join(each)})"))
    rows.append(("gateway, s per s", f"{metrics['gateway_share']:.3f}"))
    finish("console", metrics, rows)


if __name__ == "__main__":
    main()
