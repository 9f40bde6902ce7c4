"""A process that sends halts through the broker alone: `python -m benchmarks.load.halter --run-dir D --for-s 3`.

Each halt is for a performer without a command, so that the load goes on. The latency of a halt is the time from the
call to its receipt by the subsystem (CLOCK_MONOTONIC of one machine). A real client sends it to the MCM directly too;
that path does not depend on the broker. It begins with the first line of its input, after it has printed `ready`. At
the end it prints one line of JSON: the latencies in seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import zmq

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.runtime.process import open_socket
from rtc.runtime.settings import Settings

PERIOD_S = 0.03
LIMIT_S = 10.0  # without an answer for this long, the halt is lost


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run-dir", required=True, type=Path)
    parser.add_argument("--for-s", type=float, required=True)
    parser.add_argument("--scope", required=True, help="a performer without a command")
    given = parser.parse_args()
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = open_socket(context, zmq.DEALER, Settings.load(given.run_dir).endpoint("halt"))
    read = wire.reader(m.FromHalt)
    latencies_s: list[float] = []
    print("ready", flush=True)
    sys.stdin.readline()
    end_s = time.monotonic() + given.for_s
    while (called_at_s := time.monotonic()) < end_s:
        order = m.HaltOrder(halt=f"H-{len(latencies_s)}", scope=given.scope, called_at_s=called_at_s)
        socket.send_multipart(wire.frames(order))
        rested = False
        while not rested:
            if not socket.poll(int(LIMIT_S * 1000)):
                raise SystemExit(f"{order.halt} is not answered within {LIMIT_S:g} s")
            answer = read(socket.recv_multipart())
            if isinstance(answer, m.HaltStarted):
                latencies_s.append(answer.received_at_s - called_at_s)
            elif isinstance(answer, m.Declined):
                raise SystemExit(f"a halt was declined: {answer.refusal.message}")
            rested = isinstance(answer, m.HaltAtRest)
        time.sleep(PERIOD_S)
    print(json.dumps(latencies_s), flush=True)
    context.destroy(linger=0)


if __name__ == "__main__":
    main()
