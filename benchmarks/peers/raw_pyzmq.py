"""The limit: a ROUTER loop in Python that passes each command through four echoing DEALER processes.

    client -> broker -> worker 0 -> broker -> worker 1 -> ... -> broker -> client

One message per job, the simplest program with pyzmq: it neither decodes, decides, keeps nor journals anything.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import tempfile
from collections.abc import Callable, Iterator, Sequence

import zmq

from benchmarks.peers import chain
from rtc.runtime.process import nice, open_socket, raise_priority

WINDOW = 1000  # commands in progress
START_MS = 10_000


def measure(sizes: Sequence[int], start: Callable[[], chain.Meter]) -> None:
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder, _processes(folder, sizes):
        client = open_socket(zmq.Context.instance(), zmq.DEALER, _front(folder), queue_length=100_000)
        payload = bytes(sizes[0])
        client.send_multipart([b"0", payload])
        if not client.poll(START_MS):
            raise SystemExit("the chain does not answer")
        for n in range(1, WINDOW):
            client.send_multipart([b"%d" % n, payload])
        meter = start()
        while True:
            name, _ = client.recv_multipart()
            if not meter.ended():
                break
            client.send_multipart([name, payload])
        client.close(linger=0)


def broker(folder: str, stages: int) -> None:
    raise_priority(1, -5)  # as for our broker
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    front = open_socket(context, zmq.ROUTER, _front(folder), bind=True, queue_length=100_000)
    back = open_socket(context, zmq.ROUTER, _back(folder), bind=True, queue_length=100_000)
    names = [b"%d" % stage for stage in range(stages)]
    for _ in names:
        back.recv_multipart()  # a worker's first message: the ROUTER now knows its identity
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
    socket.send(b"here")
    while True:
        client, command, payload = socket.recv_multipart()
        socket.send_multipart([client, command, chain.work(size, payload)])


def _front(folder: str) -> str:
    return f"ipc://{folder}/front.sock"


def _back(folder: str) -> str:
    return f"ipc://{folder}/back.sock"


@contextlib.contextmanager
def _processes(folder: str, sizes: Sequence[int]) -> Iterator[None]:
    spawn = multiprocessing.get_context("spawn")
    stages = sizes[1:]
    running = [spawn.Process(target=broker, args=(folder, len(stages)), daemon=True)]
    running += [spawn.Process(target=worker, args=(folder, *stage), daemon=True) for stage in enumerate(stages)]
    for process in running:
        process.start()
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.join()


if __name__ == "__main__":
    chain.main(measure)
