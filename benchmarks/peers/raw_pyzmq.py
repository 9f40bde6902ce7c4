"""The limit: a ROUTER loop in Python that passes each command through four echoing DEALER processes, one message each.

    client -> broker -> worker 0 -> broker -> worker 1 -> ... -> broker -> client

Nothing is decoded, decided, kept or journalled; what a broker in Python on ZeroMQ costs at least, without batching.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence

import zmq

from rtc.process import die_with_parent, nice, open_socket

WINDOW = 1000  # commands under way
WARM_UP_S = 1.0


def measure(sizes: Sequence[int], for_s: float, repeats: int) -> list[float]:
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder, _processes(folder, sizes):
        client = open_socket(zmq.Context.instance(), zmq.DEALER, _front(folder), queue_length=100_000)
        payload = bytes(sizes[0])
        for n in range(WINDOW):
            client.send_multipart([b"%d" % n, payload])
        _run(client, payload, WARM_UP_S)
        rates = [_run(client, payload, for_s) for _ in range(repeats)]
        client.close(linger=0)
        return rates


def _run(client: zmq.Socket[bytes], payload: bytes, for_s: float) -> float:
    began, ended = time.monotonic(), 0
    while (now := time.monotonic()) - began < for_s:
        client.poll()
        with contextlib.suppress(zmq.Again):
            for _ in range(1000):
                name, _ = client.recv_multipart(zmq.NOBLOCK)
                client.send_multipart([name, payload])
                ended += 1
    return ended / (now - began)


def broker(folder: str, stages: int) -> None:
    nice(-5)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    front = open_socket(context, zmq.ROUTER, _front(folder), bind=True, queue_length=100_000)
    back = open_socket(context, zmq.ROUTER, _back(folder), bind=True, queue_length=100_000)
    names = [b"%d" % stage for stage in range(stages)]
    for _ in names:
        back.recv_multipart()  # a worker's first word: only now can it be sent anything
    poller = zmq.Poller()
    poller.register(front, zmq.POLLIN)
    poller.register(back, zmq.POLLIN)
    while True:
        poller.poll()
        with contextlib.suppress(zmq.Again):
            for _ in range(200):
                worker, client, command, payload = back.recv_multipart(zmq.NOBLOCK)
                following = int(worker) + 1
                if following < stages:
                    back.send_multipart([names[following], client, command, payload])
                else:
                    front.send_multipart([client, command, payload])
        with contextlib.suppress(zmq.Again):
            for _ in range(64):
                client, command, payload = front.recv_multipart(zmq.NOBLOCK)
                back.send_multipart([names[0], client, command, payload])


def worker(folder: str, stage: int, size: int) -> None:
    nice(5)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = open_socket(context, zmq.DEALER, _back(folder), identity=str(stage), queue_length=100_000)
    product = bytes(size)
    socket.send(b"here")
    while True:
        client, command, _ = socket.recv_multipart()
        socket.send_multipart([client, command, product])


def _front(folder: str) -> str:
    return f"ipc://{folder}/front.sock"


def _back(folder: str) -> str:
    return f"ipc://{folder}/back.sock"


@contextlib.contextmanager
def _processes(folder: str, sizes: Sequence[int]) -> Iterator[None]:
    me, stages = os.getpid(), len(sizes) - 1
    commands = [["broker", "--stages", str(stages)]]
    commands += [["worker", "--stage", str(stage), "--size", str(sizes[stage + 1])] for stage in range(stages)]
    command = [sys.executable, "-m", "benchmarks.peers.raw_pyzmq"]
    running = [
        subprocess.Popen([*command, *more, "--folder", folder], preexec_fn=lambda: die_with_parent(me))
        for more in commands
    ]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=("broker", "worker"))
    parser.add_argument("--folder", required=True)
    parser.add_argument("--stages", type=int, default=4)
    parser.add_argument("--stage", type=int, default=0)
    parser.add_argument("--size", type=int, default=0)
    given = parser.parse_args()
    if given.role == "broker":
        broker(given.folder, given.stages)
    else:
        worker(given.folder, given.stage, given.size)


if __name__ == "__main__":
    main()
