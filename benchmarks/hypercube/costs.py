"""The measured times that the model uses: a data file, written by `python -m benchmarks.hypercube --measure`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.report import RESULTS

FILE = RESULTS / "hypercube_costs.json"


class WorkerCosts(NamedTuple):
    """Times in seconds; processor time except for the service."""

    per_message: float
    per_item: float
    io_per_message: float
    service: list[float]  # durations of a job, of equal probability


class PeerCosts(NamedTuple):
    """Processor time in seconds."""

    per_message: float
    per_item: float
    io_per_message: float


class Costs(NamedTuple):
    """Times in seconds, from microbenchmarks of single processes."""

    broker: dict[str, float]  # per turn, message_in, message_out and kind of event
    ratios: list[float]  # measured to fitted times of turns, of equal probability
    io_per_turn: float
    io_per_message: float
    heartbeat: float
    assign_per_worker: float  # of one assignment, per registered worker
    check_per_worker: float  # of one health check, per registered worker
    workers: dict[str, list[WorkerCosts]]  # workload -> by kind
    subsystem: PeerCosts
    client: PeerCosts
    links: dict[str, list[float]]  # "ipc", "tcp" -> one-way times, of equal probability
    relay: float  # to receive a message and send it on


def from_data(data: dict[str, Any]) -> Costs:
    broker, processes = data["broker"], data["processes"]
    return Costs(
        broker=broker["per"],
        ratios=broker["ratios"],
        io_per_turn=broker["io_per_turn"],
        io_per_message=broker["io_per_message"],
        heartbeat=broker["heartbeat"],
        assign_per_worker=broker["assign_per_worker"],
        check_per_worker=broker["check_per_worker"],
        workers={
            load: [WorkerCosts(**kind) for kind in kinds.values()] for load, kinds in processes["workers"].items()
        },
        subsystem=PeerCosts(**processes["subsystem"]),
        client=PeerCosts(**processes["client"]),
        links=processes["links"],
        relay=processes["relay"]["main"] + processes["relay"]["io"],
    )


def load(file: Path = FILE) -> Costs:
    """Raises SystemExit if nothing has been measured."""
    try:
        return from_data(json.loads(file.read_text())["data"])
    except FileNotFoundError:
        raise SystemExit(f"{file} does not exist: run python -m benchmarks.hypercube --measure") from None
