"""Do two arms with crossing motions, commanded separately at the same time, ever touch?

Pairs of random motions of the two arms of the simulated cell, in physics. Each arm starts and ends at a random free
posture before the bay. Somewhere the line of one arm in joint space meets that of the other. One after the other in at
least one order, both motions are possible. Both commands are given at once. The whole cluster runs in one process: the
real Decision Unit, workers and MCM. Contacts between the arms are looked for in every tick, whatever the commands
report. Two motions overlap if both arms move on their paths in the same tick. If a command does not succeed, its advice
is followed literally when both have ended. With `--stops` either arm is halted, or paused for a time, while both move.

    python -m tests.campaigns.two_arms [--pairs 200] [--stops]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.report import finish, percentile, question
from rtc.model.robot.collision_scene import AS_BUILT, Scene
from rtc.protocol.messages import NoteKind, SetPaused
from rtc.protocol.outcomes import OutcomeKind, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.arm import TICK_S, ArmState, HandCommand
from sim_mcm.arms.bullet_arm import BulletCell
from tests.campaigns import RESULTS, advice
from tests.workers.conftest import CELL, MODEL
from tests.workers.one_process import OneProcess
from workers.planning.motion.beside import SPACE_M, course, waits
from workers.planning.motion.path import joint_line
from workers.planning.motion.plan import find_joint_way
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import time_path
from workers.planning.scenes import ARMS_APART_M

SEED = 5
ARMS = ("RIGHT-ARM", "LEFT-ARM")
WAITED = (NoteKind.PLANNED_AGAIN, NoteKind.MOTIONS_CHANGED)  # beside the other arm; other waits have an owner
LOW, HIGH = (0.30, -0.35, 0.50), (0.65, 0.35, 1.05)  # of the goals of both hands, world (m)
TILT_RAD = 0.6  # greatest deviation of a hand from horizontal
MARGIN_RAD = 0.08  # from every joint limit
STOP_TICKS, PAUSE_TICKS = 500, 3000  # latest time of a stop, since both arms move; duration of a pause
CLEAR_M = 0.03  # of starts and goals from everything


class Pair(NamedTuple):
    """Start and goal of each arm (rad)."""

    starts: dict[str, Array]
    goals: dict[str, Array]


class Ended(NamedTuple):
    kinds: list[str]
    touches: int  # ticks with a contact between the arms
    overlap_s: float
    shorter_s: float  # duration of the shorter motion
    took_s: float  # from the sentences to the last end
    waited: bool  # one arm started on a condition, or planned again
    causes: list[str]
    advised: list[advice.Followed]  # the advice of each command that did not succeed


def random_pairs(seed: int) -> Iterator[Pair]:
    """Crossing pairs: some posture on the path of one arm meets some posture on the path of the other."""
    random = np.random.default_rng(seed)
    postures = {arm: _postures(arm, random) for arm in ARMS}
    while True:
        starts = {arm: next(postures[arm]) for arm in ARMS}
        goals = {arm: next(postures[arm]) for arm in ARMS}
        if _free(starts) and _free(goals) and _crosses(starts, goals) and _possible(starts, goals):
            yield Pair(starts, goals)


def _postures(arm: str, random: np.random.Generator) -> Iterator[Array]:
    model = MODEL.arms[arm]
    while True:
        point = random.uniform(LOW, HIGH)
        turn = (random.uniform(-TILT_RAD, TILT_RAD), math.pi / 2 + random.uniform(-TILT_RAD, TILT_RAD), 0.0)
        found = model.ik(geometry.from_rpy(point, turn).tolist(), CELL.arm(arm).home_rad, MARGIN_RAD)
        if len(found):
            yield np.asarray(found[0])


def _free(joints: dict[str, Array]) -> bool:
    return MODEL.collision.check(joints, Scene(clearance_m=CLEAR_M)) is None


def _crosses(starts: dict[str, Array], goals: dict[str, Array]) -> bool:
    try:
        lines = [time_path(MODEL.arms[arm], joint_line(starts[arm], goals[arm])) for arm in ARMS]
    except Refused:
        return False
    check = MODEL.collision.compare_arms(*ARMS, AS_BUILT)
    courses = [course(line.trajectory(), reach) for line, reach in zip(lines, check.reaches, strict=True)]
    return waits(check, courses[0], courses[1], SPACE_M) != []


def _possible(starts: dict[str, Array], goals: dict[str, Array]) -> bool:
    """Whether the planner finds a way for each arm, in one order or the other."""
    return any(
        _way(one, starts, goals) and _way(other, {**starts, one: goals[one]}, goals)
        for one, other in (ARMS, ARMS[::-1])
    )


def _way(arm: str, joints: dict[str, Array], goals: dict[str, Array]) -> bool:
    request = PlanningRequest(
        MODEL.arms[arm], MODEL.collision, joints, Scene(moving=arm, arms_apart_m=ARMS_APART_M), margin_rad=MARGIN_RAD
    )
    try:
        find_joint_way(request, goals[arm])
    except Refused:
        return False
    return True


class Stop:
    """A halt, or a pause, of either arm at a random time while both are on their paths."""

    def __init__(self, random: np.random.Generator) -> None:
        self._left = 1 + int(random.integers(STOP_TICKS))
        self._halts, self._arm = bool(random.integers(2)), int(random.integers(2))
        self._paused = ""
        self._until = 0  # tick

    def follow(self, cluster: OneProcess) -> None:
        """Call it in every tick."""
        moving = [name for name in ARMS if cluster.ticks in cluster.moving[name]]
        if self._paused and cluster.ticks >= self._until:
            cluster.mcm.handle(SetPaused(primitive=self._paused, paused=False), BROKER, cluster.now_s)
            self._paused = ""
        self._left -= len(moving) == len(ARMS)
        if self._left or self._until:
            return
        self._until = cluster.ticks + PAUSE_TICKS
        if self._halts:
            cluster.give(f"HALT {ARMS[self._arm]}", client="the one who halts")
            return
        self._paused = cluster.mcm.executors[ARMS[self._arm]].primitive_id
        cluster.mcm.handle(SetPaused(primitive=self._paused, paused=True), BROKER, cluster.now_s)


class Runner:
    """The cell in physics, used for one pair after another."""

    def __init__(self) -> None:
        self._sim = BulletCell(CELL)
        self._state = self._sim.state()

    def run(self, pair: Pair, stop: Stop | None = None) -> Ended:
        cluster = self.at(pair.starts)
        sentences = {}
        for arm, goal in pair.goals.items():
            words = " ".join(f"{x:.6f}" for x in goal)
            sentence = f"MOVE {arm} TO JOINTS {words} RAD JOINT-MOTION"
            sentences[cluster.give(sentence, client=arm)] = sentence
        touches = 0
        while cluster.state.commands:
            assert cluster.ticks < 120_000, [c.notes[-1] for c in cluster.state.commands.values()]
            cluster.tick()
            if stop is not None:
                stop.follow(cluster)
            touches += any(arm.arm_touches() for arm in self._sim.arms.values())
        ticks = [set(cluster.moving[arm]) for arm in ARMS]
        took_s, outcomes = cluster.ticks * TICK_S, {name: cluster.outcomes[name] for name in sentences}
        failed = {command: one for command, one in outcomes.items() if one.kind is not OutcomeKind.SUCCEEDED}
        waited = any(note.kind in WAITED or note.owner for note in cluster.notes)
        return Ended(
            kinds=[outcome.kind.value for outcome in outcomes.values()],
            touches=touches,
            overlap_s=len(ticks[0] & ticks[1]) * TICK_S,
            shorter_s=min(map(len, ticks)) * TICK_S,
            took_s=took_s,
            waited=waited,
            causes=[outcome.message for outcome in failed.values()],
            advised=[]
            if stop
            else [advice.follow_in_cluster(cluster, sentences[name], one) for name, one in failed.items()],
        )

    def at(self, starts: Mapping[str, Floats]) -> OneProcess:
        """A fresh cluster, with the arms at these postures."""
        for arm, joints in starts.items():
            width = CELL.arm(arm).gripper.max_opening_m
            hand = HandCommand(width, CELL.arm(arm).gripper.max_force_n, CELL.arm(arm).gripper.speed_m_s)
            fingers = (0.5 * width, 0.5 * width)
            self._state.arms[arm] = ArmState(joints=list(joints), fingers=fingers, hand=hand, opening_m=width)
        self._sim.restore(self._state)
        cluster = OneProcess(self._sim)
        cluster.know_joints(starts)
        return cluster

    def close(self) -> None:
        self._sim.close()


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--pairs", type=int, default=200)
    words.add_argument("--stops", action="store_true", help="halt or pause either arm at a random time")
    given = words.parse_args()
    question("two_arms", "do two arms with crossing motions, commanded at the same time, ever touch?", seed=SEED)
    runner, runs = Runner(), []
    for n, pair in enumerate(random_pairs(SEED), 1):
        runs.append(runner.run(pair, Stop(np.random.default_rng(n)) if given.stops else None))
        if runs[-1].causes:
            print(f"  pair {n}: {'; '.join(runs[-1].causes)}", flush=True)
            for followed in runs[-1].advised:
                print(f"    {followed.end}: {' | '.join(followed.history)}", flush=True)
        if n % 20 == 0:
            print(f"  {n} of {given.pairs} pairs", flush=True)
        if n == given.pairs:
            break
    runner.close()
    metrics, rows = _results(runs)
    finish("two_arms_stopped" if given.stops else "two_arms", metrics, rows, RESULTS)


def _results(runs: list[Ended]) -> tuple[dict[str, float | None], list[tuple[str, str]]]:
    touched = sum(run.touches > 0 for run in runs)
    overlapped = [run for run in runs if run.overlap_s > 0.0]
    shares = [run.overlap_s / max(run.shorter_s, TICK_S) for run in runs]
    share = percentile(shares, 50)
    both = sum(run.kinds == ["succeeded", "succeeded"] for run in runs)
    ends, followed = advice.summary(one.end for run in runs for one in run.advised)
    metrics: dict[str, float | None] = {
        "pairs": float(len(runs)),
        "touched": float(touched),
        "overlap_percent": 100.0 * len(overlapped) / len(runs),
        "both_succeeded_percent": 100.0 * both / len(runs),
        "waited_percent": 100.0 * sum(run.waited for run in runs) / len(runs),
        "overlap_share_p50": share,
        "overlap_share_mean": sum(shares) / len(shares),
        **ends,
    }
    rows = [
        ("pairs whose arms touched", f"{touched} of {len(runs)}"),
        ("both motions at once, at least for a time", f"{len(overlapped)} of {len(runs)}"),
        ("share of the shorter motion, of all", f"p50 {share:.2f}, mean {sum(shares) / len(shares):.2f}"),
        ("one arm waited for space", f"{sum(run.waited for run in runs)} of {len(runs)}"),
        ("both commands succeeded", f"{both} of {len(runs)}"),
        ("from the sentences to the last end", f"p50 {percentile([r.took_s for r in runs], 50):.1f} s"),
        followed,
    ]
    return metrics, rows


if __name__ == "__main__":
    main()
