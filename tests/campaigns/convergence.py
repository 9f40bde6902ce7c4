"""Does what a hand holds move the same, and does the wrist feel the same, if the physics is solved with more effort?

A contact solver that has not converged lets a held body creep, always the same way, until the catch of a seat does not
take it. So each chain GRASP, LIFT, PLACE is repeated with half the time step, with twice the iterations, and without a
residual at which the solver ends early; the control stays at 1 kHz. Each figure that a threshold judges may change by
less than a tenth of the room that it leaves to that threshold:

- how far the object has turned and slipped in the hand, from the closed grasp to the opening: the catch of a seat;
- the peak of the wrist force of each step: the force limit of the step.

    python -m tests.campaigns.convergence [--data FOLDER] [--only IIWA swapout] [--processes 2]

`--data`: where the packages of `tests.campaigns.urdfs` are; without it there is no UR5. A short version is in
`tests/apps/authoring/test_convergence.py`.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pybullet

from benchmarks.copies import in_copies
from benchmarks.report import question
from rtc.apps.authoring.draft import draft
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import BoundStep, EndReport
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import ForceAbove, HandMotion, Primitive
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.world.model import World, initial_facts
from sim_mcm.arms import bullet_world
from sim_mcm.arms.detents import CATCHES_M, CATCHES_RAD
from tests.apps.authoring import small_arms
from tests.apps.authoring.conftest import ARMS, written
from tests.campaigns.numbered_runs import report
from tests.campaigns.urdfs import MODELS
from tests.workers.conftest import Bench, Physical
from workers.planning.robot_models import CellModel

SHARE = 0.1  # of the room to a threshold
OWN = {"swapout", "servicing", "halfway", "relay", "truss", "gantry", "panda"}  # cells that come with rtc
UR5 = f"{MODELS}/ur_robot_model/ur5_gripper.urdf"


class Chain(NamedTuple):
    """What is done in a cell. `cell`: the name of one that comes with rtc, else of an arm that gets its first cell."""

    cell: str
    arm: str
    thing: str
    grasp_point: str
    via: str  # how it is grasped
    lift_cm: int
    seat: str

    @property
    def sentences(self) -> tuple[str, str, str]:
        hand = self.arm if self.arm.endswith("-ARM") else f"ARM {self.arm}"
        return (
            f"GRASP {self.thing} {self.grasp_point} WITH {hand}{self.via}",
            f"LIFT {self.thing} BY {self.lift_cm} CM",
            f"PLACE {self.thing} ON {self.seat}",
        )


SIMPLE = " VIA SIMPLE"
CHAINS = {
    "swapout, right": Chain("swapout", "RIGHT-ARM", "MACS-NEW", "HANDLE-A", SIMPLE, 15, "RACK-1"),
    "swapout, left": Chain("swapout", "LEFT-ARM", "MACS-OLD", "HANDLE-B", SIMPLE, 15, "RACK-2"),
    "servicing": Chain("servicing", "RIGHT-ARM", "MACS-NEW", "HANDLE-A", SIMPLE, 15, "RACK-1"),
    "halfway": Chain("halfway", "LEFT-ARM", "MACS-OLD", "HANDLE-B", SIMPLE, 15, "RACK-2"),
    "relay": Chain("relay", "RIGHT-ARM", "BATTERY-NEW", "HANDLE", SIMPLE, 15, "RACK-1"),
    "truss": Chain("truss", "RIGHT-ARM", "STRUT-1", "HANDLE", SIMPLE, 15, "RACK-1"),
    "gantry": Chain("gantry", "GANTRY", "MACS-NEW", "HANDLE-A", SIMPLE, 15, "RACK-3"),
    "panda": Chain("panda", "PANDA", "CUBE-1", "TOP", SIMPLE, 10, "PAD-2"),
    "IIWA": Chain("IIWA", "IIWA", "CUBE", "TOP", "", 10, "PAD-2"),
    "PANDA": Chain("PANDA", "PANDA", "CUBE", "TOP", SIMPLE, 10, "PAD-2"),
    "XARM": Chain("XARM", "XARM", "CUBE", "TOP", SIMPLE, 10, "PAD-2"),
    "UR5": Chain("UR5", "UR5", "CUBE", "TOP", SIMPLE, 10, "PAD-2"),
    "FIVE": Chain("FIVE", "UNIT", "CUBE", "TOP", "", 5, "PAD-2"),
    "PORTAL": Chain("PORTAL", "UNIT", "CUBE", "TOP", SIMPLE, 5, "PAD-2"),
}


class Variant(NamedTuple):
    iterations: int = 1  # factor
    residual: float = 1.0  # factor
    steps: int = 1  # of physics, in a tick


AS_IT_IS = "as it is"
VARIANTS = {
    AS_IT_IS: Variant(),
    "half the step": Variant(steps=2),
    "twice the iterations": Variant(iterations=2),
    "residual 0": Variant(residual=0.0),
}


class Figures(NamedTuple):
    """Of one chain: what thresholds judge."""

    tilt_rad: float
    slip_m: float
    forces: dict[str, tuple[float, float]]  # step -> peak and limit (N)

    def shares(self, other: Figures) -> tuple[float, float, float]:
        """By how much the figures of another variant differ, as shares of the room: tilt, slip, force."""
        force = 0.0
        for label, (peak_n, limit_n) in self.forces.items():
            force = max(force, abs(other.forces[label][0] - peak_n) / max(limit_n - peak_n, 1e-9))
        return (
            abs(other.tilt_rad - self.tilt_rad) / max(CATCHES_RAD - self.tilt_rad, 1e-9),
            abs(other.slip_m - self.slip_m) / max(CATCHES_M - self.slip_m, 1e-9),
            force,
        )

    @property
    def nearest(self) -> tuple[float, float]:
        """Peak and limit of the step that is nearest to its limit."""
        return min(self.forces.values(), key=lambda one: one[1] - one[0])


class Solved(Physical):
    """Physics that is solved as a variant says. It changes this process: make it in a copy."""

    def __init__(self, cell: Cell, variant: Variant, chain: Chain) -> None:
        bullet_world.SOLVER_ITERATIONS *= variant.iterations
        bullet_world.SOLVER_RESIDUAL *= variant.residual
        # Before the world is built: the limits of catches are impulses per step.
        bullet_world.STEP_S /= variant.steps
        self._send, self._sent = pybullet.setJointMotorControlArray, dict[int, Any]()
        pybullet.setJointMotorControlArray = self._recorded
        super().__init__(cell)
        self._halve(variant.steps)
        self._arm, self._thing = chain.arm, chain.thing
        self._opened: Array | None = None
        self.forces: dict[str, tuple[float, float]] = {}

    def _recorded(self, *values: Any, **more: Any) -> None:
        if values:  # the torques of a tick
            self._sent[values[0]] = values
        self._send(*values, **more)

    def _halve(self, steps: int) -> None:
        """Take this many steps in a tick, with its torques. The wrist sensor states its mean: an impact ends in one
        step, whatever its length."""
        world, arms = self.sim.world, self.sim.arms  # type: ignore[attr-defined]
        step, readings = world.step, dict[str, list[Array]]()

        def read_all() -> None:
            for name, arm in arms.items():
                state = pybullet.getJointState(arm.body, arm._read_from[-1], world.client)
                readings.setdefault(name, []).append(np.array(state[2]))

        def whole() -> None:
            readings.clear()
            step()
            for _ in range(steps - 1):
                read_all()
                for values in self._sent.values():  # a torque acts for one step
                    self._send(*values)
                step()

        def mean(name: str, wrench: Callable[[Any], list[float]]) -> Callable[[Any], list[float]]:
            return lambda last: wrench(tuple(np.mean([*readings.get(name, ()), np.array(last)], axis=0).tolist()))

        if steps > 1:
            world.step = whole
            for name, arm in arms.items():
                arm._wrench = mean(name, arm._wrench)

    def perform(self, made: Primitive, bound: BoundStep) -> EndReport:
        if isinstance(made.trajectory, HandMotion) and made.trajectory.width_m > 0.0:
            self._opened = self.in_hand()
        found = super().perform(made, bound)
        limits = [
            stop.when.limit_n or math.inf
            for stop in made.stop_functions
            if isinstance(stop.when, ForceAbove) and stop.reason is StopReason.FORCE_LIMIT
        ]
        assert bound.evaluation is not None
        if limits:
            label = bound.evaluation.step.label
            peak_n, _ = self.forces.get(label, (0.0, 0.0))
            self.forces[label] = (max(peak_n, found.peak_force_n), min(limits))
        return found

    def in_hand(self) -> Array:
        """The object in the axes of the tcp."""
        truth = self.truth()
        return geometry.relative(truth["tcp"][self._arm], truth["poses"][self._thing])

    def figures(self, closed: Array) -> Figures:
        """`closed`: the object in the hand after the grasp."""
        now = self.in_hand() if self._opened is None else self._opened
        return Figures(geometry.angle(closed, now), geometry.distance(closed, now), self.forces)


def solved(cell: Cell, chain: Chain, variant: Variant, sentences: int = 3) -> Figures:
    """The figures of the first sentences of a chain. Raises RuntimeError if one of them fails. For a copy."""
    subsystem = Solved(cell, variant, chain)
    bench = Bench(subsystem, CellModel(cell))
    if chain.cell not in OWN:
        bench.world = World().overlay(initial_facts(cell))
    closed = None
    for sentence in chain.sentences[:sentences]:
        run = bench.do(sentence)
        if not run.succeeded:
            why = run.refusal.message if run.refusal else "; ".join(made.message for made in run.assessments)
            raise RuntimeError(f"{chain.cell}, {sentence}: {why}")
        if closed is None:
            closed, subsystem._opened = subsystem.in_hand(), None
    assert closed is not None
    return subsystem.figures(closed)


def compared(cell: Cell, chain: Chain, processes: int = 1, sentences: int = 3) -> dict[str, Figures]:
    """The figures of all variants."""

    def one(name: str) -> tuple[str, Figures]:
        return name, solved(cell, chain, VARIANTS[name], sentences)

    return dict(in_copies(one, VARIANTS, processes))


def cell_of(chain: Chain, data: Path | None, folder: Path) -> Cell | None:
    """The cell of a chain; None if its robot file is missing."""
    if chain.cell in OWN:
        return Cell.load(chain.cell)
    if chain.cell in ARMS:
        urdf, tip = ARMS[chain.cell]
    elif chain.cell == "UR5":
        if data is None:
            return None
        urdf, tip = data / UR5, ""
    else:
        urdf, tip = folder / "arm.urdf", ""
        urdf.write_text(small_arms.urdf("arm", getattr(small_arms, chain.cell)))
    return Cell.load(written(draft(urdf, chain.arm, tip), folder))


def table(name: str, found: dict[str, Figures]) -> list[tuple[str, str]]:
    """A row for each variant."""
    rows, base = [], found[AS_IT_IS]
    for variant in VARIANTS:
        one = found[variant]
        peak_n, limit_n = one.nearest
        changed = ", ".join(f"{100 * share:.2f} %" for share in base.shares(one)) if variant != AS_IT_IS else ""
        rows.append(
            (
                f"{name} | {variant}",
                f"{math.degrees(one.tilt_rad):.4f} deg | {1e3 * one.slip_m:.4f} mm | {peak_n:.2f} of {limit_n:.0f} N |"
                f" {limit_n - peak_n:.2f} N | {changed}",
            )
        )
    return rows


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--data", type=Path, help="folder with the packages; without it no UR5")
    words.add_argument("--only", nargs="+", help="these chains alone, without results file")
    words.add_argument("--processes", type=int, default=1)
    given = words.parse_args()
    question("convergence", "does more effort of the solver change what a threshold judges?")
    rows, worst, chains, within = [], {name: 0.0 for name in VARIANTS if name != AS_IT_IS}, 0, 0
    for name in given.only or CHAINS:
        with tempfile.TemporaryDirectory() as folder:
            cell = cell_of(CHAINS[name], given.data, Path(folder))
            if cell is None:
                continue
            found = compared(cell, CHAINS[name], given.processes)
        chains += 1
        for row in table(name, found):
            rows.append(row)
            print(*row, sep=" | ", flush=True)
        shares = {variant: max(found[AS_IT_IS].shares(found[variant])) for variant in worst}
        worst = {variant: max(share, shares[variant]) for variant, share in worst.items()}
        within += max(shares.values()) < SHARE
    metrics: dict[str, float | None] = {f"{name.replace(' ', '_')}_share": share for name, share in worst.items()}
    print(metrics, flush=True)
    report(
        "convergence",
        {"chains": float(chains), "within": float(within), **metrics},
        rows,
        kept=not given.only and given.data is not None,
    )


if __name__ == "__main__":
    main()
