"""Is each world change written exactly once while analyzers are killed at random?

    python -m tests.campaigns.analyzers [--commands 200] [--every 0.3] [--seed 20]

Two arms grasp, lift, put back and stow their modules in physics, as fast as the simulation goes. At random times, on
average every 0.3 seconds, SIGKILL kills one analyzer. At the end the journal is compared with the world database. Each
analysis that the broker has received wrote its changes as one version, with the values of its answer; no version is of
another job; each job has written once. An analyzer that is killed after its commit has its job repeated in the world
that it has changed: the answer then states what is left to change, and nothing is written again. Last the facts are
compared with the truth of the simulator.
"""

from __future__ import annotations

import argparse
import random
import sqlite3
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks.load.verdict import JournalReader
from benchmarks.report import finish, question
from broker.decisions.events import Event, JobFinished
from rtc.apps.demos.grasp import GRASPS, LIFTS, PLACES, STOWS
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.outcomes import Outcome, OutcomeKind
from rtc.runtime.process_table import processes
from rtc.spatial import geometry
from tests.campaigns import RESULTS
from tests.campaigns.chaos import Chaos

SEED = 20
FIRST = "cell"  # wrote the facts with which the database begins
ROUND = [list(pair) for pair in zip(GRASPS, LIFTS, PLACES, STOWS, strict=True)]  # per arm, its four sentences
LOOK_S = 0.02
AWAY_M = 0.005  # of a fact from the truth
BACK_S = 30.0


class Written(NamedTuple):
    """What the world database has of one version."""

    job: str
    values: dict[str, tuple[Any, str]]  # key -> value, validity


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commands", type=int, default=200)
    parser.add_argument("--every", type=float, default=0.3, help="seconds between two kills, on average")
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    question("analyzers", "is each world change written once while analyzers are killed?", seed=given.seed)
    rng = random.Random(given.seed)
    with own_cluster(speed="max") as run_dir:
        chaos = Chaos(run_dir, rng)
        began_s = time.monotonic()
        journal = JournalReader(run_dir)
        journal.follow()
        ended = commanded(run_dir, chaos, given.commands, given.every, rng)
        outcomes, took_s = Counter(one.kind.value for one in ended), time.monotonic() - began_s
        until_s = time.monotonic() + BACK_S
        while chaos.missing and time.monotonic() < until_s:
            chaos.returned()
            time.sleep(LOOK_S)
        with Client(run_dir) as rtc:
            away_m = away_from_truth(rtc)
        journal.close()
        finished = analyses(journal.events)
        faults = compared(finished, written(run_dir))
    for line in [*(one.message for one in ended if one.kind is not OutcomeKind.SUCCEEDED), *faults]:
        print(f"  {line}")
    metrics = {
        "commands": sum(outcomes.values()),
        "succeeded": outcomes[OutcomeKind.SUCCEEDED.value],
        "kills": len(chaos.strikes),
        "not_back": len(chaos.missing),
        "analyses": len(finished),
        "analyses_repeated": sum(one.attempt > 1 for one in finished),
        "journal_missed": journal.missed,
        "faults": len(faults),
        "away_from_truth_mm": 1e3 * away_m,
        "took_s": took_s,
    }
    finish("analyzers", metrics, folder=RESULTS, data=dict(outcomes))
    sys.exit(bool(faults) or away_m > AWAY_M)


def commanded(run_dir: Path, chaos: Chaos, commands: int, every_s: float, rng: random.Random) -> list[Outcome]:
    """The outcomes of this many commands, half of them for each arm, with kills in between."""
    with ThreadPoolExecutor(len(ROUND)) as arms:
        done = [arms.submit(_one_arm, run_dir, sentences, commands // len(ROUND)) for sentences in ROUND]
        next_s = time.monotonic()
        while not all(arm.done() for arm in done):
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + rng.expovariate(1.0 / every_s)
                names = sorted(name for name in processes(run_dir) if name.startswith("analyzer@"))
                chaos.strike("worker", rng.choice(names))
            chaos.returned()
            time.sleep(LOOK_S)
        return [outcome for arm in done for outcome in arm.result()]


def _one_arm(run_dir: Path, sentences: list[str], commands: int) -> list[Outcome]:
    with Client(run_dir) as rtc:
        return [rtc.run(sentences[n % len(sentences)]).outcome for n in range(commands)]


def analyses(events: list[Event]) -> list[JobFinished]:
    """The analyses that the broker has received, the first answer of each job."""
    found: dict[str, JobFinished] = {}
    for event in events:
        if isinstance(event, JobFinished) and "verdict" in msgspec.msgpack.decode(event.product):
            found.setdefault(event.job, event)
    return list(found.values())


def written(run_dir: Path) -> list[Written]:
    with closing(sqlite3.connect(f"file:{run_dir / 'world.db'}?mode=ro", uri=True)) as db:
        rows = db.execute("SELECT version, source, key, value, validity FROM history ORDER BY version").fetchall()
        jobs = dict(db.execute("SELECT version, job FROM commits").fetchall())
    found = {version: Written(job, {}) for version, job in jobs.items()}
    for version, _source, key, value, validity in rows:
        found[version].values[key] = (msgspec.json.decode(value), validity)
    return list(found.values())


def compared(finished: list[JobFinished], world: list[Written]) -> list[str]:
    """What is wrong, in words."""
    counts = Counter(one.job for one in world)
    faults = [f"{job} has written {count} times" for job, count in counts.items() if count != 1]
    versions = {one.job: one for one in world}
    answered = {event.job: msgspec.msgpack.decode(event.product).get("changes", []) for event in finished}
    repeated = {event.job for event in finished if event.attempt > 1}
    for job, changes in answered.items():
        if not changes:
            continue
        if job not in versions:
            faults.append(f"{job} has changes, and has written nothing")
            continue
        stated = {change["key"] for change in changes}
        wrote = {*versions[job].values}
        if stated != wrote and not (job in repeated and stated < wrote):
            faults.append(f"{job} has written {sorted(versions[job].values)}, and answered {sorted(stated)}")
        for change in changes:
            if not change.get("keep_value"):
                value, validity = versions[job].values.get(change["key"], (None, ""))
                if (value, validity) != (change.get("value"), change.get("validity", "valid")):
                    faults.append(f"{job}: {change['key']} is {value} {validity}, and not {change.get('value')}")
    others = [one.job for one in world if one.job not in answered and one.job != FIRST]
    return faults + [f"{job} has written, and no analysis of that name ended" for job in others]


def away_from_truth(rtc: Client) -> float:
    """The largest distance of a valid pose of an object from the truth (m)."""
    truth = rtc.truth().poses
    facts = {fact.key: fact for fact in rtc.world.view().facts if fact.validity.value == "valid"}
    pairs = [(facts[f"{name}.frame"].value, pose) for name, pose in truth.items() if f"{name}.frame" in facts]
    return max(geometry.distance(believed, true) for believed, true in pairs)


if __name__ == "__main__":
    main()
