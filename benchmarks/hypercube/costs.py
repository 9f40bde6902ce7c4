"""The measured times that the model uses: a data file, written by `python -m benchmarks.hypercube --measure`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.report import RESULTS
from benchmarks.throughput import PLANNERS
from rtc.protocol.messages import WorkerKind

FILE = RESULTS / "hypercube_costs.json"
EVENTS = ("accept", "parsed", "elaborated", "bound", "reported", "analyzed")  # of one command
LONE_MESSAGES = 8  # that the broker sends for a lone command: 4 jobs, 2 to the client, 2 to the subsystem
READERS = (WorkerKind.ELABORATOR, WorkerKind.BINDER)  # of the world database


class WorkerCosts(NamedTuple):
    """Times in seconds; processor time except for the service of a job that sleeps."""

    per_message: float
    per_item: float
    io_per_message: float
    service: list[float]  # durations of a job, of equal probability
    wake_up: float = 0.0  # more for the first message after a sleep
    io_wake_up: float = 0.0


class PeerCosts(NamedTuple):
    """Processor time in seconds."""

    per_message: float
    per_item: float
    io_per_message: float
    wake_up: float = 0.0  # more for the first message after a sleep
    io_wake_up: float = 0.0


class Costs(NamedTuple):
    """Times in seconds, from microbenchmarks of single processes."""

    broker: dict[str, float]  # per turn, wake_up, message_in, message_out and kind of event
    payload: dict[str, float]  # by workload: more per event, for longer messages than those of the trivial workload
    snapshot_per_event: float
    ratios: list[float]  # measured to fitted times of turns, of equal probability
    io_per_turn: float
    io_per_message: float
    io_wake_up: float
    heartbeat: float
    assign_per_worker: float  # of one assignment, per registered worker
    check_per_worker: float  # of one health check, per registered worker
    workers: dict[str, list[WorkerCosts]]  # workload -> by kind
    subsystem: PeerCosts
    client: PeerCosts
    links: dict[str, list[float]]  # "ipc", "tcp" -> one-way times, of equal probability
    relay: float  # to receive a message and send it on


def from_data(data: dict[str, Any]) -> Costs:
    """Join the costs of busy processes with those of woken ones, which `lone_costs` has measured."""
    broker, processes, lone = data["broker"], data["processes"], data["lone"]
    trivial = {name: tuple(used) for name, used in lone["trivial"]["per_command"].items()}
    wake_up, io_wake_up = _broker_wake_up(broker, trivial["broker"])
    kinds = {kind: _woken(costs, trivial[kind], 1) for kind, costs in processes["workers"]["trivial"].items()}
    workers = {
        load: [WorkerCosts(**kind) for kind in by_kind.values()] for load, by_kind in processes["workers"].items()
    }
    workers["trivial"] = [WorkerCosts(**kind) for kind in kinds.values()]
    workers["real"] = [WorkerCosts(**{**kinds[kind], "service": _service(kind, kinds[kind], lone)}) for kind in kinds]
    more = lone["real"]["per_command"]["broker"][0] - trivial["broker"][0]
    return Costs(
        broker={**broker["per"], "wake_up": wake_up},
        payload={"real": max(0.0, more / len(EVENTS))},
        snapshot_per_event=broker["snapshot_per_event"],
        ratios=broker["ratios"],
        io_per_turn=broker["io_per_turn"],
        io_per_message=broker["io_per_message"],
        io_wake_up=io_wake_up,
        heartbeat=broker["heartbeat"],
        assign_per_worker=broker["assign_per_worker"],
        check_per_worker=broker["check_per_worker"],
        workers=workers,
        subsystem=PeerCosts(**_woken(processes["subsystem"], trivial["MCM"], 1)),
        client=PeerCosts(**_woken(processes["client"], trivial["client"], 2)),
        links=processes["links"],
        relay=processes["relay"]["main"] + processes["relay"]["io"],
    )


def _broker_wake_up(broker: dict[str, Any], used: tuple[float, ...]) -> tuple[float, float]:
    """What the turns of a lone command cost more than turns in a row, per turn: main and I/O thread."""
    per, turns = broker["per"], len(EVENTS)
    main_s = turns * (per["turn"] + per["message_in"]) + LONE_MESSAGES * per["message_out"]
    main_s += sum(per[event] for event in EVENTS)
    io_s = turns * broker["io_per_turn"] + (turns + LONE_MESSAGES) * broker["io_per_message"]
    return max(0.0, used[0] - main_s) / turns, max(0.0, used[1] - io_s) / turns


def _woken(costs: dict[str, Any], used: tuple[float, ...], messages: int) -> dict[str, Any]:
    """Costs with those of a wake-up. `used`: processor time per lone command, of so many messages."""
    main_s = messages * costs["per_message"] + costs["per_item"]
    io_s = messages * costs["io_per_message"]
    wake_up, io_wake_up = max(0.0, used[0] - main_s) / messages, max(0.0, used[1] - io_s) / messages
    return {**costs, "wake_up": wake_up, "io_wake_up": io_wake_up}


def _service(kind: str, woken: dict[str, Any], lone: dict[str, Any]) -> list[float]:
    """Durations of the real jobs, as processor time: of the worker, and of the world database for it."""
    per_command, took_s = lone["real"]["per_command"], lone["real"]["service"][kind]
    if kind not in PLANNERS:
        return list(woken["service"])
    busy_s = per_command[kind][0] - woken["per_message"] - woken["per_item"] - woken["wake_up"]
    if kind in READERS:
        busy_s += sum(per_command["world"]) / len(READERS)
    factor = max(0.0, busy_s) * len(took_s) / sum(took_s)
    return [factor * each for each in took_s]


def load(file: Path = FILE) -> Costs:
    """Raises SystemExit if nothing has been measured."""
    try:
        return from_data(json.loads(file.read_text())["data"])
    except FileNotFoundError:
        raise SystemExit(f"{file} does not exist: run python -m benchmarks.hypercube --measure") from None
