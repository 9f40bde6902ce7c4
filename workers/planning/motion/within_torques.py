"""The pace along a curve within joint torques too, by toppra, from the same limits on the same grid as `pace`. Pure.

Few motions need it, and toppra takes 0.6 s of processor time to import: so only they import this module. toppra also
imports matplotlib.pyplot for its plotting methods, which takes another 0.4 s. We do not plot: an empty module replaces
matplotlib during the import and is removed afterwards.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from functools import cache
from types import ModuleType

import numpy as np

from rtc.spatial.geometry import Array
from workers.planning.motion.blended import Blended
from workers.planning.motion.path import Path
from workers.planning.motion.torques import Torques


@contextlib.contextmanager
def _no_plots() -> Iterator[None]:
    if "matplotlib" in sys.modules:
        yield
        return
    package, pyplot = ModuleType("matplotlib"), ModuleType("matplotlib.pyplot")
    package.pyplot = pyplot  # type: ignore[attr-defined]
    stand_ins = {"matplotlib": package, "matplotlib.pyplot": pyplot}
    sys.modules.update(stand_ins)
    try:
        yield
    finally:
        for name in stand_ins:
            del sys.modules[name]


with _no_plots():
    import toppra
    import toppra.algorithm
    import toppra.constraint

# toppra looks for further solvers on the disk for each path.
toppra.solverwrapper.available_solvers = cache(toppra.solverwrapper.available_solvers)


def fastest_within(torques: Torques, path: Path, grid: Array, most: Array, acceleration: Array) -> Array:
    """The greatest pace at each point of the grid (1/s), at rest at both ends. `most`: the greatest pace there, [grid].
    `acceleration`: of the joints (rad/s^2)."""
    whole = path.curve if isinstance(path.curve, Blended) else toppra.SplineInterpolator(path.s, path.knots)
    constraints = [_MostPace(most), _MostAccelerations(acceleration), _within(torques)]
    solver = toppra.algorithm.TOPPRA(constraints, whole, gridpoints=grid)
    found: Array | None = solver.compute_parameterization(0.0, 0.0)[1]
    assert found is not None, "a rest-to-rest profile always exists at a low speed"
    return found


def _within(torques: Torques) -> toppra.constraint.Constraint:
    def inverse_dynamics(q: Array, v: Array, a: Array) -> Array:
        return torques.arm.torques(q[None], v[None], a[None], torques.laden)[0]

    return toppra.constraint.SecondOrderConstraint.joint_torque_constraint(
        inverse_dynamics,
        np.stack((-torques.limits, torques.limits), axis=1),
        np.zeros(len(torques.limits)),
        discretization_scheme=toppra.constraint.DiscretizationType.Interpolation,
    )


class _MostPace(toppra.constraint.LinearConstraint):  # type: ignore[misc]
    """The greatest pace at each grid point, [grid]."""

    def __init__(self, most: Array) -> None:
        super().__init__()
        self.dof, self._most = 1, most

    def compute_constraint_params(self, path: Blended, gridpoints: Array) -> tuple[Array | None, ...]:
        """Bounds of the squared pace."""
        return *[None] * 6, np.stack((np.zeros(len(self._most)), self._most**2), axis=1)


class _MostAccelerations(toppra.constraint.JointAccelerationConstraint):  # type: ignore[misc]
    """As its base, whose constructor takes most of its time to put the limits (rad/s^2) in words."""

    def __init__(self, most: Array) -> None:
        toppra.constraint.LinearConstraint.__init__(self)
        self.dof, self.alim, self.identical = len(most), np.stack((-most, most), axis=1), True
        self.set_discretization_type(toppra.constraint.DiscretizationType.Interpolation)
