"""Injected faults of the simulation: what is active, how it begins and how it is undone.

A fault acts where a real one would: on the body, the motor, the sensor or the loop. Executors and the broker do not
know it. Faults end with the process; displaced things stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any, cast

import msgspec

from rtc.model.cells.cell import Cell
from rtc.protocol import faults as f
from rtc.protocol.outcomes import PRIORITY, StopReason
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.subsystems.motion.arm import TICK_S, ArmInterface, HandCommand, Sample, Simulation
from rtc.subsystems.motion.executor import Executor
from rtc.subsystems.motion.modes import Mode

ALL = "ALL"
FARTHEST = 10.0  # m or rad, maximum displacement; pybullet fails at 1e300 m
FASTEST = 0.5  # m/s or rad/s, of a drifting object
DRIFT_TICKS = 5  # it is moved once in so many ticks
MAX_SENSED = 1000.0  # N or N.m, maximum offset of a sensor
MIN_SLOW_S, MAX_SLOW_S = 1e-4, 0.05  # per tick; more would count as a hung process
MOVED_M, MOVED_RAD = 0.001, 0.01  # a displaced object that is farther from there was moved since
IN_SEAT_M = 0.05  # an object that is nearer to its place in a seat is in it
WEAK_TICKS = 20  # the force of a weak hand falls once in so many ticks
WEAKEST_N_S = 100.0  # greatest loss of grip force
PRESSES_N = 1.0  # a smaller finger force is no grip

#: reasons with which a motion can be made to end: those of stop functions that find a fault
FORCED = [
    *(
        reason
        for reason, n in PRIORITY.items()
        if PRIORITY[StopReason.COLLISION] <= n <= PRIORITY[StopReason.OBJECT_LOST]
    ),
    StopReason.TIMEOUT,
    StopReason.NO_CONTACT,
]

#: The life of a fault: its checks, then a `yield`; its beginning, then a `yield` until it is undone. It returns a note
#: for the user, if there is one. Where it cannot be undone now, it yields the reason.
Course = Generator[str, None, Any]


class FaultRefused(Exception):
    """The fault cannot be injected or undone now; the text is the reason."""


class Injections:
    """The active faults of one simulation. `tick_s`: by which every tick is to be longer."""

    def __init__(self, cell: Cell, simulation: Simulation, executors: Mapping[str, Executor]) -> None:
        self._cell, self._simulation, self._executors = cell, simulation, executors
        self._active: dict[str, tuple[str, Course]] = {}  # name -> words, and what undoes it
        self.blind: set[str] = set()  # cameras
        self.tick_s = 0.0
        self.drifts: dict[str, list[float]] = {}  # object -> velocity
        self.ends: dict[str, f.ForcedEnd] = {}  # arm -> how its motion is to end
        self.hands: dict[str, f.MisreadHand | f.WeakHand] = {}  # name of the fault -> a fault that changes with time
        self._ticks = 0

    @property
    def advances(self) -> bool:
        """Whether a fault changes with time."""
        return bool(self.drifts or self.ends or self.hands)

    def advance(self) -> bool:
        """Move what drifts, and end what is to end; True if a fault has ended by that. Call it in every tick if
        `advances`."""
        read = [name for name, fault in self.hands.items() if self._hand_changes(fault)]
        for name in read:
            self._undo(name)
        executing = [fault for fault in self.ends.values() if self._executors[fault.arm].state is Mode.EXECUTING]
        for fault in executing:
            self._executors[fault.arm].halt(fault.reason, f"forced: {fault.words}")
            self._undo(fault.name)
        self._ticks += 1
        if self._ticks % DRIFT_TICKS == 0:
            for name, velocity in self.drifts.items():
                self._simulation.displace(name, [DRIFT_TICKS * TICK_S * part for part in velocity])
        return bool(executing or read)

    def _hand_changes(self, fault: f.MisreadHand | f.WeakHand) -> bool:
        """One tick of a hand that fails; True if its fault has ended by itself."""
        faulty = self._faulty(fault.arm)
        if isinstance(fault, f.MisreadHand):
            return not faulty.misreads
        if self._ticks % WEAK_TICKS == 0:
            faulty.weaken(WEAK_TICKS * TICK_S * fault.n_s)
        return False

    @property
    def active(self) -> list[str]:
        """In words, in the order of injection."""
        return [words for words, _ in self._active.values()]

    def inject(self, fault: f.AnyFault) -> str:
        """Returns the reason of a refusal, or ''."""
        course = COURSES[type(fault)](self, fault)
        try:
            next(course)
            if fault.name in self._active:
                self._undo(fault.name)
            next(course)
        except FaultRefused as refused:
            return str(refused)
        self._active[fault.name] = (fault.words, course)
        return ""

    def undo(self, name: str) -> tuple[str, str]:
        """Undo one fault by its name, or ALL. Returns the reason of a refusal, or '', and a note."""
        names = list(self._active) if name == ALL else [name]
        refused, notes = [], []
        for one in names:
            try:
                notes.append(self._undo(one))
            except FaultRefused as why:
                refused.append(str(why))
        return "; ".join(refused), "; ".join(filter(None, notes))

    def _undo(self, name: str) -> str:
        if name not in self._active:
            known = ", ".join(self._active) or "none"
            raise FaultRefused(f"{name} is not injected; active are: {known}")
        try:
            refused = next(self._active[name][1])
        except StopIteration as undone:
            del self._active[name]
            return undone.value or ""
        raise FaultRefused(refused)

    # --- one method per fault -----------------------------------------------------------------------------

    def _displace(self, fault: f.Displaced) -> Course:
        name, offset = fault.object, fault.offset
        if len(offset) != 6 or not all(abs(part) <= FARTHEST for part in offset):  # false for NaN too
            raise FaultRefused(f"offset: six finite numbers are required, none beyond {FARTHEST:g} m or rad")
        seats = [seat.name for seat in self._cell.seats]
        _known(name, [*(thing.name for thing in self._cell.objects), *seats], "object or seat")
        if name in seats and (inside := self._inside(name)):
            raise FaultRefused(f"{inside} is in {name}: displace {inside}, and its seat moves with it")
        holders = [arm for arm, held in self._simulation.held().items() if name in held]
        if holders:
            raise FaultRefused(f"{name} is held by {', '.join(holders)}")
        yield ""
        if error := self._simulation.displace(name, offset):
            raise FaultRefused(error)
        there = self._true_pose(name)
        turned = geometry.inverse(geometry.from_rpy((0.0, 0.0, 0.0), offset[3:]))
        back = [*(-x for x in offset[:3]), *geometry.to_rpy(turned).tolist()]
        yield ""
        while True:
            here = self._true_pose(name)
            if geometry.distance(here, there) > MOVED_M or geometry.angle(here, there) > MOVED_RAD:
                return f"{name} was moved since, and stays where it is"
            if not (error := self._simulation.displace(name, back)):
                return None
            yield error

    def _true_pose(self, name: str) -> geometry.Floats:
        """Of an object or a seat."""
        truth = self._simulation.truth()
        return {**truth["poses"], **truth["seats"]}[name]

    def _inside(self, seat: str) -> str:
        """The object in a seat; empty: none."""
        truth = self._simulation.truth()
        place = geometry.compose(truth["seats"][seat], self._cell.seat(seat).module_frame.pose)
        poses = truth["poses"].items()
        return next((name for name, pose in poses if geometry.distance(pose, place) < IN_SEAT_M), "")

    def _drift(self, fault: f.Drifting) -> Course:
        velocity = fault.velocity
        if len(velocity) != 6 or not all(abs(part) <= FASTEST for part in velocity):  # false for NaN too
            raise FaultRefused(f"velocity: six finite numbers are required, none beyond {FASTEST:g} m/s or rad/s")
        _known(fault.object, (thing.name for thing in self._cell.objects), "object")
        yield ""
        self.drifts[fault.object] = list(velocity)
        yield ""
        del self.drifts[fault.object]

    def _stick(self, fault: f.StuckJoint) -> Course:
        _known(fault.arm, self._executors, "arm")
        joints = self._executors[fault.arm].arm.traits.joint_names
        _known(fault.joint, joints, f"joint of {fault.arm}")
        n = joints.index(fault.joint)
        yield ""
        self._simulation.stick(fault.arm, n, True)
        yield ""
        self._simulation.stick(fault.arm, n, False)

    def _falsify(self, fault: f.FalseSensor) -> Course:
        _known(fault.arm, self._executors, "arm")
        offset = fault.offset
        if offset is not None and (len(offset) != 6 or not all(abs(part) <= MAX_SENSED for part in offset)):
            raise FaultRefused(f"offset: six finite numbers are required, none beyond {MAX_SENSED:g} N or N.m")
        yield ""
        faulty = self._faulty(fault.arm)
        faulty.wrench, faulty.frozen = (faulty.read().wrench, True) if offset is None else (offset, False)
        yield ""
        faulty.wrench = None
        self._heal(fault.arm)

    def _jam(self, fault: f.JammedSeat) -> Course:
        _known(fault.seat, (seat.name for seat in self._cell.seats), "seat")
        yield ""
        self._simulation.jam(fault.seat, True)
        yield ""
        self._simulation.jam(fault.seat, False)

    def _blunt(self, fault: f.BluntSeat) -> Course:
        _known(fault.seat, (seat.name for seat in self._cell.seats), "seat")
        yield ""
        if error := self._simulation.blunt(fault.seat, True):
            raise FaultRefused(error)
        yield ""
        self._simulation.blunt(fault.seat, False)

    def _strip(self, fault: f.StrippedBolt) -> Course:
        bolts = [thing.name for thing in self._cell.objects if thing.thread is not None]
        if not bolts:
            raise FaultRefused(f"there is no bolt {fault.bolt}: the cell {self._cell.name} has no bolts")
        _known(fault.bolt, bolts, "bolt")
        yield ""
        if error := self._simulation.strip(fault.bolt, True):
            raise FaultRefused(error)
        yield ""
        self._simulation.strip(fault.bolt, False)

    def _drop(self, fault: f.FailedHand) -> Course:
        _known(fault.arm, self._executors, "arm")
        if fault.name not in self._active and not self._simulation.held()[fault.arm]:
            raise FaultRefused(f"{fault.arm} holds nothing")
        yield ""
        faulty = self._faulty(fault.arm)
        faulty.fail_hand(self._executors[fault.arm].hand)
        yield ""
        faulty.heal_hand()
        self._heal(fault.arm)

    def _misread(self, fault: f.MisreadHand) -> Course:
        _known(fault.arm, self._executors, "arm")
        yield ""
        self._faulty(fault.arm).misread()
        self.hands[fault.name] = fault
        yield ""
        del self.hands[fault.name]
        self._faulty(fault.arm).misreads = False
        self._heal(fault.arm)

    def _weaken(self, fault: f.WeakHand) -> Course:
        _known(fault.arm, self._executors, "arm")
        if not 0.0 < fault.n_s <= WEAKEST_N_S:  # false for NaN too
            raise FaultRefused(f"a hand can lose up to {WEAKEST_N_S:g} N/s of its force, not {fault.n_s:g}")
        yield ""
        self._faulty(fault.arm).grip(self._executors[fault.arm].hand)
        self.hands[fault.name] = fault
        yield ""
        del self.hands[fault.name]
        self._faulty(fault.arm).grip(None)
        self._heal(fault.arm)

    def _blind(self, fault: f.BlindCamera) -> Course:
        _known(fault.camera, (camera.name for camera in self._cell.cameras), "camera")
        yield ""
        self.blind.add(fault.camera)
        yield ""
        self.blind.discard(fault.camera)

    def _end(self, fault: f.ForcedEnd) -> Course:
        _known(fault.arm, self._executors, "arm")
        _known(fault.reason, FORCED, "reason to force")
        yield ""
        self.ends[fault.arm] = fault
        yield ""
        del self.ends[fault.arm]

    def _slow(self, fault: f.SlowLoop) -> Course:
        if not MIN_SLOW_S <= fault.tick_s <= MAX_SLOW_S:  # false for NaN too
            least, most = 1e3 * MIN_SLOW_S, 1e3 * MAX_SLOW_S
            raise FaultRefused(f"a tick can be slowed by {least:g} to {most:g} ms, not by {1e3 * fault.tick_s:g} ms")
        yield ""
        self.tick_s = fault.tick_s
        yield ""
        self.tick_s = 0.0

    # --- faulty arms --------------------------------------------------------------------------------------

    def _faulty(self, name: str) -> FaultyArm:
        """The faulty arm between an executor and its arm; put there if there is none."""
        executor = self._executors[name]
        if not isinstance(executor.arm, FaultyArm):
            executor.arm = cast(ArmInterface, FaultyArm(executor.arm))
        return cast(FaultyArm, executor.arm)

    def _heal(self, name: str) -> None:
        executor = self._executors[name]
        if isinstance(executor.arm, FaultyArm) and executor.arm.is_sound:
            executor.arm = executor.arm.sound


class FaultyArm:
    """An arm whose sensor or hand has failed. Everything else is that of the sound arm."""

    def __init__(self, sound: ArmInterface) -> None:
        self.sound = sound
        self.wrench: list[float] | None = None  # what the sensor reads too much, or always
        self.frozen = False
        self.misreads = False  # that its hand is closed on nothing, from when it closes on something until it opens
        self._reads_empty = False
        self._hand: HandCommand | None = None  # that it would obey if it had not failed
        self._grip: HandCommand | None = None  # of a hand that becomes weaker: as commanded
        self._lost_n = 0.0  # of its force since then

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sound, name)

    @property
    def is_sound(self) -> bool:
        return self.wrench is None and self._hand is None and not self.misreads and self._grip is None

    def read(self) -> Sample:
        sample = self.sound.read()
        if self.misreads:
            self._reads_empty = self._reads_empty or min(sample.finger_forces) > PRESSES_N
            if self._reads_empty:
                nothing = (0.0, 0.0)
                sample = msgspec.structs.replace(sample, fingers=nothing, finger_speeds=nothing, finger_forces=nothing)
        if self.wrench is None:
            return sample
        false = self.wrench if self.frozen else [a + b for a, b in zip(sample.wrench, self.wrench, strict=True)]
        return msgspec.structs.replace(sample, wrench=list(false))

    def command_hand(self, command: HandCommand) -> None:
        if self._hand is not None:
            self._hand = command
            return
        if self._reads_empty and command.width_m > 0.0:
            self.misreads = self._reads_empty = False
        if self._grip is not None:
            self.grip(command)
        self.sound.command_hand(command)

    def misread(self) -> None:
        self.misreads, self._reads_empty = True, False

    def grip(self, command: HandCommand | None) -> None:
        """It has the force of this command, which it then loses; None: it keeps its force from its next command on."""
        self._grip, self._lost_n = command, 0.0

    def weaken(self, by_n: float) -> None:
        grip = self._grip
        if grip is not None and grip.width_m == 0.0:
            self._lost_n += by_n
            self.sound.command_hand(HandCommand(grip.width_m, max(0.0, grip.force_n - self._lost_n), grip.speed_m_s))

    def fail_hand(self, command: HandCommand) -> None:
        self._hand = command
        traits = self.sound.traits
        self.sound.command_hand(HandCommand(traits.max_opening_m, traits.max_grip_n, traits.hand_speed_m_s))

    def heal_hand(self) -> None:
        command, self._hand = self._hand, None
        if command is not None:
            self.sound.command_hand(command)


def _known(name: str, known: Iterable[str], kind: str) -> None:
    if name not in (names := list(known)):
        raise FaultRefused(unknown(kind, name, names))


COURSES: dict[type, Callable[..., Course]] = {
    f.Displaced: Injections._displace,
    f.Drifting: Injections._drift,
    f.StuckJoint: Injections._stick,
    f.FalseSensor: Injections._falsify,
    f.JammedSeat: Injections._jam,
    f.BluntSeat: Injections._blunt,
    f.StrippedBolt: Injections._strip,
    f.FailedHand: Injections._drop,
    f.MisreadHand: Injections._misread,
    f.WeakHand: Injections._weaken,
    f.BlindCamera: Injections._blind,
    f.ForcedEnd: Injections._end,
    f.SlowLoop: Injections._slow,
}
