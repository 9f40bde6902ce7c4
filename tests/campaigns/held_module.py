"""A module in the hand of an arm of the simulated cell, held by friction alone, as a state to return to."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pybullet

from rtc.protocol import primitive as p
from rtc.subsystems.motion.executor import Executor
from tests.workers.conftest import Bench, Physical

AT_REST_RAD_S = 0.02


class HeldModule:
    """The cell after these sentences; the last one moves the arm with the module."""

    def __init__(self, arm: str, module: str, sentences: Iterable[str], offset: Sequence[float] = ()) -> None:
        """`offset`: of the module before them, which nothing knows (m, rad)."""
        self.arm, self.module = arm, module
        self.subsystem = Physical()
        self.bench = Bench(self.subsystem)
        self.sim = self.subsystem.sim
        if any(offset):
            self.subsystem.displace_and_turn(module, list(offset))
        for sentence in sentences:
            run = self.bench.do(sentence)
            assert run.succeeded, (sentence, run.refusal, run.assessments)
        law = run.primitives[-1].control_law
        self.load = law.load
        self._law = p.ControlLaw(load=law.load, gains=law.gains)
        self._saved = pybullet.saveState(physicsClientId=self.sim.world.client)
        self._world = self.bench.world
        executor = self.subsystem.executors[arm]
        self.joints, self._hand = list(executor.command[0]), executor.hand
        self._pressed = self.sim.arms[arm]._pressed

    def restore(self) -> None:
        """Back to the state after the sentences."""
        self.sim._detents.let_go_all()
        pybullet.restoreState(self._saved, physicsClientId=self.sim.world.client)
        self.bench.world = self._world
        still = [0.0] * len(self.joints)
        arm = self.sim.arms[self.arm]
        arm.use_law(self._law)
        arm.follow((self.joints, still, still))
        arm.command_hand(self._hand)
        arm._hand.wanted_m = 0.0  # the spring of the grip is stretched
        arm._pressed = self._pressed  # what the first tick reads
        for name, other in self.sim.arms.items():
            other.read()
            self.subsystem.executors[name] = Executor(other)
        self.subsystem.executors[self.arm]._hand.command = self._hand

    def holds_still(self) -> bool:
        """Whether the arm rests, with the module in its hand or in the catch of the seat."""
        rests = max(map(abs, self.sim.arms[self.arm].read().velocities)) < AT_REST_RAD_S
        kept = self.sim.held()[self.arm] == [self.module] or self.module in self.sim._detents._caught
        return rests and kept and self.subsystem.executors[self.arm].primitive is None
