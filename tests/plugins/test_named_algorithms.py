"""Algorithms by name (R103, R104): the program decides which act and in which order, and the trace names who has acted.

Through the worker functions, with packages of a few lines.
"""

from __future__ import annotations

import pytest

from rtc.model.cells.cell import Cell
from rtc.plugins import registry
from rtc.programs.named_algorithms import FIELDS
from rtc.protocol.messages import BoundStep, Script
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason
from tests.plugins.toy_packages import Install
from tests.workers.conftest import Bench, Reporter, bench  # noqa: F401
from workers.planning.robot_models import CellModel

MOVE, GRASP = "MOVE RIGHT-ARM TO BAY-2-FRONT JOINT-MOTION", "GRASP MACS-NEW WITH RIGHT-ARM"
BY_OWN = "generated a line in joint space"
ASIDE = """
def plan(request, goal):
    middle = 0.5 * (request.start + goal)
    middle[0] += 0.05
    return [request.start, middle, goal]
"""
#: the way of ours, farther
FARTHEST = "def solve(arm, target, near):\n    return arm.ik(target, near, 0.1)[::-1]\n"
SLOW = """
def time(arm, path, pace, load):
    from workers.planning.motion import timing
    return timing.slower(timing.time_path(arm, path, pace, load), 3.0)
"""
BAR = """
def grasps(thing, cell):
    frame = {"xyz": [-0.15, -0.085, 0], "rpy_deg": [0, 90, 0]}
    return [{"name": "BAR", "frame": frame, "width_m": 0.02}] if thing.name == "MACS-NEW" else []
"""
NOTHING = "def {}(*given):\n    return {}\n"


def notes_of(made: Script | BoundStep | Refusal) -> list[str]:
    """What the trace shows of a product, without the name of the option."""
    if isinstance(made, BoundStep):
        return made.note.split("; ")
    assert isinstance(made, Script), made
    return [note.rpartition(": ")[2] if "generated" not in note else note for note in made.notes]


def bound(bench: Bench, sentence: str = MOVE) -> BoundStep:  # noqa: F811
    """The first step of a sentence."""
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    return bench.bind(script, script.steps[0])


@pytest.mark.parametrize("named", [["aside", "own"], ["own", "aside"], ["aside"], ["silent", "aside"]])
@pytest.mark.parametrize("kinds", [("elaborator",), ("binder",), ("elaborator", "binder")])
def test_the_first_planner_of_the_program_that_finds_a_way_plans(install: Install, bench, named, kinds) -> None:  # noqa: F811
    """A binder with the planners of the elaborator takes its way; another one plans anew."""
    install(registry.PLANNERS, "aside", "plan", ASIDE)
    install(registry.PLANNERS, "silent", "plan", NOTHING.format("plan", None))
    for kind in kinds:
        bench.load(kind, f"planners: {named}")
    notes = notes_of(bound(bench))
    by_package = named[0] != "own" and "binder" in kinds
    assert ("planner aside: tested: free" in notes, BY_OWN in notes) == (by_package, not by_package)
    assert ("planner silent: found no way" in notes) is (by_package and "silent" in named)


def test_without_our_planner_a_way_that_no_package_finds_is_refused(install: Install, bench) -> None:  # noqa: F811
    install(registry.PLANNERS, "silent", "plan", NOTHING.format("plan", None))
    bench.load("elaborator", "planners: [silent]")
    refused = bench.elaborate(MOVE)
    assert (type(refused), refused.reason) == (Refusal, RefusalReason.INFEASIBLE)
    bench.load("elaborator", "planners: [silent, own]")
    assert isinstance(bench.elaborate(MOVE), Script)


def test_the_first_solver_of_the_program_that_finds_a_posture_is_followed(install: Install, bench) -> None:  # noqa: F811
    install(registry.IK, "farthest", "solve", FARTHEST)
    install(registry.IK, "silent", "solve", NOTHING.format("solve", []))
    ours = bench.elaborate(GRASP)
    bench.load("elaborator", "ik: [silent, own, farthest]")
    same = bench.elaborate(GRASP)
    assert (same.bindings, "IK solver own" in notes_of(same)) == (ours.bindings, True)
    bench.load("elaborator", "ik: [farthest, own]")
    other = bench.elaborate(GRASP)
    assert other.bindings != ours.bindings
    assert "IK solver farthest" in notes_of(other)


def test_without_our_solver_a_pose_that_no_package_solves_is_refused(install: Install, bench) -> None:  # noqa: F811
    install(registry.IK, "silent", "solve", NOTHING.format("solve", []))
    bench.load("elaborator", "ik: [silent]")
    assert bench.elaborate(MOVE).reason is RefusalReason.INFEASIBLE
    bench.load("elaborator", "ik: [silent, own]")
    assert isinstance(bench.elaborate(MOVE), Script)


def test_the_binder_solves_a_pose_that_has_moved_by_the_solver_of_its_program(install: Install, bench) -> None:  # noqa: F811
    install(registry.IK, "farthest", "solve", FARTHEST)
    bench.load("binder", "ik: [farthest]")
    script = bench.elaborate(GRASP)
    pose = bench.world.get("MACS-NEW.frame").value
    bench.set_fact("MACS-NEW.frame", [pose[0] + 0.01, *pose[1:]])
    plan = next(step for step in script.steps if step.name == "grasp_plan")
    assert "IK solver farthest" in notes_of(bench.bind(script, plan))


@pytest.mark.parametrize(("named", "slower"), [(["slow", "own"], 3.0), (["own", "slow"], 1.0), (["slow"], 3.0)])
def test_the_first_timing_of_the_program_times_a_motion(install: Install, bench, named, slower) -> None:  # noqa: F811
    ours = bound(bench).primitive.trajectory.duration_s
    install(registry.TIMING, "slow", "time", SLOW)
    bench.load("binder", f"timing: {named}")
    step = bound(bench)
    assert step.primitive.trajectory.duration_s == pytest.approx(slower * ours, rel=0.01)
    assert f"timing {named[0]}" in notes_of(step)


def test_without_our_timing_a_path_that_no_package_times_is_refused(install: Install, bench) -> None:  # noqa: F811
    install(registry.TIMING, "silent", "time", NOTHING.format("time", None))
    bench.load("binder", "timing: [silent]")
    assert bound(bench).reason is RefusalReason.INFEASIBLE


@pytest.fixture
def with_bar(install: Install) -> Bench:
    """A bench whose cell has the grasp points of a package too."""
    install(registry.GRASP_PLANNERS, "bars", "grasps", BAR)
    cell = Cell.load("swapout")
    return Bench(Reporter(cell), CellModel(cell))


@pytest.mark.parametrize(
    ("named", "is_bar"), [(["own"], False), (["bars", "own"], True), (["own", "bars"], False), (["bars"], True)]
)
def test_grasp_points_of_the_first_planner_of_the_program_are_tried_first(with_bar: Bench, named, is_bar) -> None:
    with_bar.load("elaborator", f"grasp_planners: {named}")
    script = with_bar.elaborate(GRASP)
    assert (script.context.grasp_point == "BAR") is is_bar
    assert (f"grasp planner {named[0]}" in notes_of(script)) is (named != ["own"])


def test_a_sentence_may_name_any_grasp_point(with_bar: Bench) -> None:
    script = with_bar.elaborate("GRASP RIGHT-END-EFF MACS-NEW BAR")
    assert (script.context.grasp_point, "grasp planner bars" in notes_of(script)) == ("BAR", True)


def test_evaluators_are_named_with_the_ranking(install: Install, bench) -> None:  # noqa: F811
    install(registry.EVALUATORS, "wear", "score", "def score(option):\n    return 0.0\n")
    assert not any("wear" in note for note in bench.elaborate(GRASP).notes)
    bench.load("elaborator", "evaluators: [wear]")
    assert any("evaluator wear" in note for note in bench.elaborate(GRASP).notes)


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        *((kind, field) for kind in ("elaborator", "binder") for field in ("planners", "ik", "timing")),
        *(("elaborator", field) for field in ("grasp_planners", "evaluators", "fillers")),
        ("analyzer", "trimmers"),
        *((kind, "phases") for kind in ("elaborator", "binder", "analyzer")),
    ],
)
def test_an_unknown_name_is_refused_with_the_names_that_exist(install: Install, bench, kind, field) -> None:  # noqa: F811
    group, own = FIELDS[field]
    install(group, "present", "act", "def act(*given):\n    return None\n")
    with pytest.raises(ProgramError) as refused:
        bench.load(kind, f"{field}: [absent]")
    assert all(name in str(refused.value) for name in (f"$.{field}[0]", "absent", "present", *own))
    bench.load(kind, f"{field}: [present]")
