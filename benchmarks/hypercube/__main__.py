"""Where does one broker end, and what then? A simulated cluster of 4 to 65,536 workers, with measured times.

    python -m benchmarks.hypercube --measure     time single processes of the real cluster (two minutes)
    python -m benchmarks.hypercube --check       compare with the real cluster: results/scaling.json of this machine
    python -m benchmarks.hypercube               simulate d = 2 to 16 and draw the plots (minutes)
    python -m benchmarks.hypercube --dims 2 8    fewer sizes
    python -m benchmarks.hypercube --page        write the results into the tables of docs/scaling.md

Service and link times come from `--measure` alone (results/hypercube_costs.json); nothing is fitted to the results of
`benchmarks.scaling`. The check gives the two cores of this machine to all processes. The other simulations give each
process a core of its own. A worker's service time is that of a job that sleeps for 4 ms, unless stated otherwise.
"""

from __future__ import annotations

import argparse
import json
import os
from typing import Any

from benchmarks.hypercube import check, experiments, page, plots
from benchmarks.hypercube.costs import Costs, from_data, load
from benchmarks.hypercube.fit import middle
from benchmarks.hypercube.neighbour import neighbours
from benchmarks.report import RESULTS, finish, question

SEED = 16
DIMS = tuple(range(2, 17))
REPETITIONS = 12
ROUNDS = 4  # of all microbenchmarks; the median of each figure is used


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hypercube",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--measure", action="store_true", help="write results/hypercube_costs.json")
    what.add_argument("--check", action="store_true", help="compare with results/scaling.json")
    what.add_argument("--page", action="store_true", help="write the tables of docs/scaling.md from the results")
    parser.add_argument("--dims", type=int, nargs="+", default=list(DIMS), help="dimensions of the cube: 2^dim workers")
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    if given.measure:
        measure()
    elif given.page:
        page.update()
    elif given.check:
        raise SystemExit(0 if compare(load(), given.seed) else 1)
    else:
        simulate(load(), given.dims, given.seed)


def measure() -> None:
    """Run all microbenchmarks, and write what they give."""
    from benchmarks.hypercube import broker_costs, lone_costs, payload_costs, planner_costs, process_costs

    question("hypercube_costs", "what does each of broker, workers, client, subsystem and links cost, on shared cores?")
    rounds: list[dict[str, Any]] = []
    for n in range(ROUNDS):
        with neighbours(resting=False):
            rounds.append({"broker": broker_costs.measure(REPETITIONS)})
        with neighbours():
            rounds[-1]["processes"] = process_costs.measure(REPETITIONS)
        rounds[-1]["lone"] = lone_costs.measure()  # a cluster has its own neighbours
        turn_us, event_us = (1e6 * rounds[-1]["broker"]["per"][name] for name in ("turn", "elaborated"))
        print(
            f"  round {n + 1} of {ROUNDS}: a turn of the broker {turn_us:.0f} us, an event {event_us:.1f} us",
            flush=True,
        )
    data = middle(rounds)
    with neighbours(resting=False):
        data["planners"] = planner_costs.measure(REPETITIONS)
        data["payload"] = payload_costs.measure(REPETITIONS)
    costs = from_data(data)
    rows = [(f"broker, per {name}", f"{1e6 * cost:.1f} us") for name, cost in costs.broker.items()]
    rows.append(("broker, heartbeat of a worker", f"{1e6 * costs.heartbeat:.1f} us"))
    rows.append(("broker, assignment, per registered worker", f"{1e9 * costs.assign_per_worker:.1f} ns"))
    rows.append(("broker, health check, per registered worker", f"{1e9 * costs.check_per_worker:.0f} ns"))
    for workload, kinds in costs.workers.items():
        services = ", ".join(f"{1e3 * sum(kind.service) / len(kind.service):.3f}" for kind in kinds)
        rows.append((f"service of the four kinds, {workload}, mean", f"{services} ms"))
    for name, delays in costs.links.items():
        rows.append((f"link, {name}, one way, median", f"{1e6 * delays[len(delays) // 2]:.0f} us"))
    rows.append(("relay, per message", f"{1e6 * costs.relay:.1f} us"))
    finish("hypercube_costs", {name: 1e6 * cost for name, cost in costs.broker.items()}, rows, data=data)


def compare(costs: Costs, seed: int) -> bool:
    """Print the check; True if all errors of the throughput are within the limit."""
    file = RESULTS / "scaling.json"
    if not file.exists():
        raise SystemExit(f"{file} does not exist: run python -m benchmarks.scaling")
    cores = len(os.sched_getaffinity(0))
    print(f"check: simulated with {cores} cores for all processes, seed {seed}")
    print(check.HEADER)
    found = []
    for one in check.compare(costs, json.loads(file.read_text())["data"], cores, seed):
        found.append(one)
        print(one.line(), flush=True)
    worst = max(found, key=lambda one: abs(one.error))
    beyond = [one.label for one in found if abs(one.error) > check.LIMIT]
    metrics = {
        "worst_error": abs(worst.error),
        "cases": float(len(found)),
        "cases_within_limit": float(len(found) - len(beyond)),
    }
    rows = [
        ("worst error of the throughput", f"{100 * worst.error:+.0f} %, {worst.label}"),
        (f"beyond {100 * check.LIMIT:.0f} %", ", ".join(beyond) or "none"),
    ]
    data = [
        {**one._asdict(), "simulated": one.simulated._asdict(), "error": one.error, "broker_us": one.broker_us}
        for one in found
    ]
    finish("hypercube_check", metrics, rows, data=data)
    plots.check(data, RESULTS / "hypercube_check.png")
    return not beyond


def simulate(costs: Costs, dims: list[int], seed: int) -> None:
    question("hypercube", f"throughput, waiting and halts of 2^{min(dims)} to 2^{max(dims)} workers", seed=seed)
    rows = []
    for run in experiments.run(costs, dims, seed):
        row = {**run.row(), "limit": experiments.first_limit(run.result)}
        rows.append(row)
        print(f"  {_line(row)}", flush=True)
    for run in experiments.loads(costs, min(10, max(dims)), seed):
        rows.append({**run.row(), "limit": experiments.first_limit(run.result)})
        print(f"  {_line(rows[-1])}", flush=True)
    plots.scaling(rows, RESULTS / "hypercube_throughput.png")
    plots.halts(rows, RESULTS / "hypercube_halts.png")
    finish("hypercube", _metrics(rows), [(_label(row), _figures(row)) for row in rows], data=rows)


def _label(row: dict[str, Any]) -> str:
    load = f", {row['rate']:.0f}/s offered" if row["rate"] else ""
    return f"{row['experiment']}, {row['workload']}, {row['brokers']} x broker, {row['workers']} workers{load}"


def _figures(row: dict[str, Any]) -> str:
    return (
        f"{row['commands_per_s']:.0f}/s, p50 {row['latency_p50_ms']:.1f} ms, waiting {row['waiting_p50_ms']:.1f} ms, "
        f"halt p99 {row['halt_p99_ms']:.2f} ms; limit: {row['limit']}"
    )


def _line(row: dict[str, Any]) -> str:
    return f"{_label(row)}: {_figures(row)}"


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float | None]:
    """The best throughput of each experiment."""
    best: dict[str, float | None] = {}
    for row in rows:
        name = f"{row['experiment']}, {row['workload']}, {row['brokers']} x broker: most commands/s"
        if row["experiment"] != "load":
            best[name] = max(best.get(name) or 0.0, row["commands_per_s"])
    return best


if __name__ == "__main__":
    main()
