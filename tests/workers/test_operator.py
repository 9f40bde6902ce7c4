"""The operator performs sentences, in one process: a scripted operator moves the arms by his stream, and answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.spatial import geometry
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.workers.conftest import MODEL
from tests.workers.one_process import OneProcess

ARM, OTHER = "RIGHT-ARM", "LEFT-ARM"
PERIOD = 20  # ticks between two messages
GAIN_PER_S, ARRIVED_M = 4.0, 0.0008


class Operator:
    """A person with a hand controller, who sees where things are; `at` the arm that he has."""

    def __init__(self, rtc: OneProcess, arm: str = ARM) -> None:
        self.rtc, self.arm = rtc, arm

    @property
    def executor(self) -> Any:
        return self.rtc.mcm.executors[self.arm]

    @property
    def asked(self) -> str:
        """What he is asked to do; empty: nothing."""
        return "" if self.executor.operated is None else self.executor.operated.look().request

    def wait(self, words: str, limit_s: float = 60.0) -> None:
        """Until he is asked to do this."""
        for _ in range(round(limit_s * 1000)):
            if words in self.asked:
                return
            self.rtc.tick()
        raise AssertionError((words, self.asked, self.rtc.outcomes, [n.note for n in self.rtc.notes[-5:]]))

    def send(self, **wanted: Any) -> str:
        given = {"primitive": self.executor.primitive_id, "operator": "ADA", "seen_at_s": self.rtc.now_s, "hold": True}
        return self.rtc.mcm.operate(m.Operate(**given | wanted), b"ada", self.rtc.now_s).refused

    def drive(self, seconds: float, **wanted: Any) -> None:
        for _ in range(round(seconds * 1000 / PERIOD)):
            self.send(**wanted)
            for _ in range(PERIOD):
                self.rtc.tick()

    def go(self, goal: Sequence[float], limit_s: float = 60.0) -> None:
        """Bring the tcp to this pose (world), and let go."""
        for _ in range(round(limit_s * 1000 / PERIOD)):
            here = self.executor.arm.tcp_pose(self.executor.sample.joints)
            off, turn = np.asarray(goal[:3]) - here[:3], geometry.rotation_vector(here, goal)
            if np.linalg.norm(off) < ARRIVED_M and np.linalg.norm(turn) < 0.004:
                break
            self.drive(PERIOD / 1000, twist=[*(GAIN_PER_S * off), *(GAIN_PER_S * turn)])
            assert self.executor.operated is not None, self.rtc.notes[-3:]
        else:
            raise AssertionError((self.executor.operated.look(), off, turn))
        self.drive(0.1, hold=False)

    def say(self, sentence: str) -> m.Outcome:
        """Give an answer, and wait for its outcome."""
        command = self.rtc.give(sentence, client="ada")
        for _ in range(2000):
            if command in self.rtc.outcomes:
                return self.rtc.outcomes[command]
            self.rtc.tick()
        raise AssertionError(sentence)


def grasp_pose(sim: Any, thing: str, point: str) -> np.ndarray:
    """Where the tcp is at a grasp point, in the true world."""
    frame = next(one.frame.pose for one in MODEL.cell.object(thing).grasp_points if one.name == point)
    return geometry.compose(sim.truth()["poses"][thing], frame)


def grasp_by_hand(rtc: OneProcess, command: str) -> None:
    """Perform the three requests of GRASP VIA OPERATOR-INTERVENTION, with what he does wrong on the way."""
    it, sim = Operator(rtc), rtc.sim
    it.wait("neighborhood")
    goal = grasp_pose(sim, "MACS-NEW", "HANDLE-A")
    refused = it.say("DONE")
    assert refused.kind is OutcomeKind.REFUSED
    assert " is near enough" in refused.message
    before = geometry.translate(goal, -0.12 * geometry.rotate(goal, (0.0, 0.0, 1.0)))
    it.go(before)
    assert "hand is not part" in it.send(hand="close")
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    it.wait("grasp point")
    assert it.say("DONE").kind is OutcomeKind.REFUSED
    it.go(goal)
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    it.wait("close the hand")
    assert it.say("DONE").kind is OutcomeKind.REFUSED  # nothing is gripped
    it.drive(2.0, hand="close")
    it.drive(0.1, hold=False)
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    rtc.run()
    assert rtc.outcomes[command].kind is OutcomeKind.SUCCEEDED, rtc.outcomes[command]


def off_mm(rtc: OneProcess, thing: str) -> float:
    return 1000.0 * math.dist(rtc.world.value(f"{thing}.frame")[:3], rtc.sim.truth()["poses"][thing][:3])


def displaced() -> OneProcess:
    """A cell whose rack with the module is 12 mm from where it is believed to be."""
    sim = KinematicCell(MODEL.cell)
    rtc = OneProcess(sim)
    assert sim.displace("MACS-NEW", [0.0, 0.006, 0.0104, 0.0, 0.0, 0.0]) == ""
    return rtc


def test_the_operator_grasps_and_the_world_knows_what_he_holds() -> None:
    rtc = displaced()
    assert off_mm(rtc, "MACS-NEW") == pytest.approx(12.0, abs=0.1)
    command = rtc.give("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM VIA OPERATOR-INTERVENTION")
    grasp_by_hand(rtc, command)
    assert rtc.sim.held()[ARM] == ["MACS-NEW"]
    assert off_mm(rtc, "MACS-NEW") < 2.0
