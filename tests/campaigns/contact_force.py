"""With what force does a hand meet a body that is not where it is believed to be, and is a stated force kept?

A sentence moves the right arm of the simulated cell, in a straight line or to a place, at 1 to 20 cm/s. In its way
stands a body that is believed elsewhere: a rigid wall, a wall in front of a held module, a handle that a fingertip
meets from the front, or one that a finger meets from the side. Each clause that names a force, and none, is measured.
The force is that of the simulator's contact points, summed as vectors per body, not the reading of the wrist sensor.

    python -m tests.campaigns.contact_force [--processes 2] [--speeds 1 20] [--bodies wall] [--clauses GUARDED]
"""

from __future__ import annotations

import argparse
import multiprocessing
from typing import NamedTuple

import numpy as np
import pybullet

from benchmarks.report import finish, question
from rtc.spatial.geometry import Array
from rtc.wording.advice import in_one_line
from tests.campaigns import RESULTS
from tests.workers.conftest import Bench, Physical

ARM = "RIGHT-ARM"
SPEEDS_CM_S = (1.0, 2.0, 5.0, 10.0, 20.0)
TIP_M, FINGER_M, OUTSIDE_M = 0.015, 0.045, 0.050  # of the open hand: tip beyond the tcp; finger's middle, its outside
MAX_RATIO = 1.5  # times the promised force
BAR_M = 0.010  # half the thickness of a handle
BODY_B, ON_A, NORMAL, FORCE, ACROSS = 2, 5, 7, 9, ((10, 11), (12, 13))  # fields of a contact point


class Clause(NamedTuple):
    words: str
    promised_n: float | None = None  # the force that it promises


FREE = "free way, "  # clauses after a relative step that is not straight: no touch is expected
CLAUSES = {
    "no clause": Clause("MAINTAIN {speed}"),
    "GUARDED": Clause("MAINTAIN {speed} GUARDED", 40.0),
    "FORCE-LIMIT 10 N": Clause("MAINTAIN {speed} AND FORCE-LIMIT 10 N", 10.0),
    "UNLESS FORCE EXCEEDS 5 N THEN STOP": Clause("MAINTAIN {speed} UNLESS FORCE EXCEEDS 5 N THEN STOP", 5.0),
    "UNLESS FORCE EXCEEDS 20 N THEN STOP": Clause("MAINTAIN {speed} UNLESS FORCE EXCEEDS 20 N THEN STOP", 20.0),
    "UNLESS FORCE EXCEEDS 10 N THEN COMPLY": Clause("MAINTAIN {speed} UNLESS FORCE EXCEEDS 10 N THEN COMPLY", 10.0),
    "STIFFNESS 200 N/M": Clause("MAINTAIN {speed} AND STIFFNESS 200 N/M", 45.0),
    "STIFFNESS 1000 N/M": Clause("MAINTAIN {speed} AND STIFFNESS 1000 N/M", 45.0),
    "STIFFNESS 200 N/M AND FORCE-LIMIT 10 N": Clause(
        "MAINTAIN {speed} AND STIFFNESS 200 N/M AND FORCE-LIMIT 10 N", 10.0
    ),
    f"{FREE}GUARDED": Clause("JOINT-MOTION MAINTAIN {speed} GUARDED"),
    f"{FREE}FORCE-LIMIT 10 N": Clause("JOINT-MOTION MAINTAIN {speed} AND FORCE-LIMIT 10 N"),
}
SOME = ("no clause", "GUARDED", "FORCE-LIMIT 10 N", "UNLESS FORCE EXCEEDS 20 N THEN STOP", "STIFFNESS 200 N/M")
#: what stands in the way, and the clauses measured on it
BODIES = {
    "wall": tuple(CLAUSES),
    "wall before a held module": SOME,
    "handle before a fingertip": SOME,
    "handle beside a finger": SOME,
}


class Touch(NamedTuple):
    peak_n: float  # force on the body in the way
    wrist_n: float  # greatest reading of the wrist sensor
    speed_m_s: float  # of the tcp before the touch
    reason: str
    message: str


class Scene:
    """The arm before a body, and the line that leads into it."""

    def __init__(self, body: str, gap_m: float) -> None:
        self.subsystem = Physical()
        self.bench = Bench(self.subsystem)
        self.sim = self.subsystem.sim
        self.body, self.held = body, ""
        self.line = f"MOVE {ARM} BY {100 * gap_m + 2:.3g} CM ALONG FORWARD"
        if body == "wall":
            self.do(f"MOVE {ARM} BY 15 CM ALONG DOWN")
            self._displace("SATELLITE", (self.tcp[0] + TIP_M + gap_m - 0.75, 0.0, 0.0))
        elif body == "wall before a held module":
            self.held = "MACS-NEW"
            self.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
            self.do("LIFT MACS-NEW BY 25 CM WITH RIGHT-ARM")
            front_m = float(self.sim.world.pose(self.held)[0]) + 0.10
            self._displace("SATELLITE", (front_m + gap_m - 0.75, -0.45, 0.0))
        else:
            self.do(f"MOVE {ARM} TO-NEIGHBORHOOD-OF MACS-NEW")
            self.do(f"MOVE {ARM} BY 20 CM ALONG LEFT")
            before = (
                (TIP_M + gap_m + BAR_M, FINGER_M)
                if body == "handle before a fingertip"
                else (0.0, -OUTSIDE_M - BAR_M - gap_m)
            )
            # the left handle of the module is 0.15 m before its middle and 0.085 m to the left
            bar = self.sim.world.pose("MACS-NEW")[:3] + np.array((-0.15, 0.085, 0.0))
            self._displace("MACS-NEW", (*(self.tcp[:2] + np.array(before) - bar[:2]), 0.0))
            if body == "handle beside a finger":
                self.line = f"MOVE {ARM} BY {100 * gap_m + 2:.3g} CM ALONG RIGHT"

    @property
    def tcp(self) -> Array:
        arm = self.sim.arms[ARM]
        return arm.tcp_pose(arm.read().joints)

    def do(self, sentence: str) -> None:
        run = self.bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)

    def _displace(self, name: str, by: tuple[float, ...]) -> None:
        assert not self.sim.displace(name, [*map(float, by), 0.0, 0.0, 0.0])

    def touch(self, sentence: str) -> Touch | str:
        """What the sentence meets; the refusal, if it is refused."""
        arm, felt_n, places = self.sim.arms[ARM], [0.0], [self.tcp[:3]]

        def watch(_: int) -> None:
            felt_n.append(contact_force_n(self.subsystem, self.held))
            if max(felt_n) == 0.0:
                places.append(arm.tcp_pose(arm._sample.joints)[:3])

        self.subsystem.disturb = watch
        run = self.bench.do(sentence)
        self.subsystem.disturb = None
        if run.refusal is not None:
            return f"refused: {run.refusal.message}; {in_one_line(run.refusal.clears)}"
        report = run.reports[-1]
        speed = float(np.linalg.norm(places[-1] - places[-11])) / 0.010 if len(places) > 11 else 0.0
        return Touch(max(felt_n), report.peak_force_n, speed, report.reason.value, run.assessments[-1].message)

    def close(self) -> None:
        self.subsystem.close()


def contact_force_n(subsystem: Physical, held: str, arm: str = ARM) -> float:
    """The greatest force that a body receives from the arm, or from what it holds, in the latest step (N)."""
    sim = subsystem.sim
    client = sim.world.client
    own = {sim.arms[arm].body, *([sim.world.objects[held].id] if held else [])}
    forces: dict[int, Array] = {}
    for body in own:
        for point in pybullet.getContactPoints(bodyA=body, physicsClientId=client) or ():
            if point[BODY_B] in own:
                continue
            force = point[FORCE] * np.array(point[NORMAL])
            for size, direction in ACROSS:
                force = force + point[size] * np.array(point[direction])
            forces[point[BODY_B]] = forces.get(point[BODY_B], np.zeros(3)) + force
    return max((float(np.linalg.norm(force)) for force in forces.values()), default=0.0)


PROMISED_M_S = 0.05  # a broken promise is seen at this speed, so a slowed hand need not come from farther away


def gap_m(speed_m_s: float) -> float:
    """The way on which an arm reaches its speed at 1 m/s^2, with both ramps, and 5 mm more."""
    return 0.005 + 0.5 * speed_m_s**2 + 0.1 * speed_m_s


def measured(case: tuple[str, str, float]) -> Touch | str:
    body, name, speed_cm_s = case
    return meet(body, CLAUSES[name], speed_cm_s)


def meet(body: str, clause: Clause, speed_cm_s: float) -> Touch | str:
    speed_m_s = 0.01 * speed_cm_s
    scene = Scene(body, gap_m(speed_m_s if clause.promised_n is None else min(speed_m_s, PROMISED_M_S)))
    try:
        return scene.touch(f"{scene.line} {clause.words.format(speed=f'SPEED {speed_cm_s:g} CM/S')}")
    finally:
        scene.close()


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--speeds", type=float, nargs="+", default=SPEEDS_CM_S, help="cm/s")
    words.add_argument("--bodies", nargs="+", default=list(BODIES), choices=list(BODIES))
    words.add_argument("--clauses", nargs="+", default=list(CLAUSES), choices=list(CLAUSES))
    words.add_argument("--processes", type=int, default=2)
    given = words.parse_args()
    whole = set(given.bodies) == set(BODIES) and set(given.clauses) == set(CLAUSES) and given.speeds == SPEEDS_CM_S
    question("contact_force", "with what force does a hand meet a body, and is a promised force kept?")
    rows: list[tuple[str, str]] = []
    ratios: list[float] = []
    bare_n: list[float] = []
    pairs = [(body, name) for body in given.bodies for name in BODIES[body] if name in given.clauses]
    cases = [(body, name, speed) for body, name in pairs for speed in given.speeds]
    with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
        touches = pool.imap(measured, cases)
        for body, name in pairs:
            promised_n = CLAUSES[name].promised_n
            met = [(speed, next(touches)) for speed in given.speeds]
            shown = "; ".join(f"{speed:g} cm/s: {in_words(touch)}" for speed, touch in met)
            rows.append((f"{body}, {name}", shown))
            print(f"  {rows[-1][0]}: {rows[-1][1]}", flush=True)
            peaks_n = [touch.peak_n for _, touch in met if isinstance(touch, Touch)]
            ratios += [peak_n / promised_n for peak_n in peaks_n] if promised_n else []
            bare_n += peaks_n if not promised_n else []
    kept = sum(ratio <= MAX_RATIO for ratio in ratios)
    rows.append(
        ("promised", f"{kept} of {len(ratios)} within {MAX_RATIO:g} times it, worst {max(ratios, default=0.0):.2f}")
    )
    metrics: dict[str, float | None] = {
        "promised": float(len(ratios)),
        "kept": float(kept),
        "worst_ratio": max(ratios, default=None),
        "worst_collision_n": max(bare_n, default=None),
    }
    if whole:
        finish("contact_force", metrics, rows, RESULTS)
    else:
        print(rows[-1])


def in_words(touch: Touch | str) -> str:
    if isinstance(touch, str):
        return touch
    return f"{touch.peak_n:.3g} N at {1e3 * touch.speed_m_s:.3g} mm/s ({touch.reason})"


if __name__ == "__main__":
    main()
