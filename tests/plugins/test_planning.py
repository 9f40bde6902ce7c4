"""Planners, solvers, timings and grasp planners of installed packages: used where they are named, and never trusted."""

from __future__ import annotations

from contextlib import nullcontext

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rtc.model.cells.cell import Cell
from rtc.model.robot.kinematics import ArmModel
from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.programs.schema import Algorithms
from rtc.protocol.outcomes import ProgramError, Refused
from rtc.spatial.geometry import Array
from tests.plugins.toy_packages import Install
from tests.workers.planning.motion.test_plan import behind_a_wall, setting  # noqa: F401
from workers.planning.motion import ik, sampled_way, timings
from workers.planning.motion import path as paths
from workers.planning.motion.plan import plan_joint_motion
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import NO_SPEED_LIMITS, SpeedLimits, Timed

THROUGH = "def plan(request, goal):\n    return [request.start, 0.5 * (request.start + goal), goal]\n"


def without_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """rtc's own search finds nothing."""
    for name in ("SAMPLES", "ROOMY_SAMPLES"):
        monkeypatch.setattr(sampled_way, name, 0)


def asking(planner: str, case: tuple[PlanningRequest, Array]) -> tuple[PlanningRequest, Array]:
    """The case with this planner, and ours after it."""
    request, goal = case
    return replace(request, algorithms=Algorithms(planners=[planner, "own"])), goal


def test_a_colliding_path_of_a_planner_is_not_accepted(install, right, cell, setting, monkeypatch):  # noqa: F811
    """Its way leads straight through the wall; the search has no samples, so no way is found."""
    without_samples(monkeypatch)
    install(registry.PLANNERS, "straight", "plan", THROUGH)
    with pytest.raises(Refused) as refused:
        plan_joint_motion(*asking("straight", behind_a_wall(cell, right, setting)))
    assert refused.value.refusal.cause.body_b == "WALL slab"


def test_a_free_path_of_a_planner_is_used(install, right, cell, setting, monkeypatch):  # noqa: F811
    """It hands on what a search has found before, as corners."""
    request, goal = behind_a_wall(cell, right, setting)
    found = sampled_way.find_sampled_way(request, request, [goal], sampled_way.guides(request, goal))
    corners = [list(map(float, q)) for q in found.path.knots]
    without_samples(monkeypatch)
    install(registry.PLANNERS, "recalls", "plan", f"def plan(request, goal):\n    return {corners}\n")
    motion = plan_joint_motion(*asking("recalls", (request, goal)))
    assert motion.notes[-1].startswith("planner recalls: tested: free")


@pytest.mark.parametrize(
    "code",
    [
        "def plan(request, goal):\n    raise OSError('no licence')\n",
        "def plan(request, goal):\n    return [goal, goal]\n",
        "def plan(request, goal):\n    return [[0.0], [1.0]]\n",
        "def plan(request, goal):\n    return None\n",
        "def plan(request, goal):\n    return [request.start, goal + 1e300, goal]\n",
        "def plan(request, goal):\n    return [request.start, goal] * 4000\n",
        "def plan(request, goal):\n    request.joints[request.arm.name][:] = 0.0\n",
        "def plan(request, goal):\n    request.joints.clear()\n",
        "def plan(request, goal):\n    upper = request.arm.limits.upper\n    upper += 1.0\n",
        "def plan(request, goal):\n    request.arm.base_pose[:3] += 0.1\n",
    ],
)
def test_a_planner_that_gives_no_way_is_passed_over(install, right, cell, setting, code, monkeypatch):  # noqa: F811
    without_samples(monkeypatch)
    install(registry.PLANNERS, "poor", "plan", code)
    request, goal = behind_a_wall(cell, right, setting)
    given = [*map(list, request.joints.values()), right.limits.upper.tolist(), right.base_pose.tolist()]
    with pytest.raises(Refused) as refused:
        plan_joint_motion(*asking("poor", (request, goal)))
    assert refused.value.refusal.effort.samples == 0
    assert given == [*map(list, request.joints.values()), right.limits.upper.tolist(), right.base_pose.tolist()]


def test_a_posture_of_a_solver_counts_if_it_reaches_the_pose(install: Install, cell: Cell) -> None:
    """It returns one posture that reaches the target, and one that does not. Then ours is asked."""
    arm = ArmModel.of(cell, "RIGHT-ARM")
    q = np.array(cell.arm("RIGHT-ARM").home_rad)
    code = f"def solve(arm, target, near):\n    return [{q.tolist()}, {(q + 0.3).tolist()}]\n"
    install(registry.IK, "toy", "solve", code)
    found = ik.solutions(["toy"], arm, arm.fk(q), q)
    assert [one.tolist() for one in found.found] == [q.tolist()]
    other = arm.fk(q + 0.1)
    assert ik.solutions(["toy"], arm, other, q).found == []
    assert len(ik.solutions(["toy", "own"], arm, other, q).found) == len(arm.ik(other, q)) > 0


SLOW = """
from dataclasses import replace
import numpy as np
def time(arm, path, pace, load):
    from workers.planning.motion import timing
    own = timing.slowed(arm, timing._time_line(arm, path, pace))
    return {expression}
"""


def timed_by(name: str, setting: PlanningRequest, pace: SpeedLimits = NO_SPEED_LIMITS) -> Timed:  # noqa: F811
    """A line in joint space, timed by this timing alone."""
    request = replace(setting, pace=pace, algorithms=Algorithms(timing=[name]))
    return timings.time_path(request, paths.joint_line(setting.arm.middle, setting.arm.middle + 0.4))[0]


def test_a_timing_is_used_and_slowed_to_the_limits_of_the_arm(install: Install, setting) -> None:  # noqa: F811
    own = timed_by("own", setting, SpeedLimits(10.0, 100.0))
    install(registry.TIMING, "hasty", "time", SLOW.format(expression="timing.slower(own, 0.5)"))
    assert timed_by("hasty", setting, SpeedLimits(10.0, 100.0)).duration_s >= 0.99 * own.duration_s
    install(registry.TIMING, "calm", "time", SLOW.format(expression="timing.slower(own, 3.0)"))
    calm = timed_by("calm", setting, SpeedLimits(10.0, 100.0))
    assert calm.duration_s == pytest.approx(3 * own.duration_s, rel=0.01)


def test_a_timing_off_the_path_is_refused(install: Install, setting) -> None:  # noqa: F811
    bump = "np.outer(np.sin(np.pi * own.time_s / own.duration_s) ** 3, [0.3, 0, 0, 0, 0, 0])"
    bent = SLOW.format(expression=f"replace(own, positions=own.positions + {bump})")
    install(registry.TIMING, "bent", "time", bent)
    with pytest.raises(Refused):
        timed_by("bent", setting)


@pytest.mark.parametrize("expression", ["own.time_s * 1e-300", "own.time_s * 0.2"])
def test_a_timing_whose_velocities_hide_its_speed_is_refused(install: Install, setting, expression) -> None:  # noqa: F811
    """Its velocities are those of a slower motion: it leaps from knot to knot."""
    install(registry.TIMING, "hasty", "time", SLOW.format(expression=f"replace(own, time_s={expression})"))
    with pytest.raises((Refused, PluginError), match="timing hasty"):
        timed_by("hasty", setting, SpeedLimits())


GRASPS = """
def grasps(thing, cell):
    if thing.name != "MACS-OLD":
        return []
    return [{{"name": {name!r}, "frame": {{"xyz": [0.0, 0.1, 0.2]}}, "width_m": 0.03}}]
"""


def test_a_grasp_planner_adds_grasp_points_to_the_cell(install: Install) -> None:
    install(registry.GRASP_PLANNERS, "top", "grasps", GRASPS.format(name="TOP"))
    cell = Cell.load("swapout")
    (thing,) = (one for one in cell.objects if one.name == "MACS-OLD")
    assert thing.grasp_points[-1].name == "TOP"
    assert msgspec.json.decode(cell.encode(), type=Cell).objects == cell.objects  # every process receives it


@pytest.mark.parametrize(
    "grasps",
    [
        "[{'name': 'TOP', 'frame': {'xyz': [0.0, float('nan'), 0.2]}, 'width_m': 0.03}]",
        "[{'name': 'TOP', 'frame': {}, 'width_m': float('inf')}]",
        "[{'name': f'TOP-{n}', 'frame': {}, 'width_m': 0.03} for n in range(200)]",
        "({} for _ in range(3))",
    ],
)
def test_grasp_points_with_figures_that_are_none_or_without_end_are_refused(install: Install, grasps: str) -> None:
    install(registry.GRASP_PLANNERS, "ODD", "grasps", f"def grasps(thing, cell):\n    return {grasps}\n")
    with pytest.raises(ProgramError, match="grasp planner ODD"):
        Cell.load("swapout")


def test_a_grasp_planner_computes_with_numpy_on_a_cell_of_its_own(install: Install) -> None:
    code = "import numpy as np\ndef grasps(thing, cell):\n    thing.grasp_points.clear(); cell.objects.clear()\n"
    point = "[{'name': 'TOP', 'frame': {'xyz': np.array([0.0, 0.1, 0.2])}, 'width_m': np.float64(0.03)}]"
    before = Cell.load("swapout").objects
    install(registry.GRASP_PLANNERS, "ODD", "grasps", f"{code}    return {point}\n")
    after = Cell.load("swapout").objects
    assert [one.grasp_points[:-1] for one in after] == [one.grasp_points for one in before]
    assert after[0].grasp_points[-1].frame.xyz == (0.0, 0.1, 0.2)


@pytest.mark.parametrize("name", ["HANDLE-A", ""])
def test_a_grasp_point_that_does_not_fit_is_refused_with_the_cell(install: Install, name: str) -> None:
    install(registry.GRASP_PLANNERS, "top", "grasps", GRASPS.format(name=name))
    with pytest.raises((ProgramError, ValueError)):
        Cell.load("swapout")


@pytest.mark.parametrize(
    ("code", "fails"),
    [
        ("raise SystemExit(1)", True),
        ("return 7", True),
        ("return [[float('nan')] * 6]", False),
        ("near[:] = 9.0; return [near]", False),
    ],
)
def test_a_solver_that_fails_is_named(install: Install, cell: Cell, code: str, fails: bool) -> None:
    """One that gives no posture is passed over; none changes what it is given."""
    arm = ArmModel.of(cell, "RIGHT-ARM")
    q = np.array(cell.arm("RIGHT-ARM").home_rad)
    install(registry.IK, "EVIL", "solve", f"def solve(arm, target, near):\n    {code}\n")
    before = q.copy()
    with pytest.raises(PluginError, match="IK solver EVIL") if fails else nullcontext():
        assert ik.solutions(["EVIL"], arm, arm.fk(q), q).found == []
    assert q.tolist() == before.tolist()


@pytest.mark.parametrize(
    "expression",
    [
        "'text'",
        "[1, 2]",
        "replace(own, positions=own.positions * float('nan'))",
        "replace(own, time_s=own.time_s[::-1])",
        "replace(own, velocities=own.velocities[:, :2])",
    ],
)
def test_a_timing_that_returns_no_timing_is_named(install: Install, setting, expression: str) -> None:  # noqa: F811
    install(registry.TIMING, "EVIL", "time", SLOW.format(expression=expression))
    with pytest.raises(PluginError, match="timing EVIL"):
        timed_by("EVIL", setting)


def test_a_grasp_planner_that_ends_its_process_is_refused_with_the_cell(install: Install) -> None:
    install(registry.GRASP_PLANNERS, "EVIL", "grasps", "def grasps(thing, cell):\n    raise SystemExit(1)\n")
    with pytest.raises(ProgramError, match="grasp planner EVIL"):
        Cell.load("swapout")
