"""What does a real sentence cost, in processor time, and where?

    python -m benchmarks.sentences [--rounds 3] [--seconds 4] [--against COMMIT]

Sentences run in the cluster of `benchmarks.throughput` as far as a bound motion: real parser, elaborator and binder,
8 workers, two arms, the journal on. The first table has the processor time of a sentence by process. With `--against`
the same is measured in a checkout of another commit, in alternation (other, this, this, other), so that a busy machine
affects both; the ratio is that of the medians.

The second table has shares of stages. Those of the workers are from one process, with the profiler on: their jobs of
other sentences (grasp, carry, place), each sentence parsed anew. Those of the broker are from a cluster as above whose
broker has the profiler on, without its waits and its start. They are for comparing stages, not for adding up.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import os
import pstats
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.load.scenarios import Scenario, Workers, sentences
from benchmarks.report import finish, question
from benchmarks.throughput import PLANNERS, SATURATING, flood, motion, spread
from rtc.model.cells.cell import Cell
from rtc.protocol import wire

Function = tuple[str, int, str]  # of a profile: file, line, name
HERE = Path(__file__).parent.parent
SEED = 20
REPEATED = 5  # times that each job is done under the profiler
#: run in either checkout: one measurement, as a line of JSON
MEASURE = """
import json
from benchmarks.throughput import PLANNERS, SATURATING, flood, motion
run = flood(3, {seconds}, SATURATING, real=PLANNERS, text=motion)
print(json.dumps(dict(per_s=run.commands_per_s, cpu_us=run.cpu_us)))
"""
#: stage -> parts of the names of the files and functions that belong to it; the first that fits counts
WORKER_STAGES = {
    "parsing": ("workers/parser", "rtc/language"),
    "inverse kinematics": ("puma_ik", "numeric_ik", "ik_along", "_boxes.along", "_boxes.within", "_boxes.turned_to"),
    "timing": ("timing.py", "within_torques", "toppra", "rest_to_rest", "quintic", "blended", "pace"),
    "collision": ("collision", "boxes.py", "coal", "separation", "scene_state"),
    "torques": ("torques", "rnea", "crba"),
    "path": ("motion/path.py", "spline.py", "smooth.py", "curves.py", "sampl"),
    "kinematics": ("kinematics.py", "pinocchio"),
    "cameras": ("sensing", "sight"),
    "programs": ("rtc/programs", "conditions", "ast.py"),
    "encoding": ("msgspec", "wire.py"),
    "analysis": ("workers/analyzer",),
    "planning": ("workers/planning", "workers/elaborator", "workers/binder"),
}
IDLE = "waits and start"
BROKER_STAGES = {
    IDLE: ("zmq/sugar/poll.py", "<module>", "importlib", "ast.py", "inspect.py"),
    "journal": ("journal.py", "sqlite3"),
    "encoding": ("msgspec", "wire.py"),
    "decisions": ("broker/decisions", "rtc/programs"),
    "messages": ("broker/", "zmq", "rtc/runtime"),
}
OUTWARDS = 6  # callers after which the time of a built-in function is not assigned any more


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--rounds", type=int, default=3)
    words.add_argument("--seconds", type=float, default=4.0, help="of each measurement")
    words.add_argument("--against", metavar="COMMIT", help="another commit of this repository, measured in alternation")
    given = words.parse_args()
    question("sentences", "what does a real sentence cost, by process and by stage?", seed=SEED)
    runs: dict[str, list[dict[str, float]]] = {"this": [], "other": []}
    with checkout(given.against) as other:
        for number in range(1, given.rounds + 1):
            order = ["this"] if other is None else ["other", "this"] if number % 2 else ["this", "other"]
            for name in order:
                found = measure(HERE if name == "this" else other or HERE, given.seconds)
                runs[name].append(found)
                print(f"  round {number}: {name}: {found['per_s']:.0f}/s, {found['sum']:.2f} ms a sentence", flush=True)
    shares = {f"stage of workers: {name}": share for name, share in worker_stages().items()}
    shares |= {f"stage of the broker: {name}": share for name, share in broker_stages(given.seconds).items()}
    metrics = {"sentences_per_s": _middle(runs["this"], "per_s"), "sentence_ms": _middle(runs["this"], "sum")}
    if runs["other"]:
        metrics["vs_other"] = metrics["sentence_ms"] / _middle(runs["other"], "sum")
    finish("sentences", metrics, [*rows(runs), *((name, f"{share:.0%}") for name, share in shares.items())])


def rows(runs: dict[str, list[dict[str, float]]]) -> Iterator[tuple[str, str]]:
    for key in runs["this"][0]:
        unit = "/s" if key == "per_s" else "ms of processor time a sentence"
        label = {"per_s": "sentences as far as bound", "sum": "all processes"}.get(key, key)
        mine = spread([run[key] for run in runs["this"]], 0 if key == "per_s" else 2)
        against = ""
        if runs["other"] and _middle(runs["other"], key) > 0.0:
            theirs = spread([run[key] for run in runs["other"]], 0 if key == "per_s" else 2)
            against = f"; other {theirs}, {_middle(runs['this'], key) / _middle(runs['other'], key):.2f} times"
        yield label, f"{mine} {unit}{against}"


def _middle(runs: list[dict[str, float]], key: str) -> float:
    return median(run.get(key, 0.0) for run in runs)


def measure(tree: Path, seconds: float) -> dict[str, float]:
    """Sentences per second, and ms of processor time of a sentence: of each process, and their sum."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURE.format(seconds=seconds)],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{tree}: {done.stderr[-2000:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    by_process = {name: 1e-3 * us for name, us in found["cpu_us"].items()}
    return {"per_s": found["per_s"], "sum": sum(by_process.values()), **by_process}


@contextmanager
def checkout(commit: str | None) -> Iterator[Path | None]:
    """A checkout of the commit, with its compiled parts; None without a commit."""
    if commit is None:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="rtc-against-") as folder:
        tree = Path(folder) / "tree"
        _run("git", "worktree", "add", "--detach", str(tree), commit)
        try:
            _copy_compiled(tree, Path(folder))
            yield tree
        finally:
            _run("git", "worktree", "remove", "--force", str(tree))


def _copy_compiled(tree: Path, folder: Path) -> None:
    """Our compiled collision boxes if the sources are the same, else those of the other commit, built by pip."""
    package = Path("rtc/model/robot")
    theirs, ours = ([path.read_bytes() for path in sorted((at / package).glob("_*.?pp"))] for at in (tree, HERE))
    if not theirs:
        return
    built = HERE
    if theirs != ours:
        built = folder / "built"
        _run(sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(built), str(tree))
    for path in (built / package).glob("_boxes*.so"):
        shutil.copy(path, tree / package)


def _run(*command: str) -> None:
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stderr[-2000:]}")


def worker_stages() -> dict[str, float]:
    """The share of each stage in the time of all workers, the greatest first."""
    rng, workers = random.Random(SEED), Workers(Cell.load("swapout"))
    scenario = Scenario(workers, rng)
    for sentence in sentences(rng):
        scenario.run(sentence)
    profile = cProfile.Profile()
    profile.enable()
    for job in scenario.jobs * REPEATED:
        wire.raw(workers.do(job))
    profile.disable()
    return shares(pstats.Stats(profile), WORKER_STAGES)


def broker_stages(seconds: float) -> dict[str, float]:
    """The share of each stage in the time of the broker's loop, the greatest first."""
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        file = Path(folder) / "broker.profile"
        flood(3, seconds, SATURATING, real=PLANNERS, text=motion, profile=file)
        return shares(pstats.Stats(str(file)), BROKER_STAGES)


def shares(profile: pstats.Stats, stages: dict[str, tuple[str, ...]]) -> dict[str, float]:
    """The share of each stage. What fits no stage, such as a built-in function, counts for those that call it."""
    stats: dict[Function, Any] = profile.stats  # type: ignore[attr-defined]
    spent: dict[str, float] = {}

    def add(function: Function, own_s: float, outwards: int) -> None:
        file, _, name = function
        stage = next((stage for stage, parts in stages.items() if any(p in f"{file} {name}" for p in parts)), "")
        callers = {caller: own for caller, (_, _, own, _) in stats[function][4].items()} if function in stats else {}
        whole = sum(callers.values())
        if stage or not outwards or whole <= 0.0:
            spent[stage or "other"] = spent.get(stage or "other", 0.0) + own_s
            return
        for caller, own in callers.items():
            add(caller, own_s * own / whole, outwards - 1)

    for function, (_, _, own_s, _, _) in stats.items():
        add(function, own_s, OUTWARDS)
    spent.pop(IDLE, None)
    whole_s = sum(spent.values())
    return {name: own_s / whole_s for name, own_s in sorted(spent.items(), key=lambda one: -one[1])}


if __name__ == "__main__":
    main()
