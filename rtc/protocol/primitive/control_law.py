"""M of a primitive: how the servo follows P, with the load in the hand and the figures of a compliant arm."""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from rtc.protocol.primitive.limits import FARTHEST_M, HEAVIEST_KG, MAX_INERTIA_KG_M2, MAX_S, Vector
from rtc.protocol.strict import Strict


class Load(Strict, frozen=True, kw_only=True):
    """The load in the hand as a rigid body, in tcp axes."""

    mass_kg: float
    com_m: Vector  # centre of mass
    inertia_kg_m2: Vector  # about the centre of mass: xx, yy, zz, xy, xz, yz

    def __post_init__(self) -> None:
        if len(self.com_m) != 3 or len(self.inertia_kg_m2) != 6:
            raise ValueError("a load has a centre of mass of 3 numbers and an inertia of 6")
        if not 0.0 < self.mass_kg <= HEAVIEST_KG:  # false for nan too
            raise ValueError(f"a load of {self.mass_kg} kg: more than 0 and at most {HEAVIEST_KG:g} kg is possible")
        if not all(abs(x) <= FARTHEST_M for x in self.com_m):
            raise ValueError(f"a load has its centre of mass within {FARTHEST_M:g} m of the tcp, not at {self.com_m}")
        xx, yy, zz, xy, xz, yz = self.inertia_kg_m2
        if not all(0.0 <= i <= MAX_INERTIA_KG_M2 for i in (xx, yy, zz)):
            raise ValueError(f"a load has an inertia of 0 to {MAX_INERTIA_KG_M2:g} kg m2 about each axis")
        if not (xy * xy <= 1.001 * xx * yy and xz * xz <= 1.001 * xx * zz and yz * yz <= 1.001 * yy * zz):
            raise ValueError("a load has no inertia whose products exceed its moments")


class ForceProfile(Strict, frozen=True, kw_only=True):
    """Force set-points over time: `share[k]` of each at `time_s[k]` since the start of the primitive.

    Linear in between; the last share is kept.
    """

    time_s: Vector
    share: Vector

    def __post_init__(self) -> None:
        if len(self.time_s) < 2 or len(self.time_s) != len(self.share) or self.time_s[0] != 0.0:
            raise ValueError("a force profile needs two times or more, the first 0, and as many shares")
        if not all(a < b <= MAX_S for a, b in zip(self.time_s, self.time_s[1:], strict=False)):  # false for nan too
            raise ValueError("the times of a force profile must rise")
        if not all(0.0 <= share <= 1.0 for share in self.share):
            raise ValueError("a share of a force set-point is 0 to 1")


class Compliance(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """Figures of a compliant control law, along x y z and about x y z of the selection frame."""

    stiffness: Vector  # N/m three times, N.m/rad three times
    damping: Vector = msgspec.field(default_factory=lambda: [1.0] * 6)  # ratio to critical damping
    frame: Literal["tool", "world"] = "tool"  # axes of the selection frame
    centre: Vector = []  # centre of compliance, origin of the selection frame (m, tool axes); empty: the tcp
    # Force set-points: what the hand exerts on its environment (N, N.m). An axis with a number is force-controlled and
    # has no spring; None leaves it to the spring. Empty: no axis is force-controlled.
    wrench: list[float | None] = []
    profile: ForceProfile | None = None  # of these set-points; None: constant
    approach_m_s: float = 0.005  # at most, of a force-controlled axis that nothing resists
    most_n: float | None = None  # greatest pull of the spring; None: unlimited
    most_nm: float | None = None
    # Comply until the arm rests: another arm holds the same object and stops too. False: until the primitive ends.
    until_rest: bool = False

    def __post_init__(self) -> None:
        for name, figures in (("stiffness", self.stiffness), ("damping", self.damping)):
            if len(figures) != 6:
                raise ValueError(f"{name} has 6 figures, not {len(figures)}")
        if not all(0.0 <= k < math.inf for k in self.stiffness):  # false for nan too
            raise ValueError(f"a stiffness is 0 or more, not {min(self.stiffness):g}")
        if not all(0.1 <= ratio <= 3.0 for ratio in self.damping):
            raise ValueError("a damping ratio is 0.1 to 3")
        if len(self.centre) not in (0, 3) or not all(abs(x) <= FARTHEST_M for x in self.centre):  # false for nan too
            raise ValueError(f"a centre of compliance has 3 figures of at most {FARTHEST_M:g} m")
        if len(self.wrench) not in (0, 6):
            raise ValueError(f"a wrench has 6 figures, not {len(self.wrench)}")
        if self.profile is not None and not any(self.wrench):
            raise ValueError("a force profile needs a force set-point")
        if not all(force is None or math.isfinite(force) for force in self.wrench):
            raise ValueError("a force set-point is not a finite number")
        for name, most in (("most_n", self.most_n), ("most_nm", self.most_nm), ("approach_m_s", self.approach_m_s)):
            if most is not None and not 0.0 < most < math.inf:
                raise ValueError(f"{name} must be above 0, not {most}")


class ControlLaw(Strict, frozen=True, kw_only=True, omit_defaults=True):
    """M: the registered name of a control law and its gains.

    `position`: computed torque. `impedance`: a spring and damper at the tcp, with the figures in `compliance`. Its
    gains are those of `position`, which holds the arm before and after. `load`: the body in the hand; without it the
    control law would let the arm swing.
    """

    name: str = "position"
    gains: dict[str, float] = {}
    load: Load | None = None
    compliance: Compliance | None = None
