"""What the gateway knows of its cluster now, and the open pages that get it. For one event loop; it waits for nothing.

It holds no state of its own: facts, status and commands come from the cluster again after a restart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

import msgspec

from rtc.apps.console.pages import FrameSlot, Mailbox
from rtc.apps.console.pose_frame import pack
from rtc.apps.console.scene import SceneBodies
from rtc.apps.console.story import Story
from rtc.apps.observers.feed import Received
from rtc.drawing.scene import believed, request_camera, true_scene
from rtc.language.completion import Names
from rtc.model.cells.cell import Cell
from rtc.model.cells.offers import CellNames
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.primitive_id import command_of
from rtc.protocol.rehearsal import Rehearsal
from rtc.wording.facts import stated, units_in

FRAME_S = 0.033  # shortest time between two frames
CLOCK_S = 0.002  # a smaller difference of clocks is not reported again
MAX_TESTS = 20  # commands of pages, TESTs and predictions that are kept
BEAT_S = 0.5  # without a change the last frame is sent again: a page that gets none has lost the link
TRUTH_S, STILL_TRUTH_S = 0.3, 1.5  # age from which on a truth is not shown: while an arm moves, and otherwise
#: what a page shows of the status
STATUS = (
    *("processes", "workers", "resources", "subsystems", "queues", "counters", "halts", "uptime_s", "cluster"),
    "surrenders",
)


Kept = TypeVar("Kept")


class Prediction(msgspec.Struct, frozen=True):
    """A TEST of a page that was feasible. `poses`: of what it changes; others are not numbers."""

    command: str
    text: str
    rehearsal: Rehearsal
    poses: list[float]


class Hub:
    """Takes what arrives, and hands it to the pages. `now`: CLOCK_MONOTONIC (s). `life`: names this gateway's run."""

    def __init__(self, cell: Cell, now: Callable[[], float], hello: Mapping[str, Any]) -> None:
        self.cell, self.bodies, self._units, self._now = cell, SceneBodies(cell), units_in(cell), now
        self.hello = hello
        self.story = Story([arm.name for arm in cell.arms], {arm.end_effector: arm.name for arm in cell.arms})
        self.facts: dict[str, m.Fact] = {}
        self.status = m.Status()
        self.status_at_s = 0.0
        self._of_pages: dict[str, None] = {}  # the last commands of pages
        self._tests: dict[str, m.CommandEnded] = {}  # the last TESTs of any client that were feasible
        self._predictions: dict[str, Prediction] = {}  # of those that are of a page
        self.truth: m.SimTruthReply | None = None
        self.moving: list[str] = []
        self.frames: set[FrameSlot] = set()
        self.boxes: set[Mailbox] = set()
        self._arms: dict[str, m.ArmSample] = {}
        self._measured_at_s = 0.0
        self._truth_at_s = -1e9
        self._frame_at_s = 0.0
        self._clock_s: float | None = None if hello.get("delay_s") is not None else 0.0
        self._number = 0
        self._rows: dict[str, Any] = {}
        self._last: tuple[list[float], list[float], bool] | None = None

    # --- what arrives ---------------------------------------------------------------------------------

    def take(self, batch: Iterable[Received]) -> None:
        for received in batch:
            match received.message:
                case m.Telemetry() as sample:
                    self._take_sample(sample)
                case m.View() as view:
                    self.facts |= {fact.key: fact for fact in view.facts}
                    if view.facts:
                        self._post({"facts": list(map(self._fact, view.facts)), "version": view.version})
                        self._drop_stale()
                case m.StatusReply(status=status):
                    self.status, self.status_at_s = status, received.at_s
                    self._post(self._status())
                case m.CommandRecord() as record:
                    self.story.take_record(record)
                case m.ProgressNote() | m.CommandEnded() | m.RequestRefused() | m.HaltRequested() as event:
                    self.story.take(event)
                    if isinstance(event, m.CommandEnded):
                        self._take_test(event)

    def take_of_page(self, command: str) -> None:
        """This command was submitted by a page. TESTs of other clients are not for pages."""
        _keep(self._of_pages, command, None)
        if command in self._tests:
            self._predict(self._tests[command])

    def take_truth(self, truth: m.SimTruthReply) -> None:
        self.truth, self._truth_at_s = truth, self._now()
        self._measured_at_s = truth.at_s or self._measured_at_s
        self._make_frame()

    def tick(self) -> None:
        """Call it 20 times per second: sends what has changed, and the last frame again if it is old."""
        if (change := self.story.flush()) is not None:
            for box in self.boxes:
                box.put(change)
        if (rows := self._arm_rows()) != self._rows:
            self._rows = rows
            self._post({"arms": rows})
        if self._now() > self._frame_at_s + BEAT_S:
            self._send_frame()

    # --- pages ----------------------------------------------------------------------------------------

    def anew(self) -> Iterator[bytes]:
        """All texts for a page that knows nothing."""
        yield _text({"hello": {**self.hello, "now_s": self._now()}})
        yield from self.story.since(0)
        yield _text({"facts": list(map(self._fact, self.facts.values())), "anew": True})
        yield _text(self._status())
        yield _text({"clock_s": self._clock_s or 0.0})
        yield _text({"moving": self.moving, "arms": self._arm_rows()})
        yield _text(self._predicted())

    def scene(self) -> bytes:
        """Names, shapes and colours of all bodies, once for each page."""
        cell = self.cell
        return _text(
            {
                "cell": cell.name,
                "bodies": self.bodies.rows,
                "arms": [
                    {"name": arm.name, "hand": arm.end_effector, "tcp": f"{arm.name}/{arm.tcp_link}"}
                    for arm in cell.arms
                ],
                "cameras": [camera.name for camera in cell.cameras],
                "subsystems": [one.name for one in cell.all_subsystems],
            }
        )

    def names(self) -> Names:
        """For completion: names of the cell, and commands in progress."""
        return CellNames(self.cell, lambda: [key for key in self.facts if "." not in key], lambda: self.story.live)

    # --- inside ---------------------------------------------------------------------------------------

    def _take_sample(self, sample: m.Telemetry) -> None:
        self._compare_clocks(sample.at_s)
        self._arms |= sample.arms
        moving = sorted(name for name, arm in self._arms.items() if arm.primitive)
        if moving != self.moving:
            self.moving = moving
            self._post({"moving": moving})
        self.story.take_performing((name, command_of(arm.primitive)) for name, arm in sample.arms.items())
        if not self.has_truth():  # otherwise the arms and objects of one instant, by the truth
            self._measured_at_s = sample.at_s
            self._make_frame()

    def _compare_clocks(self, at_s: float) -> None:
        """Over tcp: how far the clock of the subsystem is behind this one, by the sample with the shortest way."""
        delay_s = self.hello.get("delay_s")
        if delay_s is None:
            return
        behind_s = self._now() - at_s - delay_s
        if self._clock_s is None or behind_s < self._clock_s - CLOCK_S:
            self._clock_s = behind_s
            self._post({"clock_s": behind_s})

    def has_truth(self) -> bool:
        """Whether the truth is new enough to be shown."""
        return self._now() < self._truth_at_s + (TRUTH_S if self.moving else STILL_TRUTH_S)

    def _make_frame(self) -> None:
        if not self.frames or self._now() < self._frame_at_s + FRAME_S:
            return
        truth = self.truth if self.has_truth() else None
        arms = self._arms if truth is None else _as_measured(truth, self._arms)
        belief = self.bodies.poses(believed(self.cell, self.facts, arms, None).scene)
        shown = belief if truth is None else self.bodies.poses(true_scene(truth))
        self._last = shown, belief, truth is not None
        self._send_frame()

    def _send_frame(self) -> None:
        if self._last is None or not self.frames:
            return
        self._frame_at_s = self._now()
        self._number += 1
        shown, belief, true = self._last
        frame = pack(self._number, self._measured_at_s, self._frame_at_s, shown, belief, true=true)
        for slot in self.frames:
            slot.put(frame)

    def _take_test(self, ended: m.CommandEnded) -> None:
        if ended.outcome.rehearsal is None or ended.outcome.kind is not OutcomeKind.SUCCEEDED:
            return
        _keep(self._tests, ended.command, ended)
        if ended.command in self._of_pages:
            self._predict(ended)

    def _predict(self, ended: m.CommandEnded) -> None:
        rehearsal = ended.outcome.rehearsal
        assert rehearsal is not None
        facts = self.facts | {
            one.key: m.Fact(
                key=one.key, value=one.value, validity=m.Validity(one.validity), version=0, source="", at_s=0.0
            )
            for one in rehearsal.changes
        }
        scene = believed(self.cell, facts, {}, None).scene
        changed = {one.key.rpartition(".")[0] for one in rehearsal.changes}
        poses = self.bodies.poses(scene, only=changed)
        _keep(self._predictions, ended.command, Prediction(ended.command, ended.text, rehearsal, poses))
        self._post(self._predicted())

    def _drop_stale(self) -> None:
        """A prediction is gone when a fact that it relies on has changed."""
        fresh = {command: one for command, one in self._predictions.items() if self._is_fresh(one)}
        if len(fresh) < len(self._predictions):
            self._predictions = fresh
            self._post(self._predicted())

    def _is_fresh(self, prediction: Prediction) -> bool:
        relies_on = prediction.rehearsal.relies_on.items()
        return all(key not in self.facts or self.facts[key].version == version for key, version in relies_on)

    def _arm_rows(self) -> dict[str, Any]:
        """Of each arm what a page shows in figures: grant and request of the operator, forces, width of the hand; the
        camera for the picture of a request."""
        return {
            name: {
                "primitive": arm.primitive,
                "wrench": [round(value, 1) for value in arm.wrench],
                "hand_width_m": round(arm.hand_width_m, 4),
                "operation": _rounded(arm.operation),
                "camera": "" if arm.operation is None else request_camera(self.cell.cameras, name, arm),
            }
            for name, arm in self._arms.items()
        }

    def _predicted(self) -> dict[str, Any]:
        return {"predictions": list(self._predictions.values())}

    def _fact(self, fact: m.Fact) -> dict[str, Any]:
        return {
            "key": fact.key,
            "words": stated(fact, self._units),
            "value": fact.value,
            "validity": fact.validity,
            "version": fact.version,
            "source": fact.source,
            "at_s": fact.at_s,
        }

    def _status(self) -> dict[str, Any]:
        return {"status": {key: getattr(self.status, key) for key in STATUS}, "at_s": self.status_at_s}

    def _post(self, message: Mapping[str, Any]) -> None:
        if self.boxes:
            text = _text(message)
            for box in self.boxes:
                box.put(text)


def _keep(kept: dict[str, Kept], command: str, one: Kept) -> None:
    kept[command] = one
    if len(kept) > MAX_TESTS:
        del kept[next(iter(kept))]


def _rounded(operation: m.TeleopState | None) -> m.TeleopState | None:
    """With the distance to a tenth of a millimetre, so that an arm at rest changes nothing."""
    if operation is None or operation.off_m is None:
        return operation
    return msgspec.structs.replace(operation, off_m=round(operation.off_m, 4))


def _text(message: Mapping[str, Any]) -> bytes:
    return msgspec.json.encode(message)


def _as_measured(truth: m.SimTruthReply, measured: Mapping[str, m.ArmSample]) -> dict[str, m.ArmSample]:
    """The arms as the simulator has them, which is what it measures, at the instant of its objects."""
    return {
        name: msgspec.structs.replace(
            sample, joints=truth.joints[name], tcp_pose=truth.tcp[name], hand_width_m=sum(truth.fingers[name])
        )
        for name, sample in measured.items()
        if name in truth.joints
    }
