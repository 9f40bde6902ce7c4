"""Can a stream of an operator move an arm where F or its grant does not allow it?

Both exact arms with the real F of three sentences: GIVE, a step VIA OPERATOR-INTERVENTION, MAINTAIN SHARED. The grants
are drawn: a ball, fingers, axes shared with the program, speeds. Up to three hands send to both arms, at 5 to 1000
messages per second: in bursts and with gaps, with numbers that are not finite or huge, of earlier and of foreign
grants, late or from the future, the deadman pressed and released; they are bytes on their way, as on the wire. Pauses,
halts, DONE and CANNOT come between. A judge with rules of its own looks at each tick:

stream     a message counts exactly if the rules say so; the arm moves only up to 100 ms after one with the deadman
           (50 ms after it is let go), and never without a grant
grant      speeds, ball, fingers and spindle are within the grant
F          no body is touched, joints and their speeds are within limits
end        one end report at most; then no message counts

    python -m tests.campaigns.operator_streams [--runs 10000] [--only 17]
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import Any

import msgspec
import numpy as np

from benchmarks.report import question
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol import wire
from rtc.protocol.outcomes import WireError
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import TICK_S, CellState
from rtc.subsystems.motion.profiles import STOP_ACCELERATION_RAD_S2
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.period import period
from tests.campaigns import numbered_runs
from tests.workers.conftest import MODEL
from tests.workers.one_process import OneProcess

SEED = 23
TICKS = 300  # of the stream of one run
AFTER = 110  # ticks without messages, in which the arms come to rest
REST_S, RELEASED_S, STALE_S = 0.1, 0.05, 0.2  # what is promised
OVER = 1.1  # factor on speeds: the Jacobian follows the posture every fifth tick
SENTENCES = {
    "give": "GIVE {arm} TO OPERATOR",
    "step": "GRASP {module} {handle} WITH {arm} VIA OPERATOR-INTERVENTION",
    "shared": "MOVE {arm} TO CLEAR-POINT-1 MAINTAIN SHARED WRIST",
}
THINGS = {"RIGHT-ARM": ("MACS-NEW", "HANDLE-A"), "LEFT-ARM": ("MACS-OLD", "HANDLE-B")}
SHARES = ([3, 4, 5], [0, 1, 2], [0], [2], [5], [0, 1, 2, 3, 4, 5])
HAND_M_S = 1000.0  # m/s, rad/s: a twist beyond it is of no hand and does not count
NUMBERS = (math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300, 5.0, -0.0)
FREE_M = 0.007  # of a start: F stops at 5 mm
HANDS = (b"ada", b"bob", b"eve")

_read = wire.reader(m.Operate)


@cache
def primitives() -> dict[tuple[str, str], p.Primitive]:
    """The primitive of a request, by kind of sentence and arm: with the F that the binder gives it."""
    found = {}
    for kind, words in SENTENCES.items():
        for arm, (module, handle) in THINGS.items():
            rtc = OneProcess(KinematicCell(MODEL.cell))
            rtc.give(words.format(arm=arm, module=module, handle=handle))
            while rtc.mcm.executors[arm].operated is None:
                rtc.tick()
            found[kind, arm] = rtc.mcm.executors[arm].primitive
    return found


class Judge:
    """What one arm may do now. `grant`: None after its end."""

    def __init__(self, bench: Bench, arm: str) -> None:
        self.bench, self.arm, self.executor = bench, arm, bench.mcm.executors[arm]
        self.grant: p.Primitive | None = None
        self.until_s = -math.inf  # it may move
        self.holder, self.held_at_s = b"", -math.inf
        self.ends = 0
        self.ending_until_s = -math.inf  # its stop functions brake it, and take a pressure away
        traits = self.executor.arm.traits
        self._limits = list(zip(traits.lower, traits.upper, traits.velocity, strict=True))
        self._hand = self.executor.hand
        self._speeds = [0.0] * len(self._limits)
        self._tcp = self._place()
        self._reach_m = math.inf

    def begin(self, primitive: p.Primitive) -> None:
        self.grant = primitive
        if self.motion.centre:
            self._reach_m = max(self.motion.radius_m, math.dist(self._place(), self.motion.centre))

    @property
    def motion(self) -> p.TeleopMotion:
        assert self.grant is not None
        assert isinstance(self.grant.trajectory, p.TeleopMotion)
        return self.grant.trajectory

    def may_count(self, wanted: m.Operate, caller: bytes, now_s: float) -> bool:
        """Whether a message must count."""
        if self.grant is None or wanted.primitive != self.grant.id or self.executor.trip is not None:
            return False
        numbers = (*wanted.twist, wanted.turn, wanted.seen_at_s)
        age_s = now_s - wanted.seen_at_s
        granted = (self.motion.hand or not wanted.hand) and (self.motion.spindle or not wanted.turn)
        another = self.holder not in (b"", caller) and now_s - self.held_at_s <= STALE_S
        of_a_hand = all(abs(part) <= HAND_M_S for part in wanted.twist)
        recent = of_a_hand and all(map(math.isfinite, numbers)) and -TICK_S <= age_s <= STALE_S
        return recent and granted and not another and not (wanted.hold and self.executor.paused)

    def counted(self, wanted: m.Operate, caller: bytes, now_s: float) -> None:
        self.held_at_s = now_s
        if wanted.hold:
            self.holder, self.until_s = caller, now_s + REST_S
        else:
            self.holder, self.until_s = b"", min(self.until_s, now_s + RELEASED_S)

    def ended(self, report: m.EndReport, now_s: float) -> None:
        self.ends += 1
        self.bench.found[report.reason.value] += 1
        self.grant, self.holder = None, b""

    def look(self, now_s: float) -> Iterator[str]:
        """What is wrong in this tick."""
        joints, speeds, _ = self.executor.command
        moves = any(speeds)
        before, self._speeds = self._speeds, list(speeds)
        if self.executor.trip is not None:
            self.until_s = max(self.until_s, now_s + REST_S)  # it ends: a stop function, or a halt
        if moves and now_s > self.until_s + TICK_S:
            yield f"it moves {1e3 * (now_s - self.until_s):.0f} ms after it had to rest"
        most = 1.01 * STOP_ACCELERATION_RAD_S2 * TICK_S  # change of a speed
        for q, speed, earlier, (lower, upper, fastest) in zip(joints, speeds, before, self._limits, strict=True):
            if not (lower <= q <= upper and abs(speed) <= fastest and abs(speed - earlier) <= most):  # also no number
                yield f"a joint is beyond its limits: {q:.3g} rad, {speed:.3g} rad/s, {earlier:.3g} before"
        if self.grant is not None and self.motion.hand:
            self._hand = self.executor.hand
        elif self.executor.hand != self._hand:
            yield "the fingers move, which are not granted"
        if not moves:
            self._tcp = self._place()
        elif self.bench.ticks % 5 == 0:
            yield from self._look_at_tcp()

    def _look_at_tcp(self) -> Iterator[str]:
        before, self._tcp = self._tcp, self._place()
        # In a stop each joint brakes as hard as it may: then the tcp may be faster for some milliseconds.
        if self.grant is not None and self.motion.along is None and self.executor.trip is None:
            speed_m_s = math.dist(before, self._tcp) / (5 * TICK_S)
            if speed_m_s > OVER * self.motion.speed_m_s:
                yield f"the tcp moves at {speed_m_s:.3f} m/s; {self.motion.speed_m_s} are granted"
        if self.grant is not None and self.motion.centre:
            off_m = math.dist(self._tcp, self.motion.centre)
            if off_m > self._reach_m + 0.001:
                yield f"it is {1e3 * (off_m - self._reach_m):.1f} mm outside the neighbourhood"
        for one in self.executor.arm.near(0.001):
            about = self.grant is not None and self.grant.id in self.bench.steps
            about &= one.body.split()[0] == THINGS[self.arm][0]
            if one.distance_m <= 0.0 and not about:
                yield f"it touches: {one.link} {one.body}"

    def _place(self) -> Any:
        return self.executor.arm.tcp_pose(self.executor.command[0])[:3]


class Bench:
    """The arms at a drawn start, and the hands that send to them."""

    def __init__(self, sim: KinematicCell, start: CellState, rng: np.random.Generator, found: Counter[str]) -> None:
        self.sim, self.rng, self.found = sim, rng, found
        sim.restore(start)
        self.mcm = McmSubsystem(sim.arms, pid=1)
        self.ticks = 0
        self.wrong: list[str] = []
        self.steps: set[str] = set()  # grants of a GRASP: the hand may touch what it is about
        self.tick()
        self.judges = {arm: Judge(self, arm) for arm in sim.arms}

    @property
    def now_s(self) -> float:
        return 100.0 + self.ticks * TICK_S

    def run(self) -> list[str]:
        """What was wrong, with the number of the tick."""
        drawn = self.rng
        arms = [arm for arm in self.judges if drawn.random() < 0.75] or [next(iter(self.judges))]
        for number, arm in enumerate(arms):
            self._grant(arm, f"C-{number + 7}.1")
        hands = [self._hand(arms) for _ in range(drawn.choice([1, 1, 2, 3]))]
        for _ in range(TICKS):
            for hand in hands:
                for message, caller in next(hand):
                    self._send(message, caller)
            if drawn.random() < 0.004:
                self._interrupt(arms[drawn.integers(len(arms))])
            self.tick()
        for _ in range(AFTER):
            self.tick()
        return self.wrong

    def tick(self) -> None:
        self.ticks += 1
        for _, message in period(self.mcm.tick, self.sim, self.now_s):
            if isinstance(message, m.EndReport):
                judge = next(one for one in self.judges.values() if one.grant and one.grant.id == message.primitive)
                judge.ended(message, self.now_s)
        for judge in self.judges.values() if self.ticks > 1 else ():
            self.wrong += [f"tick {self.ticks}, {judge.arm}: {words}" for words in judge.look(self.now_s)]

    def _grant(self, arm: str, number: str) -> None:
        drawn, executor = self.rng, self.mcm.executors[arm]
        kind = str(drawn.choice(list(SENTENCES)))
        given = primitives()[kind, arm]
        motion = given.trajectory
        assert isinstance(motion, p.TeleopMotion)
        here = executor.arm.tcp_pose(executor.sample.joints)
        changed: dict[str, Any] = {"speed_m_s": float(drawn.choice([0.01, motion.speed_m_s]))}
        if kind == "shared":
            changed["along"] = self._path(executor.sample.joints)  # it draws first: runs keep their numbers
            changed["operator_axes"] = SHARES[drawn.integers(len(SHARES))]
        elif kind == "step":
            way = drawn.normal(size=3)
            away_m = drawn.choice([0.0, 0.02, 0.2])
            changed["centre"] = (here[:3] + away_m * way / np.linalg.norm(way)).tolist()
            changed["radius_m"] = float(drawn.choice([0.005, 0.03, 0.15]))
            if drawn.random() < 0.4:
                changed |= {"hand": True, "grip_n": 40.0}
        primitive = msgspec.structs.replace(given, id=number, trajectory=msgspec.structs.replace(motion, **changed))
        begun = executor.accept(primitive, self.now_s)
        if isinstance(begun[0], m.Started):
            self.found[kind] += 1
            self.steps |= {number} if kind == "step" else set()
            self.judges[arm].begin(primitive)
        else:  # a drawn path may leave the limits of a joint
            self.found["grant refused"] += 1

    def _path(self, start: Any) -> p.JointTrajectory:
        end = np.array(start) + self.rng.uniform(-0.1, 0.1, len(start))
        still = [[0.0] * len(start)] * 2
        duration_s = float(self.rng.uniform(0.6, 2.0))
        return p.JointTrajectory(
            space="joint",
            time_s=[0.0, duration_s],
            positions=[list(start), end.tolist()],
            velocities=still,
            accelerations=still,
        )

    def _hand(self, arms: list[str]) -> Iterator[list[tuple[m.Operate, bytes]]]:
        """The messages of one hand in each tick."""
        drawn = self.rng
        caller, arm = HANDS[drawn.integers(len(HANDS))], arms[drawn.integers(len(arms))]
        wild = drawn.choice([0.0, 0.02, 0.2])  # share of messages with something wrong
        due, period, hold, twist, frame = 0.0, 20.0, True, [0.0] * 6, "world"
        while True:
            if self.ticks < due:
                yield []
                continue
            if due == 0.0 or drawn.random() < 0.05:  # another intention
                size = float(drawn.choice([0.0, 0.02, 0.1, 0.1, 1.0, 10.0]))
                twist, frame = (size * drawn.normal(size=6)).tolist(), str(drawn.choice(["tool", "world"]))
                if drawn.random() < 0.4:  # ahead, where the object is
                    twist, frame = [0.0, 0.0, size, 0.0, 0.0, 0.0], "tool"
                period, hold = float(drawn.choice([1.0, 5.0, 20.0, 20.0, 50.0, 59.0])), bool(drawn.random() < 0.9)
            burst = 10 if drawn.random() < 0.02 else 1
            due = self.ticks + (drawn.uniform(60.0, 250.0) if drawn.random() < 0.03 else period)
            yield [(self._message(arm, twist, frame, hold, wild), caller) for _ in range(burst)]

    def _message(self, arm: str, twist: list[float], frame: str, hold: bool, wild: float) -> m.Operate:
        drawn, grant = self.rng, self.judges[arm].grant
        given: dict[str, Any] = {"primitive": grant.id if grant else "C-7.1", "seen_at_s": self.now_s - 0.02}
        given |= {"twist": list(twist), "hold": hold, "frame": frame}
        if grant is not None and self.judges[arm].motion.hand:
            given["hand"] = str(drawn.choice(["", "open", "close"]))
        if drawn.random() < wild:
            what = drawn.integers(6)
            if what == 0:
                given["twist"][drawn.integers(6)] = float(drawn.choice(NUMBERS))
            elif what == 1:
                given["primitive"] = str(drawn.choice(["C-6.1", "", "C-7.2", "C-8.1"]))
            elif what == 2:
                age_s = float(drawn.choice([0.19, 0.21, 1.0, -0.5, -1e9, math.nan, math.inf]))
                given["seen_at_s"] = self.now_s - age_s
            elif what == 3:
                given["hand"] = str(drawn.choice(["open", "close"]))
            elif what == 4:
                given["turn"] = float(drawn.choice([0.5, -1.0, math.nan, 3.0]))
            else:
                given["hold"] = not hold
        return m.Operate(operator="ADA", **given)

    def _send(self, message: m.Operate, caller: bytes) -> None:
        try:
            wanted = _read(wire.frames(message))
        except WireError:
            self.found["unreadable"] += 1
            return
        judge = next((one for one in self.judges.values() if one.grant and one.grant.id == wanted.primitive), None)
        must = judge is not None and judge.may_count(wanted, caller, self.now_s)
        counts = self.mcm.operate(wanted, caller, self.now_s).refused == ""
        self.found["counted" if counts else "refused"] += 1
        if counts and judge is not None:
            judge.counted(wanted, caller, self.now_s)
        if counts is not must and not (judge is not None and judge.executor.trip is not None):
            self.wrong.append(f"tick {self.ticks}: {wanted} {'counts' if counts else 'does not count'}")

    def _interrupt(self, arm: str) -> None:
        executor = self.mcm.executors[arm]
        if executor.operated is None:
            return
        match self.rng.integers(5):
            case 0:
                executor.halt()
            case 1 | 2:
                executor.pace(not executor.paused)
                if executor.paused:
                    self.judges[arm].until_s = min(self.judges[arm].until_s, self.now_s + RELEASED_S)
            case 3:
                executor.answer(m.OperatorAnswer(primitive=executor.primitive_id, done=True))
            case 4:
                executor.answer(m.OperatorAnswer(primitive=executor.primitive_id, done=False, why="no"))


def starts(sim: KinematicCell, rng: np.random.Generator) -> CellState:
    """Both arms near home, near a place or near what they would grasp; no body is nearer than FREE_M."""
    state = sim.state()
    while True:
        arms = {}
        for name, arm in state.arms.items():
            home = np.array(MODEL.cell.arm(name).home_rad)
            found = MODEL.arms[name].ik(_pose(name, rng), near=home.tolist())
            joints = np.array(found[0]) if found else home + rng.uniform(-0.15, 0.15, len(home))
            arms[name] = msgspec.structs.replace(arm, joints=joints.tolist())
        drawn = msgspec.structs.replace(state, arms=arms)
        sim.restore(drawn)
        inside = all(
            (np.array(arm.traits.lower) + 0.05 < arms[name].joints).all()
            and (np.array(arm.traits.upper) - 0.05 > arms[name].joints).all()
            for name, arm in sim.arms.items()
        )
        if inside and not any(arm.near(FREE_M) for arm in sim.arms.values()):
            return drawn


def _pose(arm: str, rng: np.random.Generator) -> geometry.Array:
    """Where the tcp of an arm begins."""
    offset = geometry.from_rpy(rng.uniform(-0.05, 0.05, 3), rng.uniform(-0.3, 0.3, 3))
    if rng.random() < 0.6:
        thing, handle = THINGS[arm]
        points = MODEL.cell.object(thing).grasp_points
        frame = next(one.frame.pose for one in points if one.name == handle)
        return geometry.compose(geometry.compose(MODEL.cell.object_pose(thing), frame), offset)
    places = [place.poses[arm] for place in MODEL.cell.places if arm in place.poses]
    return geometry.compose(places[rng.integers(len(places))].pose, offset)


@cache
def cell() -> tuple[KinematicCell, CellState]:
    sim = KinematicCell(MODEL.cell)
    return sim, sim.state()


def one_run(number: int, found: Counter[str]) -> list[str]:
    """What was wrong in the run of this number."""
    rng = np.random.default_rng([SEED, number])
    sim, begin = cell()
    sim.restore(begin)
    return Bench(sim, starts(sim, rng), rng, found).run()


def main() -> None:
    given = numbered_runs.arguments(__doc__, runs=10_000).parse_args()
    question("operator_streams", "Does a stream of an operator move an arm against F or its grant?", seed=SEED)
    found, runs, wrong = Counter[str](), 0, list[int]()
    for number, _ in numbered_runs.chosen(given, iter(range(1 << 30))):
        runs += 1
        if words := one_run(number, found):
            wrong.append(number)
            print(f"run {number}: {words[0]}; {len(words)} in all", flush=True)
        if runs % 500 == 0:
            print(f"{runs} runs, {len(wrong)} with a violation, {dict(found)}", flush=True)
    metrics: dict[str, float | None] = {"runs": runs, "violations": len(wrong), **dict(found)}
    rows = [
        ("runs", str(runs)),
        ("with a violation", str(len(wrong))),
        *((k, str(v)) for k, v in sorted(found.items())),
    ]
    numbered_runs.report("operator_streams", metrics, rows, kept=not given.only)


if __name__ == "__main__":
    main()
