"""Repairs: sentences that were rehearsed in the place of one that is not feasible."""

from __future__ import annotations

import pytest

from rtc.protocol.messages import Validity
from rtc.protocol.rehearsal import Repair
from rtc.wording.advice import in_one_line
from tests.workers.rehearsal.on_paper import SERVICING, OnPaper
from workers.elaborator import make_way
from workers.rehearsal import repairs
from workers.rehearsal.performance import Performance

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"


def offered(paper: OnPaper, sentence: str) -> list[Repair]:
    found = paper.test(sentence)
    assert found.refusal is not None, "it is feasible"
    return found.rehearsal.repairs


def sentences(found: list[Repair]) -> list[list[str]]:
    return [one.sentences for one in found]


def test_another_seat():
    paper = OnPaper()
    paper.test(GRASP)
    paper.test("LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
    assert ["PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM"] in sentences(
        offered(paper, "PLACE MACS-NEW ON RACK-2 WITH RIGHT-ARM")
    )


def test_another_hand():
    found = offered(OnPaper(), "GRASP LEFT-END-EFF MACS-NEW HANDLE-A")
    assert sentences(found)[0] == [GRASP]
    assert found[0].changes == "RIGHT-END-EFF instead of LEFT-END-EFF"


def test_another_grasp_point():
    found = offered(OnPaper(), "GRASP RIGHT-END-EFF MACS-NEW HANDLE-C")
    assert sentences(found)[0] == [GRASP]


def test_a_sentence_before_it_that_the_advice_contains():
    found = offered(OnPaper(), "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
    assert ["GRASP MACS-NEW", "LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"] in sentences(found)


def test_an_arm_in_the_way_is_stowed_first():
    paper = OnPaper()
    for sentence in ("MOVE LEFT-ARM TO BAY-2-FRONT", "MOVE LEFT-ARM BY 15 CM ALONG RIGHT"):
        paper.test(sentence)
    assert ["STOW LEFT-ARM", "MOVE RIGHT-ARM TO BAY-2-FRONT"] in sentences(
        offered(paper, "MOVE RIGHT-ARM TO BAY-2-FRONT")
    )


def performed(monkeypatch, paper: OnPaper, sentence: str) -> list[str]:
    """The verbs and objects of the sentences that were rehearsed to the end for the repairs of this one."""
    run, found = Performance.run, []

    def counted(self, parsed):
        found.append(f"{parsed.verb} {parsed.object or parsed.hand}")
        return run(self, parsed)

    monkeypatch.setattr(Performance, "run", counted)
    offered(paper, sentence)
    monkeypatch.undo()
    return found


def test_after_a_look_that_changes_nothing_the_sentence_is_not_rehearsed_again(monkeypatch):
    """The door is in the way by more than any doubt about it."""
    paper = OnPaper(SERVICING)
    for sentence in ("GRASP LEFT-END-EFF DOOR-2 LATCH-PULL", "OPEN DOOR-2 BY 90 DEG", "RELEASE DOOR-2"):
        assert paper.test(sentence).refusal is None
    found = performed(monkeypatch, paper, "GRASP LEFT-END-EFF MACS-OLD HANDLE-B")
    look = found.index("LOCATE DOOR-2")
    grasps = ["GRASP MACS-OLD"] * 2  # the next repair, and the sentence after it; none after the look
    assert found[look + 1 : look + 4] == [*grasps, "RETRACT LEFT-ARM"]


def test_a_look_at_what_is_in_doubt_is_offered():
    paper = OnPaper()
    paper.know("MACS-NEW.frame", validity=Validity.INVALID)
    assert ["LOCATE MACS-NEW", GRASP] in sentences(offered(paper, GRASP))


def test_the_sentence_for_an_arm_in_the_way_is_sought_once_and_not_for_repairs(monkeypatch):
    sought = []
    advise = make_way.advise
    monkeypatch.setattr(make_way, "advise", lambda *args: sought.append(args[0]) or advise(*args))
    paper = OnPaper()
    for sentence in ("MOVE LEFT-ARM TO BAY-2-FRONT", "MOVE LEFT-ARM BY 15 CM ALONG RIGHT"):
        paper.test(sentence)
    found = paper.test("MOVE RIGHT-ARM TO BAY-2-FRONT")
    assert found.refusal is not None
    assert in_one_line(found.refusal.clears).startswith("STOW LEFT-ARM")
    assert len(sought) == 1


def test_every_repair_that_is_offered_is_feasible_when_it_is_rehearsed_again():
    for sentence in ("GRASP LEFT-END-EFF MACS-NEW HANDLE-A", "MOVE LEFT-ARM TO RACK-1-FRONT"):
        for repair in offered(OnPaper(), sentence):
            paper = OnPaper()
            found = [paper.test(text) for text in repair.sentences]
            assert [one.refusal for one in found] == [None] * len(found)
            assert sum(one.rehearsal.predicted_s for one in found) == pytest.approx(repair.predicted_s)


def test_facts_are_never_stated_and_the_number_of_repairs_is_limited(monkeypatch):
    monkeypatch.setattr(repairs, "OFFERED", 2)
    found = offered(OnPaper(), "MOVE LEFT-ARM TO RACK-1-FRONT")
    assert len(found) == 2
    assert not any(text.startswith("SET") for one in found for text in one.sentences)


def test_the_number_of_trials_is_limited(monkeypatch):
    monkeypatch.setattr(repairs, "TRIED", 0)
    assert offered(OnPaper(), "MOVE LEFT-ARM TO RACK-1-FRONT") == []


def test_a_verb_without_a_script_is_not_repaired():
    assert offered(OnPaper(), "RELEASE MACS-OLD VIA OPERATOR-INTERVENTION") == []


def test_another_hand_is_the_last_repair_of_a_sentence_about_the_hand_itself():
    paper = OnPaper()
    paper.test("GRASP LEFT-END-EFF MACS-OLD HANDLE-B")
    found = sentences(offered(paper, "STOW LEFT-ARM"))
    assert found[0] == ["LIFT MACS-OLD BY 15 CM WITH LEFT-ARM", "STOW LEFT-ARM"]
    assert found[-1] == ["STOW RIGHT-ARM"]
