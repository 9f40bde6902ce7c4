"""How long do the four workers take for one job each: a sentence, a script, a step, a report?

    python -m benchmarks.workers [--scenarios 6] [--passes 3]

It runs the real worker functions with the cell swapout and the default programs, warm, in one process, without sockets.
The jobs are real: they are collected from scenarios (`benchmarks.load.scenarios`) on exact arms, and each step is bound
again after arms and modules have moved. To bind a motion means IK, a collision-free path, and its timing. Refusals are
counted separately. Each pass runs all jobs in another order. Free motions are also bound with each item of MAINTAIN.
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

from benchmarks.load.scenarios import FUNCTIONS, Scenario, WorkerJob, Workers, changed, sentences
from benchmarks.report import finish, percentile, question, spread
from rtc.model.cells.cell import Cell
from rtc.programs import action_stack, loader
from rtc.protocol.messages import BoundStep, ElaboratorInput, ParserInput, Script, WorkerKind
from rtc.protocol.outcomes import Refusal
from rtc.protocol.primitive import JointTrajectory
from rtc.runtime import process
from rtc.world.model import World
from workers.planning.robot_models import CellModel

SEED = 20
SENTENCES = Path(__file__).parents[1] / "tests" / "language" / "samples.txt"
SAMPLES = [line.split(": ", 1)[1] for line in SENTENCES.read_text().splitlines()]
UNIT = {"parse": (1e6, "us"), "elaborate": (1e6, "us"), "bind": (1e3, "ms"), "analyze": (1e6, "us")}
FREE_MOTIONS = [
    "MOVE RIGHT-ARM TO RACK-1-FRONT",
    "MOVE RIGHT-ARM TO BAY-2-FRONT",
    "MOVE RIGHT-ARM TO CLEAR-POINT-1",
    "MOVE RIGHT-ARM BY 8 CM ALONG UP",
    "STOW RIGHT-ARM",
    "MOVE LEFT-ARM TO BAY-2-FRONT",
    "RETRACT LEFT-ARM BY 10 CM",
    "STOW LEFT-ARM",
]
CONSTRAINTS = [  # the items of MAINTAIN that act on a free motion
    "SAFE-WORK-RANGE",
    "AVOID-TASK-REGION",
    "AVOID-NEIGHBORS BY 3 CM",
    "POSE-DURING-MOTION LEVEL",
    "SPEED 5 CM/S",
    "FORCE-LIMIT 20 N",
    "TORQUE-LIMIT 3 NM",
    "STIFFNESS 800 N/M",
    "TIME-LIMIT 300 SEC",
]
VERBS = {
    WorkerKind.PARSER: "parse",
    WorkerKind.ELABORATOR: "elaborate",
    WorkerKind.BINDER: "bind",
    WorkerKind.ANALYZER: "analyze",
}


def main() -> None:
    words = argparse.ArgumentParser(prog="python -m benchmarks.workers", description=__doc__)
    words.add_argument("--scenarios", type=int, default=6, help="a scenario has some 35 steps and takes half a minute")
    words.add_argument("--passes", type=int, default=3, help="over all jobs")
    given = words.parse_args()
    question("workers", "How long do the four workers take for one job each?", seed=SEED)
    cell, rng = Cell.load("swapout"), random.Random(SEED)
    cold = dict(_cold(cell))
    workers = Workers(cell)
    jobs = [WorkerJob(WorkerKind.PARSER, World(), ParserInput(text=text)) for text in SAMPLES]
    for n in range(given.scenarios):
        jobs += _jobs_of_scenario(workers, rng)
        print(f"  scenario {n + 1} of {given.scenarios}: {len(jobs)} jobs", flush=True)
    jobs += [changed(job, cell, rng) for job in jobs if job.kind is WorkerKind.BINDER]
    times_s = _timed(workers, jobs, given.passes, rng)
    constrained_s = _by_constraint(workers, given.passes, rng)
    bound = times_s["bind any motion"] = [t for label in times_s if label.startswith("bind a ") for t in times_s[label]]
    rows = [(label, _row(label, times_s[label])) for label in sorted(times_s, key=_place)]
    rows += [(f"bind a free motion, {what}", spread(times, 1e3, "ms")) for what, times in constrained_s.items()]
    rows += [(f"cold: {what}", f"{1e3 * took_s:.0f} ms") for what, took_s in cold.items()]
    finish(
        "workers",
        {
            "parse_p50_us": 1e6 * percentile(times_s["parse"], 50),
            "elaborate_p50_us": 1e6 * percentile(times_s["elaborate"], 50),
            "bind_p50_ms": 1e3 * percentile(bound, 50),
            "bind_p99_ms": 1e3 * percentile(bound, 99),
            "analyze_p50_us": 1e6 * percentile(times_s["analyze"], 50),
            "cold_start_ms": 1e3 * sum(cold.values()),
        },
        rows,
    )


def _cold(cell: Cell) -> Iterator[tuple[str, float]]:
    """Time (s) of the work before a worker's first job, with all libraries imported."""
    for kind, function in FUNCTIONS.items():
        body = loader.default(kind)
        began_s = time.perf_counter()
        function.compile(body)
        yield f"compile the {kind.value}'s program", time.perf_counter() - began_s
    began_s = time.perf_counter()
    model = CellModel(cell)
    assert model.arms
    yield "arms of the cell", time.perf_counter() - began_s
    began_s = time.perf_counter()
    assert model.collision
    yield "bodies of the cell", time.perf_counter() - began_s


def _jobs_of_scenario(workers: Workers, rng: random.Random) -> list[WorkerJob]:
    """The jobs of one scenario, without parser jobs: the samples of the language are parsed instead."""
    scenario = Scenario(workers, rng)
    for sentence in sentences(rng):
        scenario.run(sentence)
    return [job for job in scenario.jobs if job.kind is not WorkerKind.PARSER]


def _by_constraint(workers: Workers, passes: int, rng: random.Random) -> dict[str, list[float]]:
    """Seconds to bind FREE_MOTIONS without constraint and with each of CONSTRAINTS, in the same worlds."""
    endings = {"no constraint": ""} | {item: f" MAINTAIN {item}" for item in CONSTRAINTS}
    scenario, jobs = Scenario(workers, rng), []
    times_s: dict[str, list[float]] = {label: [] for label in endings}
    refused: Counter[str] = Counter()
    for sentence in FREE_MOTIONS:
        for label, ending in endings.items():
            job = _first_bind(workers, scenario.world, sentence + ending)
            if job is None:
                refused[label] += 1
            else:
                jobs.append((label, job))
        scenario.run(sentence)
    for n in range(1 + passes):
        for label, job in rng.sample(jobs, len(jobs)):
            began_s = time.process_time()
            product = workers.do(job)
            took_s = time.process_time() - began_s
            if n == 0 and isinstance(product, Refusal):
                refused[label] += 1
            elif n > 0 and not isinstance(product, Refusal):
                times_s[label].append(took_s)
    return {f"{label} ({refused[label]} refused)" if refused[label] else label: t for label, t in times_s.items()}


def _first_bind(workers: Workers, world: World, sentence: str) -> WorkerJob | None:
    """The bind job of a sentence's first step; None if the elaborator refuses the sentence."""
    parsed = workers.do(WorkerJob(WorkerKind.PARSER, world, ParserInput(text=sentence)))
    script = workers.do(WorkerJob(WorkerKind.ELABORATOR, world, ElaboratorInput(command="C-1", parsed=parsed)))
    if not isinstance(script, Script):
        return None
    actions = action_stack.begin(script)
    actions.pop()
    return WorkerJob(WorkerKind.BINDER, world, actions.binder_input("C-1.1"))


def _timed(workers: Workers, jobs: list[WorkerJob], passes: int, rng: random.Random) -> dict[str, list[float]]:
    """Seconds by kind of job; the first pass warms up."""
    times_s: dict[str, list[float]] = defaultdict(list)
    process.freeze_heap()  # as the workers do
    for n in range(1 + passes):
        for job in rng.sample(jobs, len(jobs)):
            began_s = time.process_time()
            product = workers.do(job)
            took_s = time.process_time() - began_s
            if n > 0:
                times_s[_label(job, product)].append(took_s)
        print(f"  pass {n} of {passes}: {len(jobs)} jobs{'' if n else ', not counted'}", flush=True)
    return times_s


def _label(job: WorkerJob, product: object) -> str:
    verb = VERBS[job.kind]
    if isinstance(product, Refusal):
        return f"{verb}, refused"
    if not isinstance(product, BoundStep):
        return verb
    trajectory = product.primitive.trajectory if product.primitive else None
    if not isinstance(trajectory, JointTrajectory):
        return f"{verb} what moves no arm"
    assert product.evaluation is not None
    kind = "a line of the hand" if trajectory.space == "task" else "a joint motion"
    return f"{verb} {kind}, {'laden' if product.evaluation.held else 'empty hand'}"


def _row(label: str, times_s: Iterable[float]) -> str:
    return spread(list(times_s), *UNIT[label.split()[0].rstrip(",")])


def _place(label: str) -> tuple[int, str]:
    return list(UNIT).index(label.split()[0].rstrip(",")), label


if __name__ == "__main__":
    main()
