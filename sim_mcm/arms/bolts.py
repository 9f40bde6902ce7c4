"""Bolts and the drivers that turn them: threads, break-away, tightness, and the reaction on the tool.

A driver is an object with a spindle; it turns for the hand that presses on it. A bolt is an object with a thread. While
the tip of a spindle is on the head of a bolt, the bolt turns with it if the torque suffices. Its head then moves along
the thread. The driver feels the torque, and the socket of the head centres the tip. Outside a bolt the spindle turns
freely. A stripped bolt turns without effect. A tightened bolt needs the same torque to be broken loose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pybullet

from rtc.model.cells import parts
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import TICK_S, SpindleCommand, SpindleState
from sim_mcm.arms.bullet_world import PhysicsWorld

NEAR_M, ASIDE_M, TILTED_RAD = 0.004, 0.003, 0.09  # of a tip that is on the head: along the bolt, beside it, attitude
STIFF_NM_RAD = 8.0  # of a spindle against a bolt that does not turn
STRIPPED_NM = 0.05
FREE_RAD = 1e-3  # a bolt that is out by all its turns but this is free
# The socket of a head centres a tip that turns in it. Without it, the friction of the pads creeps under the press: the
# tip of a driver moves aside by 10 mm a minute.
SOCKET_N_M, SOCKET_N_S_M, SOCKET_N = 2000.0, 20.0, 20.0


@dataclass
class Bolt:
    """`out_rad`: how far it is turned out; 0 is in its seat. `tight_nm`: the torque that breaks it loose, or 0."""

    name: str
    thread: parts.Thread
    out_rad: float
    tight_nm: float
    stripped: bool = False

    @property
    def free(self) -> bool:
        return self.out_rad >= self.thread.turns * math.tau - FREE_RAD


@dataclass
class Turning:
    """A spindle at work. `wound_rad`: how far it is twisted against a bolt that does not turn."""

    command: SpindleCommand
    driver: str
    turned_rad: float = 0.0
    wound_rad: float = 0.0
    torque_nm: float = 0.0


class Bolts:
    def __init__(self, world: PhysicsWorld) -> None:
        self._world = world
        self._bolts = {
            thing.name: Bolt(thing.name, thing.thread, 0.0, thing.thread.breakaway_nm)
            for thing in world.cell.objects
            if thing.thread is not None
        }
        self._drivers = {world.objects[thing.name].id: thing for thing in world.cell.objects if thing.spindle}
        self._turning: dict[str, Turning] = {}  # by arm

    # --- for arms ------------------------------------------------------------------------------------------

    def drive(self, arm: str, command: SpindleCommand | None, pressed_on: set[int]) -> None:
        """Turn the spindle of the driver between the fingers; None stops it. Raises ValueError without a driver."""
        if command is None:
            self._turning.pop(arm, None)
            return
        held = [thing for body, thing in self._drivers.items() if body in pressed_on]
        if not held:
            raise ValueError(f"{arm} holds no driver")
        assert held[0].spindle is not None
        most_nm, fastest = held[0].spindle.most_nm, held[0].spindle.most_rad_s
        if command.torque_nm > most_nm or command.speed_rad_s > fastest:
            raise ValueError(
                f"{held[0].name} turns with {most_nm:g} N.m and {fastest:g} rad/s at most, "
                f"not with {command.torque_nm:g} N.m and {command.speed_rad_s:g} rad/s"
            )
        self._turning[arm] = Turning(command, held[0].name)

    def state(self, arm: str) -> SpindleState:
        turning = self._turning.get(arm)
        return SpindleState() if turning is None else SpindleState(turning.turned_rad)

    # --- for the simulation --------------------------------------------------------------------------------

    def step(self) -> None:
        """Before each physics step: turn the spindles, apply the reactions."""
        for turning in self._turning.values():
            self._turn(turning)

    def strip(self, name: str, stripped: bool = True) -> str:
        """Strip a bolt, or mend it. Returns the reason of a refusal, or ''."""
        if name not in self._bolts:
            return unknown("bolt", name, self._bolts)
        self._bolts[name].stripped = stripped
        return ""

    def fasten(self, seat: str) -> bool:
        """Whether a bolt of this seat is not turned out: then it fastens what is in the seat."""
        return any(not self._bolts[name].free for name in self._world.cell.seat(seat).bolts)

    def out_turns(self, name: str) -> float:
        return self._bolts[name].out_rad / math.tau

    def tight(self) -> dict[str, list[float]]:
        """Bolt -> one number, the torque (N.m) to which it was tightened; 0 if it is not tight."""
        return {name: [bolt.tight_nm] for name, bolt in self._bolts.items()}

    def look(self) -> None:
        """Take over how far the bolts are out from where their heads are, after a restored state."""
        self._turning.clear()
        for bolt in self._bolts.values():
            out_m = self._world.out_m(bolt.name)
            bolt.out_rad = math.tau * out_m / bolt.thread.pitch_m
            bolt.tight_nm = bolt.thread.breakaway_nm if bolt.out_rad < 1e-3 else 0.0

    # --- inside --------------------------------------------------------------------------------------------

    def _turn(self, turning: Turning) -> None:
        command = turning.command
        left = abs(command.turn_rad) - abs(turning.turned_rad)
        step = math.copysign(min(command.speed_rad_s * TICK_S, max(0.0, left)), command.turn_rad)
        spindle = self._world.cell.object(turning.driver).spindle
        assert spindle is not None
        tip = geometry.compose(self._world.pose(turning.driver), spindle.frame.pose)
        bolt = self._engaged(tip)
        turned, torque_nm = (step, 0.0) if bolt is None else self._against(bolt, turning, step)
        turning.turned_rad += turned
        turning.torque_nm = math.copysign(torque_nm, command.turn_rad)
        if torque_nm:
            self._react(turning, tip)
        if bolt is not None:
            self._centre(turning.driver, bolt, tip)

    def _engaged(self, tip: geometry.Array) -> Bolt | None:
        """The bolt on whose head the tip of a spindle is."""
        for bolt in self._bolts.values():
            off = geometry.relative(self._world.pose(bolt.name), tip)
            opposed = math.acos(max(-1.0, min(1.0, -float(geometry.rotate(off, (0.0, 0.0, 1.0))[2]))))
            if abs(off[2]) < NEAR_M and math.hypot(off[0], off[1]) < ASIDE_M and opposed < TILTED_RAD:
                return bolt
        return None

    def _against(self, bolt: Bolt, turning: Turning, step: float) -> tuple[float, float]:
        """Turn a bolt by up to `step` rad, positive inwards: (turn of the spindle, magnitude of the torque)."""
        if bolt.stripped or (bolt.free and step < 0.0):
            return step, STRIPPED_NM if bolt.stripped else 0.0
        seated = bolt.out_rad <= 0.0 and step > 0.0
        if not (seated or bolt.tight_nm):
            turning.wound_rad = 0.0
            bolt.out_rad = max(0.0, bolt.out_rad - step)
            self._world.move_out(bolt.name, bolt.thread.pitch_m * bolt.out_rad / math.tau)
            return step, bolt.thread.running_nm
        wound = turning.wound_rad + abs(step)
        torque_nm = bolt.thread.running_nm + STIFF_NM_RAD * wound
        if torque_nm > turning.command.torque_nm:  # it stalls
            return 0.0, turning.command.torque_nm
        turning.wound_rad = wound
        if step > 0.0:
            bolt.tight_nm = max(bolt.tight_nm, torque_nm)
        elif torque_nm >= bolt.tight_nm:
            bolt.tight_nm = 0.0
        return 0.0, torque_nm

    def _centre(self, driver: str, bolt: Bolt, tip: geometry.Array) -> None:
        """Pull the tip towards the axis of the bolt."""
        body, client = self._world.objects[driver].id, self._world.client
        head = self._world.pose(bolt.name)
        along = geometry.rotate(head, (0.0, 0.0, 1.0))
        linear, angular = (np.asarray(v) for v in pybullet.getBaseVelocity(body, physicsClientId=client))
        speed = linear + np.cross(angular, tip[:3] - self._world.pose(driver)[:3])
        force = -SOCKET_N_M * (tip[:3] - head[:3]) - SOCKET_N_S_M * speed
        force -= (force @ along) * along
        force *= min(1.0, SOCKET_N / max(1e-9, float(np.linalg.norm(force))))
        pybullet.applyExternalForce(
            body, -1, force.tolist(), tip[:3].tolist(), pybullet.WORLD_FRAME, physicsClientId=client
        )

    def _react(self, turning: Turning, tip: geometry.Array) -> None:
        torque = -turning.torque_nm * geometry.rotate(tip, (0.0, 0.0, 1.0))
        body, client = self._world.objects[turning.driver].id, self._world.client
        pybullet.applyExternalTorque(
            body, -1, np.asarray(torque).tolist(), pybullet.WORLD_FRAME, physicsClientId=client
        )
