"""A process that sends each message back: `python -m benchmarks.hypercube.echo tcp://127.0.0.1:5555`."""

from __future__ import annotations

import sys
from typing import Any

import zmq


def main(address: str) -> None:
    context: zmq.Context[Any] = zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.connect(address)
    while True:
        socket.send_multipart(socket.recv_multipart())


if __name__ == "__main__":
    main(sys.argv[1])
