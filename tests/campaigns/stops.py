"""Can an arm leave after every stop, if the operator follows the advice literally?

In physics, an arm is stopped in the middle of a sentence: at a force limit, by a halt, by the death of the MCM, or by
an injected fault, in the air or while it leans on an unknown box. It is empty or holds a module or the door, at the
rack, in the bay or between. Then the sentences that the outcome advises are given as they stand, at most four. The
advice of a sentence that fails replaces that before. If no sentence is advised, or all of them are done, the arm is
stowed. An outcome without a sentence says that nothing holds the arm, so that STOW must not be refused. A run is stuck
if it is, or if none of the four sentences succeeds and moves the arm. An operator who looks sees: `SET X FRAME x y z`
states the truth. A broken joint, sensor or hand is mended before. The box stays where it is.

    python -m tests.campaigns.stops [--runs 200] [--seed 18] [--shard 1/4] [--only 17]

Decision Unit, workers and MCM are the real ones in one process; a new MCM continues from the state of the hardware. The
parts of a run in shards are joined when the last one ends.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pybullet

from benchmarks.report import percentile, question
from rtc.model.cells.cell import Cell
from rtc.protocol import faults as f
from rtc.protocol.outcomes import Outcome, OutcomeKind, StopReason
from rtc.subsystems.motion.arm import CellState
from rtc.wording.advice import in_one_line
from rtc.world.model import World, initial_facts
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.faults import Injections
from tests.campaigns import RESULTS, advice, numbered_runs
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess
from workers.planning.robot_models import CellModel

SEED = 18
LIMIT_S = 600.0  # of a command, simulated
MOVED_RAD = 0.01  # an arm that moved by less has not left
ATTEMPTS = 8  # sentences that end without a stop are drawn anew
LEANS_N = 5.0

MODULES = {"RIGHT-ARM": ("MACS-NEW", "HANDLE-A", "RACK-1"), "LEFT-ARM": ("MACS-OLD", "HANDLE-B", "RACK-2")}
MOVES = ("STOW {arm}", "MOVE {arm} TO CLEAR-POINT-1", "MOVE {arm} BY {cm} CM ALONG {axis}")
PLACES = ("PLACE {module} ON {rack} WITH {arm}", "PLACE {module} ON BAY-2 WITH {arm}")
PLACES += ("INSERT {module} INTO BAY-2 WITH {arm}",)
LIFT = "LIFT {module} BY 15 CM WITH {arm}"
GRASP = "GRASP {module} {handle} WITH {arm}"
AT_HANDLE = ("APPROACH {module} AT {handle} WITH {arm}", "MOVE {arm} BY 10 CM ALONG TOOL-Z")
IN_BAY = (GRASP, LIFT, "INSERT {module} INTO BAY-2 WITH {arm}", GRASP)
#: start -> (cell, sentences that lead there, sentences to be stopped)
STARTS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "home": ("swapout", (), (*MOVES[1:], GRASP)),
    "before": ("swapout", AT_HANDLE[:1], (*MOVES, GRASP)),
    "handle": ("swapout", AT_HANDLE, (*MOVES[2:], "RETRACT {arm}", GRASP)),
    "seated": ("swapout", (GRASP,), (LIFT, "RELEASE {module} WITH {arm}")),
    "half-way": ("swapout", (GRASP, "LIFT {module} BY 5 CM WITH {arm}"), (LIFT,)),
    "lifted": ("swapout", (GRASP, LIFT), (*MOVES, *PLACES)),
    "carried": ("swapout", (GRASP, LIFT, "MOVE {arm} TO CLEAR-POINT-1"), (*MOVES, *PLACES)),
    "bay": ("swapout", IN_BAY, (LIFT, "RELEASE {module} WITH {arm}")),
    "door": ("servicing", ("GRASP DOOR-2 WITH {arm}",), ("OPEN DOOR-2 WITH {arm}", "RETRACT {arm}")),
}
CLAUSES = ("", "", " MAINTAIN SPEED {speed} CM/S", " UNLESS FORCE EXCEEDS {force} N THEN STOP")
CLAUSES += (" UNLESS CONTACT THEN STOP", " UNLESS FORCE EXCEEDS {force} N THEN BACK-OFF", " GUARDED")
CAUSES = ("box", "box", "halt", "halt while leaning", "kill", "kill while leaning", "fault")
AXES = ("X", "Y", "Z", "TOOL-X", "TOOL-Y", "TOOL-Z")

# --- a cell and its states ------------------------------------------------------------------------------------


class Ground:
    """A cell in physics with its starts as states to return to."""

    def __init__(self, name: str) -> None:
        self.cell = Cell.load(name)
        self.model = CellModel(self.cell)
        self.sim = BulletCell(self.cell)
        self.box = -1
        self._surveyed = [msgspec.structs.replace(change, spread=None) for change in initial_facts(self.cell)]
        self._start = self.sim.state()
        self._known: dict[tuple[str, ...], tuple[CellState, World]] = {}

    def after(self, sentences: tuple[str, ...]) -> OneProcess:
        """A new cluster in the start after these sentences."""
        self.clear()
        if sentences not in self._known:
            if not sentences:
                self._known[()] = self._start, World().overlay(self._surveyed)
            else:
                cluster = self.after(sentences[:-1])
                outcome = say(cluster, sentences[-1])
                assert outcome.kind is OutcomeKind.SUCCEEDED, (sentences, outcome)
                self._known[sentences] = self.sim.state(), cluster.world
        state, world = self._known[sentences]
        self.sim.restore(state)
        return OneProcess(self.sim, self.model, world, Ideal(self.cell))

    def clear(self) -> None:
        """Take away the box."""
        if self.box >= 0:
            pybullet.removeBody(self.box, physicsClientId=self.sim.world.client)
            del self.sim.world.names[self.box]
            self.box = -1

    def put_box(self, before: str, thing: str, way: Any, random: np.random.Generator) -> None:
        """A box that is in no world, a few millimetres before this arm's hand or what it holds, on its `way`."""
        client, arm = self.sim.world.client, self.sim.arms[before]
        links = [(arm.body, link) for link in arm.fingers]
        if thing in self.sim.world.movable:
            links = [(self.sim.world.objects[thing].id, -1)]
        corners = np.array([pybullet.getAABB(body, link, physicsClientId=client) for body, link in links])
        low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        axis = int(np.abs(way).argmax())
        half = random.uniform(0.02, 0.05, 3)
        at = random.uniform(low, high)
        gap_m = random.uniform(0.003, 0.02)
        at[axis] = high[axis] + gap_m + half[axis] if way[axis] > 0.0 else low[axis] - gap_m - half[axis]
        shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half.tolist(), physicsClientId=client)
        self.box = pybullet.createMultiBody(0.0, shape, basePosition=at.tolist(), physicsClientId=client)
        self.sim.world.names[self.box] = "a box"
        for other in self.sim.arms.values():
            if pybullet.getClosestPoints(self.box, other.body, 0.001, physicsClientId=client):
                self.clear()  # it would stand in an arm
                return


def say(cluster: OneProcess, sentence: str, each_tick: Callable[[], None] = lambda: None) -> Outcome:
    """Give a sentence, and wait for its end."""
    command, last = cluster.give(sentence), cluster.ticks + round(1000 * LIMIT_S)
    while cluster.state.commands:
        assert cluster.ticks < last, (sentence, [c.notes[-1] for c in cluster.state.commands.values()])
        cluster.tick()
        each_tick()
    return cluster.outcomes[command]


# --- one run --------------------------------------------------------------------------------------------------


class Drawn(msgspec.Struct, frozen=True):
    """A sentence, and what stops it."""

    start: str
    arm: str
    sentence: str
    cause: str  # of CAUSES, or `trip`: the arm ends its primitive for the reason in `fault`
    fault: str
    after_s: float  # from the start of the motion until the box, halt, kill or fault
    seed: int


class Run(msgspec.Struct):
    n: int
    drawn: Drawn
    stop: str  # reason, or the kind of the outcome
    laden: bool
    lead_rad: float  # of the command, 0.3 s after the stop
    moved: bool
    story: list[str]  # the sentences after the stop with their outcomes


class Stopper:
    """Stops the arm in the middle of its motion, once."""

    def __init__(self, ground: Ground, cluster: OneProcess, drawn: Drawn) -> None:
        self._ground, self._cluster, self._drawn = ground, cluster, drawn
        self._random = np.random.default_rng(drawn.seed)
        self._moving_s = 0.0
        self._before: Any = None
        self.faults = Injections(ground.cell, ground.sim, cluster.mcm.executors)
        self._steps = [self._box] if drawn.cause.startswith("box") or "leaning" in drawn.cause else []
        self._steps += [] if drawn.cause == "box" else [self._strike]

    def tick(self) -> None:
        drawn, executor = self._drawn, self._cluster.mcm.executors[self._drawn.arm]
        if self.faults.drifts:
            self.faults.advance()
        here = self._ground.sim.arms[drawn.arm].tcp_pose(executor.sample.joints)
        before, self._before = self._before, here
        if not self._steps or not executor.moving or before is None:
            return
        self._moving_s += 0.001
        leans = "leaning" in drawn.cause and self._steps[0] == self._strike
        if leans and executor._seen.force_n < LEANS_N:
            return
        way = here[:3] - before[:3]
        if self._moving_s >= drawn.after_s and (leans or drawn.cause == "fault" or np.abs(way).max() > 1e-6):
            self._steps.pop(0)(way)

    def _box(self, way: Any) -> None:
        held = self._ground.sim.held()[self._drawn.arm]
        self._ground.put_box(self._drawn.arm, held[0] if held else "", way, self._random)

    def _strike(self, way: Any) -> None:
        cause, arm = self._drawn.cause.split()[0], self._drawn.arm
        if cause == "halt":
            self._cluster.halt(self._random.choice(["ALL", arm]))
        elif cause == "kill":
            self._cluster.kill_mcm()
        elif cause == "trip":
            self._cluster.mcm.executors[arm].halt(StopReason(self._drawn.fault), "as drawn")
        else:
            self.faults.inject(self._fault())

    def _fault(self) -> f.AnyFault:
        arm, random = self._drawn.arm, self._random
        module, _, rack = MODULES[arm]
        kinds: dict[str, Callable[[], f.AnyFault]] = {
            "stick": lambda: f.StuckJoint(arm=arm, joint=str(random.choice(self._ground.cell.arm(arm).joints))),
            "offset": lambda: f.FalseSensor(arm=arm, offset=random.uniform(-60.0, 60.0, 3).tolist() + [0.0] * 3),
            "freeze": lambda: f.FalseSensor(arm=arm),
            "drop": lambda: f.FailedHand(arm=arm),
            "jam": lambda: f.JammedSeat(seat=str(random.choice([rack, "BAY-2"]))),
            "displace": lambda: f.Displaced(object=module, offset=[*random.uniform(-0.03, 0.03, 3), 0.0, 0.0, 0.0]),
            "drift": lambda: f.Drifting(object=module, velocity=[*random.uniform(-0.02, 0.02, 3), 0.0, 0.0, 0.0]),
        }
        return kinds[self._drawn.fault]()


def draw(random: np.random.Generator) -> Drawn:
    start = str(random.choice(list(STARTS)))
    arm = "LEFT-ARM" if start == "door" else str(random.choice(list(MODULES)))
    sentences = STARTS[start][2]
    names = _names(arm) | {"cm": f"{random.choice([-1, 1]) * random.uniform(3, 20):.1f}", "axis": random.choice(AXES)}
    figures = {"speed": f"{random.uniform(1, 20):.1f}", "force": f"{random.uniform(5, 40):.0f}"}
    return Drawn(
        start=start,
        arm=arm,
        sentence=(str(random.choice(sentences)) + str(random.choice(CLAUSES))).format(**names, **figures),
        cause=str(random.choice(CAUSES)),
        fault=str(random.choice(["stick", "offset", "freeze", "drop", "jam", "displace", "drift"])),
        after_s=float(random.uniform(0.05, 4.0)),
        seed=int(random.integers(1 << 31)),
    )


def _names(arm: str) -> dict[str, str]:
    module, handle, rack = MODULES[arm]
    return {"arm": arm, "module": module, "handle": handle, "rack": rack}


_grounds: dict[str, Ground] = {}


def run(n: int, seed: int = SEED) -> Run:
    """The run of this number: sentences are drawn until one is stopped."""
    random = np.random.default_rng([seed, n])
    for _ in range(ATTEMPTS):
        drawn = draw(random)
        if (found := stop_and_leave(n, drawn)) is not None:
            return found
    raise AssertionError(f"run {n}: {ATTEMPTS} sentences ended without a stop")


def stop_and_leave(n: int, drawn: Drawn) -> Run | None:
    """Stop the arm as drawn, then follow the advice. None: nothing has stopped it, or its motion did not begin."""
    name, led, _ = STARTS[drawn.start]
    ground = _grounds.get(name) or _grounds.setdefault(name, Ground(name))
    cluster = ground.after(tuple(sentence.format(**_names(drawn.arm)) for sentence in led))
    stopper = Stopper(ground, cluster, drawn)
    outcome = say(cluster, drawn.sentence, stopper.tick)
    if outcome.kind in (OutcomeKind.SUCCEEDED, OutcomeKind.REFUSED):
        stopper.faults.undo("ALL")
        return None
    stopper.faults.undo("ALL")
    for _ in range(300):
        cluster.tick()
    executor = cluster.mcm.executors[drawn.arm]
    lead_rad = executor._seen.off(executor.command[0])
    laden = bool(ground.sim.held()[drawn.arm])
    moved, story = leave(cluster, drawn, outcome)
    first = f"{outcome.kind.value}: {outcome.message} || {_clears(outcome)}"
    reason = outcome.stop.value if outcome.stop else outcome.kind.value
    return Run(n=n, drawn=drawn, stop=reason, laden=laden, lead_rad=lead_rad, moved=moved, story=[first, *story])


def leave(cluster: OneProcess, drawn: Drawn, ended: Outcome) -> tuple[bool, list[str]]:
    """Follow the advice. Returns whether the arm has left, and the sentences with their outcomes."""
    story: list[str] = []
    arm = drawn.arm
    waiting = _advised(ended, drawn.sentence, cluster)
    free = not waiting
    for _ in range(advice.MAX_SENTENCES):
        sentence = waiting.pop(0) if waiting else f"STOW {arm}"
        before = list(cluster.mcm.executors[arm].sample.joints)
        outcome = say(cluster, sentence)
        off_rad = max(abs(a - b) for a, b in zip(cluster.mcm.executors[arm].sample.joints, before, strict=True))
        story.append(f"{sentence} -> {outcome.kind.value}: {outcome.message} || {_clears(outcome)}")
        if outcome.kind is not OutcomeKind.SUCCEEDED:
            waiting = _advised(outcome, sentence, cluster)
        elif off_rad > MOVED_RAD:
            return True, story
        if free and outcome.kind is OutcomeKind.REFUSED:
            return False, story
        free = outcome.kind is not OutcomeKind.SUCCEEDED and not waiting
    return False, story


def _advised(outcome: Outcome, given: str, cluster: OneProcess) -> list[str]:
    """The sentences of the first alternative of its advice."""
    return advice.first(outcome.refusal.clears if outcome.refusal else [], given, cluster.sim.truth)


def _clears(outcome: Outcome) -> str:
    return in_one_line(outcome.refusal.clears) if outcome.refusal else ""


# --- the campaign ---------------------------------------------------------------------------------------------


def main() -> None:
    words = numbered_runs.arguments(__doc__, runs=200)
    words.add_argument("--seed", type=int, default=SEED, help="of other stops, without results file")
    words.add_argument("--shard", default="1/1", help="K/N: every N-th run from the K-th")
    given = words.parse_args()
    shard, shards = map(int, given.shard.split("/"))
    question("stops", "can an arm leave after every stop by the advice alone?", seed=given.seed)
    found = []
    for n in given.only or range(shard - 1, given.runs, shards):
        one = run(n, given.seed)
        found.append(one)
        drawn = one.drawn
        where = f"{drawn.start}, {drawn.arm}, {drawn.cause}{f' {drawn.fault}' if drawn.cause == 'fault' else ''}"
        print(f"  run {n}: {where}: {drawn.sentence}: {one.stop}, {_sentences(one)} sentences", flush=True)
        if not one.moved or given.only:
            print("\n".join(["    STUCK" if not one.moved else "    left", *(f"      {line}" for line in one.story)]))
    if given.only or given.seed != SEED or shards == 1:
        _report(found, kept=not given.only and given.seed == SEED)
    else:
        _join(found, shard, shards)


def _sentences(one: Run) -> int:
    return sum(" -> " in line for line in one.story)


def _join(found: list[Run], shard: int, shards: int) -> None:
    """Write this part; report all of them if it is the last one."""
    part = RESULTS / f"stops-{shard}-of-{shards}.json"
    part.write_bytes(msgspec.json.encode(found))
    parts: list[Path] = [RESULTS / f"stops-{k}-of-{shards}.json" for k in range(1, shards + 1)]
    if not all(one.exists() for one in parts):
        print(f"{part.name} is written; it is joined when all {shards} parts are there")
        return
    runs = [one for path in parts for one in msgspec.json.decode(path.read_bytes(), type=list[Run])]
    runs.sort(key=lambda one: one.n)
    assert [one.n for one in runs] == list(range(len(runs))), f"parts of different --runs: {', '.join(map(str, parts))}"
    _report(runs, kept=True)
    for path in parts:
        path.unlink()


def _report(found: list[Run], *, kept: bool) -> None:
    stuck = [one for one in found if not one.moved]
    leads = [1e3 * one.lead_rad for one in found]
    counts = [_sentences(one) for one in found if one.moved]
    kinds = Counter(one.stop for one in found)
    rows = [
        ("stops", f"{len(found)}, {sum(one.laden for one in found)} with something in the hand"),
        ("by reason", ", ".join(f"{count} {reason}" for reason, count in kinds.most_common())),
        ("by start", json.dumps(Counter(one.drawn.start for one in found))),
        ("stuck", f"{len(stuck)}: runs {[one.n for one in stuck]}"),
        ("sentences until it moved", f"{dict(sorted(Counter(counts).items()))}"),
        ("command ahead of the joints 0.3 s after the stop", f"p50 {percentile(leads, 50):.2g}, {max(leads):.2g} mrad"),
    ]
    metrics: dict[str, float | None] = {
        "runs": float(len(found)),
        "stuck": float(len(stuck)),
        "first_sentence": float(counts.count(1)),
        "laden": float(sum(one.laden for one in found)),
        "lead_mrad_p50": percentile(leads, 50),
        "lead_mrad": max(leads),
    }
    numbered_runs.report("stops", metrics, rows, kept=kept)


if __name__ == "__main__":
    main()
