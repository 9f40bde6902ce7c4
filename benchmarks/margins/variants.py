"""How a run differs from its cell file, so that a success that hangs on a hair is seen. Each is a change of a
simulation that is prepared already."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import msgspec
import pybullet

from benchmarks.margins.met import Watched
from rtc.subsystems.motion.arm import HandCommand, Sample
from sim_mcm.arms.bullet_world import STEP_S
from tests.campaigns.door import rub_hinge

OFF_RAD = 0.0002  # of each joint's sensor, to alternating sides
JITTER = 0.1  # share of the step, uniformly to either side
SEEDS = (101, 202)  # of the noise of the first picture

Variant = Callable[[Watched], None]


def _friction(factor: float) -> Variant:
    """Of all movable objects and hinges: friction of a contact is the product of both sides."""

    def change(arms: Watched) -> None:
        for name in arms.world.movable:
            arms.world.rub(name, factor)
            if (hinge := arms.cell.object(name).hinge) is not None:
                rub_hinge(arms.world, name, factor * hinge.friction_nm)

    return change


def _mass(factor: float) -> Variant:
    def change(arms: Watched) -> None:
        for name in arms.world.movable:
            arms.world.weigh(name, factor)

    return change


def _grip(factor: float) -> Variant:
    """Hands exert less than they are commanded."""

    def change(arms: Watched) -> None:
        for arm in arms.bullet_arms:
            arm.command_hand = weak(arm.command_hand, factor)

    return change


def weak(command: Callable[[HandCommand], None], factor: float) -> Callable[[HandCommand], None]:
    return lambda hand: command(msgspec.structs.replace(hand, force_n=factor * hand.force_n))


def _joints(arms: Watched) -> None:
    """The sensors of the joints are off; servo and executor see the same."""
    for arm in arms.bullet_arms:
        arm.read = _off(arm)


def _off(arm: Any) -> Callable[[], Sample]:
    read = arm.read

    def sample() -> Sample:
        true: Sample = read()
        joints = [q + OFF_RAD * (-1) ** n for n, q in enumerate(true.joints)]
        arm._sample = msgspec.structs.replace(true, joints=joints)
        return arm._sample  # type: ignore[no-any-return]

    return sample


def _jitter(arms: Watched) -> None:
    rng, step = random.Random(7), arms.world.step

    def uneven() -> None:
        _engine(fixedTimeStep=STEP_S * rng.uniform(1.0 - JITTER, 1.0 + JITTER))(arms)
        step()

    arms.world.step = uneven  # type: ignore[method-assign]


def _engine(**values: float) -> Variant:
    return lambda arms: pybullet.setPhysicsEngineParameter(**values, physicsClientId=arms.world.client)


def _iterations(factor: int) -> Variant:
    def change(arms: Watched) -> None:
        now = pybullet.getPhysicsEngineParameters(physicsClientId=arms.world.client)["numSolverIterations"]
        _engine(numSolverIterations=factor * now)(arms)

    return change


def _pictures(*, noise: float = 1.0, seed: int = 1) -> Variant:
    def change(arms: Watched) -> None:
        arms.noise, arms.seed = noise, seed

    return change


VARIANTS: dict[str, Variant] = {
    "as the cell file": lambda arms: None,
    "friction 0.8": _friction(0.8),
    "friction 1.2": _friction(1.2),
    "mass 0.9": _mass(0.9),
    "mass 1.1": _mass(1.1),
    "grip force 0.9": _grip(0.9),
    "joints 0.2 mrad off": _joints,
    "camera noise x 2": _pictures(noise=2.0),
    "jitter of the step": _jitter,
    "iterations x 2": _iterations(2),
    "step 1/960": _engine(fixedTimeStep=1.0 / 960.0),
} | {f"camera seed {seed}": _pictures(seed=seed) for seed in SEEDS}
