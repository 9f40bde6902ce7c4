"""The mass of the fingers of a parallel hand, and how much of it their motors feel. Pure.

Both motors pull at fingers that an arm carries. If both push to the same side, the arm gives way, and a finger feels
lighter than it is. The servos of a hand and of an arm are chosen by both figures.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import ProgramError

SEED, POSTURES = 1, 20  # in which the mass that is felt is computed

# A lighter finger gets so soft a spring that a grip of 60 N needs longer than two seconds (`sim_mcm.arms.hand`).
MIN_KG = 0.005
# The servo of the arm counts the fingers as fixed to the hand. It is unstable if the hand without them weighs less than
# a seventh of what it expects (2 * 150 rad/s * 1 ms * 7 > 2); half of that is left for the load.
MAX_LIGHTER = 4.0


class FingerMass(NamedTuple):
    own_kg: float  # of the lighter finger
    felt_kg: float  # by its motor if both push to the same side; the least of some postures

    @property
    def problem(self) -> str:
        """Why no servo holds this hand still; empty if one does."""
        if self.own_kg < MIN_KG:
            return (
                f"a finger of {1e3 * self.own_kg:.3g} g is too light for a servo of 1 kHz; "
                f"expected: {1e3 * MIN_KG:g} g or more, with what the motor of the finger moves"
            )
        if self.own_kg > MAX_LIGHTER * self.felt_kg:
            return (
                f"a finger of {self.own_kg:.3g} kg is too heavy for the hand and the arm that carry it: they would "
                "shake; expected: lighter fingers, or a heavier hand"
            )
        return ""


def problems(cell: Cell) -> Iterator[tuple[str, str]]:
    """(place in the cell, problem) for each hand that no servo would hold still."""
    for n, arm in enumerate(cell.arms):
        for hand in ("", *(hand.name for hand in arm.hands)):
            if problem := finger_mass(cell.with_hands({arm.name: hand}) if hand else cell, arm.name).problem:
                yield f"arms[{n}].gripper.finger_links", f"{arm.with_hand(hand).urdf}: {problem}"


def require_stable(cell: Cell) -> Cell:
    """The cell. Raises ProgramError if no servo would hold one of its hands still."""
    for place, problem in problems(cell):
        raise ProgramError(f"{cell.name}: $.{place}: {problem}")
    return cell


def finger_mass(cell: Cell, arm: str) -> FingerMass:
    """The figures of the hand of an arm."""
    spec = cell.arm(arm)
    model = pin.buildModelFromXML(cell.urdf(arm))
    data = model.createData()
    moving = [model.idx_vs[model.getJointId(name)] for name in (*spec.joints, *spec.gripper.finger_joints)]
    aside = np.zeros(len(moving))
    aside[-2:] = 1.0, -1.0
    own, felt = np.inf, np.inf
    drawn = np.random.default_rng(SEED).uniform(
        model.lowerPositionLimit, model.upperPositionLimit, (POSTURES, model.nq)
    )
    for q in drawn:
        upper = np.triu(pin.crba(model, data, q))
        mass = (upper + np.triu(upper, 1).T)[np.ix_(moving, moving)]
        own = min(own, float(mass[-2, -2]), float(mass[-1, -1]))
        compliance = float(np.linalg.lstsq(mass, aside, rcond=None)[0] @ aside)
        felt = min(felt, 2.0 / compliance if compliance > 0.0 else 0.0)
    return FingerMass(own, felt)
