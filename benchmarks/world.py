"""How long does one grouped read of 50 facts from the world database take, with socket and decoding?

In the same run it measures the usual read of a worker (only changes since its last view) and a commit to disk. If a
Redis server can be started, it also measures MGET of 50 keys from Redis through its own client.

    python -m benchmarks.world [--reads 5000]
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.report import finish, percentile, question, spread
from rtc.protocol.messages import WorldChange
from rtc.runtime.process import die_with_parent
from rtc.runtime.settings import Settings, prepare_run_dir
from rtc.world.client import WorldClient
from rtc.world.lease import KEY_FILE, sign

FACTS = 50
WARM_UP = 200


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reads", type=int, default=5000)
    reads = parser.parse_args().reads
    question("world", f"how long does a grouped read of {FACTS} facts take, of {reads} reads one after the other?")
    key = bytes(32)
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder, _server(Path(folder), key) as settings:
        client = WorldClient(settings.endpoint("world"))
        keys = [f"THING-{n}.frame" for n in range(FACTS)]
        pose = [0.123456789, -0.2, 1 / 3, 0.0, 0.0, 0.0, 1.0]
        lease = sign(key, "fill", [f"THING-{n}" for n in range(FACTS)])
        client.commit(lease, [WorldChange(key=k, value=pose) for k in keys], "benchmark")
        assert len(client.view(keys=keys).facts) == FACTS
        version = client.view().version
        read = _timed("read of 50 facts", lambda _: client.view(keys=keys), reads)
        delta = _timed("read of changes (none)", lambda _: client.view(since=version), reads)

        def commit(n: int) -> None:
            client.commit(sign(key, f"job-{n}", ["THING-0"]), [WorldChange(key=keys[0], value=pose)], "benchmark")

        write = _timed("commit of one fact", commit, reads // 5)
    redis = _redis(reads)
    p50 = percentile(read, 50)
    finish(
        "world",
        {
            "read50_p50_us": 1e6 * p50,
            "read50_p99_us": 1e6 * percentile(read, 99),
            "delta_p50_us": 1e6 * percentile(delta, 50),
            "commit_p50_us": 1e6 * percentile(write, 50),
            "redis_p50_us": 1e6 * percentile(redis, 50) if redis else None,
            "vs_redis": percentile(redis, 50) / p50 if redis else None,
        },
        [
            ("read of 50 facts", spread(read, 1e6, "us")),
            ("read of what is new", spread(delta, 1e6, "us")),
            ("commit of one fact", spread(write, 1e6, "us")),
            ("Redis MGET of 50 keys", spread(redis, 1e6, "us") if redis else "no Redis here"),
        ],
    )


def _timed(what: str, act: Callable[[int], object], count: int) -> list[float]:
    samples = []
    for n in range(-WARM_UP, count):
        began = time.perf_counter()
        act(n)
        if n >= 0:
            samples.append(time.perf_counter() - began)
    print(f"  {what}: done", flush=True)
    return samples


@contextlib.contextmanager
def _server(folder: Path, key: bytes) -> Iterator[Settings]:
    """A separate world database process."""
    settings = Settings(run_dir=str(prepare_run_dir(folder)))
    settings.save()
    (folder / KEY_FILE).write_bytes(key)
    with _process([sys.executable, "-m", "rtc.world", "--run-dir", str(folder)]) as process:
        assert process.stdout is not None
        if process.stdout.readline() != b"ready\n":
            raise SystemExit("the world database did not start")
        yield settings


def _redis(reads: int) -> list[float]:
    """The same for Redis; empty if it or its client is not installed."""
    with contextlib.suppress(ImportError):
        redis = importlib.import_module("redis")
        if shutil.which("redis-server") is None:
            return []
        with tempfile.TemporaryDirectory() as folder:
            socket = f"{folder}/redis.sock"
            options = ["--port", "0", "--unixsocket", socket, "--save", "", "--dir", folder]
            with _process(["redis-server", *options]):
                client = redis.Redis(unix_socket_path=socket)
                _until(lambda: client.ping(), redis.ConnectionError)
                keys = [f"THING-{n}.frame" for n in range(FACTS)]
                client.mset(dict.fromkeys(keys, b"x" * 100))
                return _timed("Redis MGET", lambda _: client.mget(keys), reads)
    return []


def _until(works: Callable[[], object], error: type[Exception], limit_s: float = 5.0) -> None:
    end = time.monotonic() + limit_s
    while True:
        try:
            works()
            return
        except error:
            if time.monotonic() > end:
                raise
            time.sleep(0.01)


@contextlib.contextmanager
def _process(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    me = os.getpid()
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, preexec_fn=lambda: die_with_parent(me)
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(5)


if __name__ == "__main__":
    main()
