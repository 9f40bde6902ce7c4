"""The measured times that the model uses: a data file, written by `python -m benchmarks.hypercube --measure`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from benchmarks.report import RESULTS

FILE = RESULTS / "hypercube_costs.json"
EVENTS = ("accept", "parsed", "elaborated", "bound", "reported", "analyzed")  # of one command
REBOUND = "rebound"  # a step is bound, and must be bound again
LONE_MESSAGES = 8  # that the broker sends for a lone command: 4 jobs, 2 to the client, 2 to the subsystem
ALONE, BESIDE = "alone", "beside"  # whether the messages of real planners carry a motion of another arm
Payload = dict[str, dict[str, float]]  # condition -> kind of event -> s
Used = dict[str, tuple[float, ...]]  # process -> processor time, main and I/O thread (s)


class WorkerCosts(NamedTuple):
    """Times in seconds; processor time except for the service of a job that sleeps."""

    per_message: float
    per_item: float
    io_per_message: float
    service: list[float]  # durations of a job, of equal probability
    wake_up: float = 0.0  # more for the first message after a sleep
    io_wake_up: float = 0.0
    conditions: Mapping[str, list[float]] = MappingProxyType({})  # service, as in `benchmarks.hypercube.planner_costs`


class PeerCosts(NamedTuple):
    """Processor time in seconds."""

    per_message: float
    per_item: float
    io_per_message: float
    wake_up: float = 0.0  # more for the first message after a sleep
    io_wake_up: float = 0.0


class Lengthy(NamedTuple):
    """What is different in a workload with longer messages than those of the trivial one."""

    wake_up: float  # of the broker, main and I/O thread
    io_wake_up: float
    subsystem: PeerCosts
    payload: Payload  # of the broker, more per event


class Costs(NamedTuple):
    """Times in seconds, from microbenchmarks of single processes."""

    broker: dict[str, float]  # per turn, wake_up, message_in, message_out and kind of event
    lengthy: dict[str, Lengthy]  # by workload
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

    def of(self, workload: str) -> Costs:
        """The costs with the broker's wake-up and the subsystem of this workload."""
        if workload not in self.lengthy:
            return self
        special = self.lengthy[workload]
        broker = {**self.broker, "wake_up": special.wake_up}
        return self._replace(broker=broker, io_wake_up=special.io_wake_up, subsystem=special.subsystem)


def from_data(data: dict[str, Any]) -> Costs:
    """Join the costs of busy processes with those of woken ones, which `lone_costs` has measured."""
    broker, processes, lone = data["broker"], data["processes"], data["lone"]
    trivial = {name: tuple(used) for name, used in lone["trivial"]["per_command"].items()}
    wake_up, io_wake_up = _broker_wake_up(broker, trivial["broker"])
    payload = data["payload"]
    kinds = {kind: _woken(costs, trivial[kind], 1) for kind, costs in processes["workers"]["trivial"].items()}
    workers = {
        load: [WorkerCosts(**kind) for kind in by_kind.values()] for load, by_kind in processes["workers"].items()
    }
    workers["trivial"] = [WorkerCosts(**kind) for kind in kinds.values()]
    real = {name: tuple(used) for name, used in lone["real"]["per_command"].items()}
    workers["real"] = [
        _planner(data["planners"][kind], real[kind])
        if kind in data["planners"]
        else WorkerCosts(**_woken(costs, real[kind], 1))
        for kind, costs in processes["workers"]["trivial"].items()
    ]
    lengthy = Lengthy(
        *_broker_wake_up(broker, real["broker"], sum(payload[ALONE].values())),
        subsystem=_with_longer_items(PeerCosts(**_woken(processes["subsystem"], trivial["MCM"], 1)), trivial, real),
        payload=payload,
    )
    return Costs(
        broker={**broker["per"], "wake_up": wake_up},
        lengthy={"real": lengthy},
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


def _with_longer_items(subsystem: PeerCosts, trivial: Used, real: Used) -> PeerCosts:
    """The costs of a subsystem whose primitives have trajectories. `trivial`, `real`: time per lone command."""
    longer_s = max(0.0, sum(real["MCM"]) - sum(trivial["MCM"]))
    return subsystem._replace(per_item=subsystem.per_item + longer_s)


def _broker_wake_up(broker: dict[str, Any], used: tuple[float, ...], payload_s: float = 0.0) -> tuple[float, float]:
    """What the turns of a lone command cost more than turns in a row, per turn: main and I/O thread.

    `payload_s`: for its long messages."""
    per, turns = broker["per"], len(EVENTS)
    main_s = turns * (per["turn"] + per["message_in"]) + LONE_MESSAGES * per["message_out"]
    main_s += sum(per[event] for event in EVENTS)
    io_s = turns * broker["io_per_turn"] + (turns + LONE_MESSAGES) * broker["io_per_message"]
    usual = sum(broker["ratios"]) / len(broker["ratios"])  # the model multiplies each turn by one of these
    return max(0.0, used[0] / usual - main_s - payload_s) / turns, max(0.0, used[1] - io_s) / turns


def _woken(costs: dict[str, Any], used: tuple[float, ...], messages: int) -> dict[str, Any]:
    """Costs with those of a wake-up. `used`: processor time per lone command, of so many messages."""
    main_s = messages * costs["per_message"] + costs["per_item"]
    io_s = messages * costs["io_per_message"]
    wake_up, io_wake_up = max(0.0, used[0] - main_s) / messages, max(0.0, used[1] - io_s) / messages
    return {**costs, "wake_up": wake_up, "io_wake_up": io_wake_up}


def _planner(measured: dict[str, Any], lone: tuple[float, ...]) -> WorkerCosts:
    """Costs of a real planner. `lone`: processor time per lone command, which is planned alone.

    The service of a job contains the time for its messages, and that of the world database for it."""
    busy = measured[ALONE]
    return WorkerCosts(
        per_message=0.0,
        per_item=0.0,
        io_per_message=busy["io"],
        service=_service(busy),
        wake_up=max(0.0, lone[0] - busy["main"]),
        io_wake_up=max(0.0, lone[1] - busy["io"]),
        conditions={name: _service(costs) for name, costs in measured.items()},
    )


def _service(costs: dict[str, Any]) -> list[float]:
    """Durations of the jobs, as processor time."""
    took_s = costs["service"]
    factor = (costs["main"] + costs["world"]) * len(took_s) / sum(took_s)
    return [factor * each for each in took_s]


def load(file: Path = FILE) -> Costs:
    """Raises SystemExit if nothing has been measured."""
    try:
        return from_data(json.loads(file.read_text())["data"])
    except FileNotFoundError:
        raise SystemExit(f"{file} does not exist: run python -m benchmarks.hypercube --measure") from None
