"""Unknown, changing and invalid facts: who writes them, and what a step does that relies on one (R140, R151)."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rtc.protocol import causes
from rtc.protocol.messages import Phase, SavedFact, SavedWorld, Validity, WorldChange
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from rtc.world.model import World, initial_facts
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.workers.conftest import CELL
from tests.workers.one_process import OneProcess
from workers.planning.world_query import WorldQuery

GRASP, LIFT = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"
NEAR = "MOVE LEFT-ARM TO-NEIGHBORHOOD-OF MACS-NEW"
POSE = [0.8, -0.8, 0.6, 0.0, 0.0, 0.0, 1.0]


def validity(bench: Any, key: str) -> Validity:
    found: Validity = bench.world.get(key).validity
    return found


def refused(bench: Any, sentence: str) -> Refusal:
    run = bench.do(sentence)
    assert run.refusal is not None, run
    assert run.primitives == []
    return run.refusal


# --- unknown ---------------------------------------------------------------------------------------------


def test_a_pose_that_is_stated_to_be_unknown_is_relied_on_by_no_step_until_it_is_located(bench):
    assert bench.do("SET MACS-NEW FRAME UNKNOWN").succeeded
    assert validity(bench, "MACS-NEW.frame") is Validity.UNKNOWN
    assert bench.world.value("MACS-NEW.frame") is not None  # the last belief, as a guess
    refusal = refused(bench, GRASP)
    assert (refusal.reason, refusal.where) == (RefusalReason.SUSPECT, "MACS-NEW.frame")
    assert refusal.cause.validity == Validity.UNKNOWN
    assert bench.do(refusal.clears[0].sentences[0]).succeeded  # LOCATE MACS-NEW
    assert validity(bench, "MACS-NEW.frame") is Validity.VALID
    assert bench.do(GRASP).succeeded


def test_without_cameras_it_must_be_stated(bench):
    bench.without_cameras()
    assert bench.do("SET MACS-NEW FRAME UNKNOWN").succeeded
    refusal = refused(bench, GRASP)
    assert "SET MACS-NEW FRAME x y z" in in_one_line(refusal.clears)
    assert "believed" not in in_one_line(refusal.clears)
    assert bench.do("SET MACS-NEW FRAME 80 -80 60 CM").succeeded
    assert not isinstance(bench.elaborate(GRASP), Refusal)


def test_all_cameras_look_for_what_may_be_anywhere(bench):
    query = WorldQuery(bench.model, bench.world)
    bench.do("SET MACS-NEW FRAME UNKNOWN")
    everywhere = WorldQuery(bench.model, bench.world)
    assert {camera.name for camera in everywhere.cameras("MACS-NEW")} == {camera.name for camera in CELL.cameras}
    assert everywhere.cameras("MACS-NEW")[0] == query.cameras("MACS-NEW")[0]  # the one that saw it last comes first


def test_what_is_in_a_hand_is_not_unknown(bench):
    assert bench.do(GRASP).succeeded
    refusal = refused(bench, "SET MACS-NEW FRAME UNKNOWN")
    assert refusal.reason is RefusalReason.STATE


def test_a_cell_may_state_that_an_object_is_not_surveyed() -> None:
    things = [
        msgspec.structs.replace(thing, known_within="unknown") if thing.name == "MACS-NEW" else thing
        for thing in CELL.objects
    ]
    facts = {change.key: change for change in initial_facts(msgspec.structs.replace(CELL, objects=things))}
    assert facts["MACS-NEW.frame"].validity is Validity.UNKNOWN
    assert facts["MACS-NEW.frame"].spread is None
    assert facts["MACS-OLD.frame"].validity is Validity.VALID


def test_a_reset_leaves_what_the_cell_does_not_state_unknown(bench):
    assert bench.do("LOCATE MACS-NEW").succeeded
    assert bench.do("SET WORLD FACTS INITIAL").succeeded
    assert validity(bench, "MACS-NEW.sighting") is Validity.UNKNOWN
    assert WorldQuery(bench.model, bench.world).finds("MACS-NEW")  # it was not missed


def test_a_doubt_makes_no_fact_more_certain(bench):
    bench.set_fact("MACS-NEW.frame", POSE, Validity.INVALID)
    doubt = WorldChange(key="MACS-NEW.frame", keep_value=True, validity=Validity.SUSPECT)
    bench.world = bench.world.overlay([doubt])
    assert validity(bench, "MACS-NEW.frame") is Validity.INVALID


# --- invalid ---------------------------------------------------------------------------------------------


def test_fingers_that_meet_nothing_disprove_the_place_of_what_they_held(bench):
    assert bench.do(GRASP).succeeded
    script = bench.elaborate(LIFT)
    bound = bench.bind(script, script.steps[1])
    report = bench.subsystem.perform(bound.primitive, bound)
    lost = msgspec.structs.replace(report, reason=StopReason.OBJECT_LOST, hand_width_m=0.0, hand_force_n=0.0)
    judged = bench.analyze(bound, lost)
    bench.world = bench.world.overlay(judged.changes)
    assert validity(bench, "MACS-NEW.frame") is Validity.INVALID
    assert "LOCATE MACS-NEW" in in_one_line(judged.clears)
    assert bench.do("OPEN RIGHT-ARM").succeeded
    refusal = refused(bench, GRASP)  # not sensed on the way: it may be anywhere
    assert refusal.cause.validity == Validity.INVALID
    assert refusal.clears[0].sentences == ["LOCATE MACS-NEW"]


# --- changing --------------------------------------------------------------------------------------------


def test_a_step_waits_for_the_arm_that_changes_a_fact_it_relies_on(bench):
    assert bench.do(GRASP).succeeded
    assert bench.do(LIFT).succeeded
    script = bench.elaborate("MOVE RIGHT-ARM BY 10 CM ALONG UP")
    moves = bench.bind(script, script.steps[-1]).primitive
    resting = bench.elaborate(NEAR)
    assert isinstance(resting, Refusal)  # out of reach, which only an arm at rest can tell
    assert resting.reason is RefusalReason.INFEASIBLE
    bench.moving = [moves]
    refusal = bench.elaborate(NEAR)
    assert isinstance(refusal, Refusal)
    assert (refusal.where, refusal.in_the_way) == ("MACS-NEW.frame", "RIGHT-ARM")
    assert refusal.cause == causes.Changing(fact="MACS-NEW.frame")


@pytest.mark.physics
def test_a_command_that_relies_on_a_moving_object_is_planned_when_the_arm_has_rested():
    surveyed = [msgspec.structs.replace(change, spread=None) for change in initial_facts(CELL)]
    cluster = OneProcess(KinematicCell(CELL), world=World().overlay(surveyed))
    for sentence in (GRASP, LIFT):
        cluster.give(sentence)
        cluster.run()
    first = cluster.give("MOVE RIGHT-ARM BY 10 CM ALONG UP")
    while "RIGHT-ARM" not in cluster.state.motions:
        cluster.tick()
    second = cluster.give(NEAR)
    cluster.run()
    notes = [note for note in cluster.notes if note.command == second]
    waits = next(note for note in notes if note.phase is Phase.WAITING)
    assert waits.arm == "RIGHT-ARM"
    assert cluster.outcomes[first].kind is OutcomeKind.SUCCEEDED
    assert isinstance(cluster.outcomes[second].refusal.cause, causes.OutOfReach)


# --- attitude --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("word", ["ATTITUDE", "ORIENTATION"])
def test_an_attitude_is_stated_by_either_word(bench, word):
    before = geometry.to_rpy(bench.world.value("MACS-NEW.frame"))
    assert bench.do(f"SET MACS-NEW {word} 0 0 4 DEG").succeeded
    frame = bench.world.value("MACS-NEW.frame")
    assert geometry.to_rpy(frame)[2] != pytest.approx(before[2], abs=0.01)
    assert geometry.to_rpy(frame) == pytest.approx([0.0, 0.0, 0.0698], abs=1e-3)
    assert bench.world.get("MACS-NEW.orientation") is None  # no attribute of its own


# --- facts of a file -------------------------------------------------------------------------------------


def saved(world: World) -> SavedWorld:
    facts = {key: SavedFact(value=f.value, validity=f.validity, spread=f.spread) for key, f in world.facts.items()}
    return SavedWorld(cell=CELL.digest(), facts=facts)


def test_the_facts_of_a_file_come_back_as_one_report(bench):
    bench.unsurveyed()
    assert bench.do("SET MACS-NEW FRAME 70 -70 60 CM").succeeded
    bench.set_fact("MACS-OLD.frame", bench.world.value("MACS-OLD.frame"), Validity.SUSPECT)
    bench.set_fact("P1.posture_of_right_arm", [0.0, 1.0, -2.0, 0.0, 0.5, 0.0])
    file, joints = saved(bench.world), bench.world.value("RIGHT-ARM.joints")
    assert bench.do("STOW RIGHT-ARM").succeeded
    assert bench.do("SET WORLD FACTS INITIAL").succeeded
    assert bench.world.value("MACS-NEW.frame") != file.facts["MACS-NEW.frame"].value

    bench.saved = file
    run = bench.do("SET WORLD FACTS SAVED")

    assert run.succeeded, run.refusal
    things = {key for key in file.facts if not key.startswith(("RIGHT-ARM.", "LEFT-ARM.", "WORLD."))}
    assert {key: bench.world.value(key) for key in things} == {key: file.facts[key].value for key in things}
    assert validity(bench, "MACS-OLD.frame") is Validity.SUSPECT
    assert bench.world.get("MACS-NEW.frame").spread == file.facts["MACS-NEW.frame"].spread
    assert bench.world.value("RIGHT-ARM.joints") != joints  # they are measured
    assert bench.world.value("WORLD.facts") == "saved"


def test_what_was_in_a_hand_then_is_in_no_hand_and_its_place_is_not_sure(bench):
    assert bench.do(GRASP).succeeded
    file = saved(bench.world)
    assert bench.do("RELEASE MACS-NEW").succeeded
    bench.saved = file
    assert bench.do("SET WORLD FACTS SAVED").succeeded
    assert bench.world.value("MACS-NEW.held_by") == ""
    assert bench.world.value("RIGHT-ARM.holding") == ""
    assert validity(bench, "MACS-NEW.frame") is Validity.SUSPECT


def test_a_file_is_refused_as_a_whole(bench):
    file = saved(bench.world)
    wrong = {
        "another cell": msgspec.structs.replace(file, cell="x"),
        "no such object": msgspec.structs.replace(file, facts={"MACS-NWE.frame": SavedFact(value=POSE)}),
        "too far": msgspec.structs.replace(file, facts={"MACS-NEW.frame": SavedFact(value=[9.0, *POSE[1:]])}),
        "no pose": msgspec.structs.replace(file, facts={"MACS-NEW.frame": SavedFact(value=[1.0])}),
    }
    for why, given in wrong.items():
        bench.saved = given
        run = bench.do("SET WORLD FACTS SAVED")
        assert run.refusal is not None, why
        assert run.refusal.clears


def test_the_sentence_and_the_facts_belong_together(bench):
    assert "rtc world restore" in in_one_line(refused(bench, "SET WORLD FACTS SAVED").clears)
    bench.saved = saved(bench.world)
    assert refused(bench, "STOW RIGHT-ARM").reason is RefusalReason.SENTENCE


def test_no_facts_are_put_back_while_a_hand_holds_something(bench):
    assert bench.do(GRASP).succeeded
    bench.saved = saved(bench.world)
    assert refused(bench, "SET WORLD FACTS SAVED").reason is RefusalReason.STATE
