"""Connectors by sentences: a plug is mated until its latch clicks and bears a tug, and is pulled out of its socket."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from rtc.model.cells.cell import Cell
from rtc.protocol import causes
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import Assessment, EndReport, Script, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.spatial import geometry
from tests.campaigns.connectors import DEMATE, MATE, NO_CLICK, NO_HOLD, in_hand
from tests.workers.conftest import Bench, Kinematic
from tests.workers.rehearsal.on_paper import OnPaper
from workers.planning.robot_models import CellModel

MODEL = CellModel(Cell.load("connectors"))
PLUG, SOCKET = "PLUG-1", "SOCKET-1"
TAKEN = (f"GRASP {PLUG}", f"LIFT {PLUG} BY 15 CM")


@pytest.fixture
def paper() -> OnPaper:
    """With the plug in the right hand, out of its stand."""
    made = OnPaper(MODEL)
    for sentence in TAKEN:
        assert made.test(sentence).refusal is None
    return made


def mating(paper: OnPaper, plug: str = PLUG) -> object:
    assert paper.paper is not None
    return {fact.key: fact.value for fact in paper.paper.facts}.get(f"{plug}.mating")


def refusal_of(paper: OnPaper, sentence: str) -> Refusal:
    refusal = paper.test(sentence).refusal
    assert refusal is not None, sentence
    return refusal


def test_on_paper_a_plug_is_mated_and_pulled_out(paper: OnPaper) -> None:
    for sentence, then in ((MATE, "MATED"), (DEMATE, "FREE"), (f"{MATE} UNLESS FORCE EXCEEDS 25 N THEN STOP", "MATED")):
        assert paper.test(sentence).refusal is None
        assert mating(paper) == then
    assert paper.test(f"RELEASE {PLUG}").refusal is None


@pytest.mark.parametrize(
    ("sentence", "reason", "cause", "advised"),
    [
        (f"MATE {PLUG} TO SOCKET-2", RefusalReason.STATE, causes.NeedUnmet(need="seat_free", by="PLUG-2"), MATE),
        (f"MATE {PLUG} TO STAND-1", RefusalReason.STATE, causes.NeedUnmet(need="plug_fits", by="STAND-1"), MATE),
        (DEMATE, RefusalReason.STATE, causes.NeedUnmet(need="in_socket", by=PLUG), ""),
        (f"INSERT {PLUG} INTO {SOCKET}", RefusalReason.NOT_ALLOWED, None, MATE),
        (f"PLACE {PLUG} ON {SOCKET}", RefusalReason.NOT_ALLOWED, None, MATE),
        (f"{MATE} MAINTAIN STIFFNESS 600 N/M", RefusalReason.INFEASIBLE, None, ""),
    ],
)
def test_what_cannot_be_mated_is_refused_with_the_sentence_that_can(
    paper: OnPaper, sentence: str, reason: RefusalReason, cause: object, advised: str
) -> None:
    refusal = refusal_of(paper, sentence)
    assert (refusal.reason, refusal.cause) == (reason, cause)
    assert advised in ["", *sentences_of(refusal.clears)]


def test_a_force_limit_below_that_of_the_latch_is_refused_and_one_above_it_is_not(paper: OnPaper) -> None:
    refusal = refusal_of(paper, f"{MATE} MAINTAIN FORCE-LIMIT 15 N")
    assert isinstance(refusal.cause, causes.ForceExceeded)
    assert paper.test(f"{MATE} MAINTAIN FORCE-LIMIT {refusal.cause.value_n + 1.0:.0f} N").refusal is None


def test_a_plug_is_not_advised_to_be_placed_on_a_socket() -> None:
    paper = OnPaper(MODEL)
    for sentence in (TAKEN[0], f"LIFT {PLUG} BY 5 CM"):  # in its stand still, in no place to be let go of
        assert paper.test(sentence).refusal is None
    advised = sentences_of(refusal_of(paper, f"RELEASE {PLUG}").clears)
    assert advised
    assert f"PLACE {PLUG} ON {SOCKET}" not in advised


@pytest.mark.parametrize("sentence", [f"LIFT {PLUG} BY 5 CM", "MOVE RIGHT-ARM BY 5 CM ALONG UP", MATE])
def test_a_mated_plug_is_only_pulled_out(paper: OnPaper, sentence: str) -> None:
    assert paper.test(MATE).refusal is None
    refusal = refusal_of(paper, sentence)
    assert refusal.reason is RefusalReason.STATE
    assert sentences_of(refusal.clears)[0] == DEMATE


def test_a_plug_that_the_cell_has_in_a_socket_is_mated(paper: OnPaper) -> None:
    assert paper.test("GRASP PLUG-2 WITH LEFT-ARM").refusal is None
    assert sentences_of(refusal_of(paper, "LIFT PLUG-2 BY 5 CM WITH LEFT-ARM").clears)[0] == "DEMATE PLUG-2"
    assert paper.test("DEMATE PLUG-2 WITH LEFT-ARM").refusal is None
    assert mating(paper, "PLUG-2") == "FREE"


# --- stated facts ------------------------------------------------------------------------------------------


@pytest.fixture
def exact() -> Bench:
    """Exact arms."""
    bench = Bench(Kinematic(MODEL.cell), MODEL)
    bench.rigid = ["RIGHT-ARM", "LEFT-ARM"]
    return bench


@pytest.mark.parametrize(
    ("sentence", "reason"),
    [
        ("SET PLUG-1 MATING MATED", RefusalReason.INFEASIBLE),  # it is on its stand
        ("SET PLUG-1 MATING LOOSE", RefusalReason.NAME),
        ("SET PANEL MATING FREE", RefusalReason.INFEASIBLE),
    ],
)
def test_what_cannot_be_of_a_plug_is_not_stated(exact: Bench, sentence: str, reason: RefusalReason) -> None:
    refusal = exact.do(sentence).refusal
    assert refusal is not None
    assert refusal.reason is reason


def test_a_plug_that_is_stated_to_be_elsewhere_is_free(exact: Bench) -> None:
    assert exact.do("SET PLUG-2 FRAME 50 40 70 CM").succeeded
    fact = exact.world.get("PLUG-2.mating")
    assert fact is not None
    assert (fact.value, fact.validity) == ("FREE", Validity.VALID)


def test_whether_a_plug_that_is_stated_to_be_in_a_socket_is_mated_is_in_doubt(exact: Bench) -> None:
    assert exact.do(f"SET {PLUG} SEAT {SOCKET}").succeeded
    fact = exact.world.get(f"{PLUG}.mating")
    assert fact is not None
    assert fact.validity is Validity.SUSPECT
    assert exact.do(f"SET {PLUG} MATING MATED").succeeded
    fact = exact.world.get(f"{PLUG}.mating")
    assert fact is not None
    assert (fact.value, fact.validity) == ("MATED", Validity.VALID)


# --- what reports say --------------------------------------------------------------------------------------


@pytest.mark.physics
def test_exact_arms_mate_and_pull_out(exact: Bench) -> None:
    for sentence in (*TAKEN, MATE, f"RELEASE {PLUG}", f"GRASP {PLUG}", DEMATE):
        done(exact, sentence)
    assert exact.world.value(f"{PLUG}.mating") == "FREE"


def pressed(bench: Bench, **fields: object) -> Assessment:
    """The verdict on the step that presses, with these fields of its report."""
    for sentence in TAKEN:
        assert bench.do(sentence).succeeded
    script = bench.elaborate(MATE)
    assert isinstance(script, Script), script
    press = next(step for step in script.steps if step.effect == "clicked")
    bound = bench.bind(script, press)
    goal = bound.evaluation.goal_pose
    arm = bench.model.arms["RIGHT-ARM"]
    joints = arm.nearest_ik(goal, bench.subsystem.sim.arms["RIGHT-ARM"].joints)
    report = EndReport(
        primitive=bound.primitive.id,
        performer="RIGHT-ARM",
        reason=StopReason.GOAL,
        at_s=0.0,
        duration_s=5.0,
        joints=list(joints),
        tcp_pose=goal,
        wrench=[0.0] * 6,
        hand_width_m=bench.world.value("RIGHT-ARM.hand_width"),
        hand_force_n=45.0,
        peak_force_n=15.2,
    )
    made = bench.analyze(bound, msgspec.structs.replace(report, **fields))
    assert isinstance(made, Assessment), made
    return made


def done(bench: Bench, sentence: str) -> None:
    run = bench.do(sentence)
    assert run.succeeded, (sentence, run.refusal, run.failure)


def in_deg(pose: Any) -> Any:
    return np.degrees(geometry.to_rpy(pose))


def of_plug(made: Assessment) -> dict[str, tuple[object, Validity]]:
    return {change.key: (change.value, change.validity) for change in made.changes if change.key.startswith(PLUG)}


def test_a_plug_in_its_place_without_the_fall_of_a_click_is_not_mated(exact: Bench) -> None:
    made = pressed(exact, peak_force_n=4.0, wrench=[0.0, 0.0, -4.0, 0.0, 0.0, 0.0])
    assert (made.verdict, made.reason) == ("abort", StopReason.NO_CONTACT)
    assert of_plug(made)[f"{PLUG}.mating"][1] is Validity.SUSPECT
    assert DEMATE in sentences_of(made.clears)


def test_a_plug_that_has_clicked_is_in_its_seat_and_in_doubt_until_the_tug(exact: Bench) -> None:
    made = pressed(exact)
    assert made.verdict == "continue"
    assert of_plug(made)[f"{PLUG}.seat"][0] == SOCKET
    assert of_plug(made)[f"{PLUG}.mating"] == ("FREE", Validity.SUSPECT)


# --- physics -----------------------------------------------------------------------------------------------


@pytest.fixture
def held() -> Iterator[Bench]:
    bench = in_hand()
    yield bench
    bench.subsystem.close()


@pytest.mark.physics
@pytest.mark.timeout(600)
def test_on_physics_a_plug_is_mated_let_go_of_and_pulled_out(held: Bench) -> None:
    sim = held.subsystem.sim
    run = held.do(MATE)
    assert run.succeeded, (run.refusal, run.failure)
    assert held.world.value(f"{PLUG}.mating") == "MATED"
    assert PLUG in sim._detents._caught
    assert isinstance(held.elaborate(f"LIFT {PLUG} BY 5 CM"), Refusal)
    run = held.do(DEMATE)
    assert run.succeeded, (run.refusal, run.failure)
    assert max(report.peak_force_n for report in run.reports) > MODEL.cell.seat(SOCKET).detent_n
    assert (held.world.value(f"{PLUG}.mating"), held.world.value(f"{PLUG}.seat")) == ("FREE", "")
    assert sim.held()["RIGHT-ARM"] == [PLUG]


@pytest.mark.physics
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("latch", "reason"), [(NO_CLICK, "press"), (NO_HOLD, "tug")])
def test_on_physics_a_latch_that_does_not_click_or_hold_is_named_and_the_plug_comes_out(
    latch: str, reason: str
) -> None:
    bench = in_hand(latch)
    run = bench.do(MATE)
    assert run.labels[-1].startswith(reason)
    assert run.failure is not None
    assert bench.world.value(f"{PLUG}.mating") == "FREE"
    assert DEMATE in sentences_of(run.failure.clears)
    assert bench.do(DEMATE).succeeded
    bench.subsystem.close()


@pytest.mark.physics
@pytest.mark.timeout(600)
def test_on_physics_a_jam_before_the_latch_is_named_and_the_advice_leads_to_a_mated_plug(held: Bench) -> None:
    world = held.subsystem.sim._sockets
    mending = [contacts._mating for *_, contacts in world._sockets]
    for *_, contacts in world._sockets:
        contacts._mating = replace(contacts._mating, latch_n=200.0)
    run = held.do(MATE)
    assert run.failure is not None
    assert run.failure.reason is StopReason.FORCE_LIMIT
    for (*_, contacts), whole in zip(world._sockets, mending, strict=True):
        contacts._mating = whole
    assert DEMATE in sentences_of(run.failure.clears)
    assert f"{PLUG}.frame" in run.failure.clears[0].states  # the jam may have moved it in the hand
    done(held, DEMATE)
    true = held.subsystem.sim.world.pose(PLUG)
    position, attitude = (" ".join(f"{n:.2f}" for n in numbers) for numbers in (100 * true[:3], in_deg(true)))
    done(held, f"SET {PLUG} FRAME {position} CM {attitude} DEG")
    done(held, MATE)
    assert held.world.value(f"{PLUG}.mating") == "MATED"
