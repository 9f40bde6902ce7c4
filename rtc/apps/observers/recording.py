"""An MCAP file of one run: what viewers of robots know as protobuf, our own messages as JSON with their schemas.

    /tf  /joint_states  /log  /events     foxglove.FrameTransforms, JointStates, Log, Event
    /picture                              foxglove.CompressedImage, if wanted: the believed scene, drawn
    /rtc/commands                         CommandRecord, once the recorder has seen the command
    /rtc/progress                         every ProgressNote
    /rtc/outcomes                         CommandEnded, with its refusal if it was refused
    /rtc/refusals                         RequestRefused: a request that did not become a command
    /rtc/halts                            HaltRequested: a halt that is not a sentence
    /rtc/arms/NAME                        ArmSample: joints, wrench, tcp pose, hand width
    /rtc/status                           the broker's status, JSON without a schema

The URDFs of the arms and the cell are attachments. Chunks are small and written every FLUSH_S, so that the file of a
killed recorder is readable up to then. `log_time` is the time of receipt, `publish_time` that of the message; both are
Unix time in ns.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import msgspec
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Event_pb2 import Event
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from rtc.apps.observers.feed import Received
from rtc.apps.observers.frames import WORLD, ArmFrames, urdf_of
from rtc.apps.observers.viewer_schema import viewer_schema
from rtc.drawing.scene import believed
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.runtime.process import Every
from rtc.wording.notes import in_words

CHUNK_BYTES = 64 << 10  # of a chunk before compression
FLUSH_S = 0.5  # longest time that a received message is only in memory
STILL_S = 1.0  # period of samples of arms that do not move
MOVED = 1e-5  # rad or m; smaller changes count as standing still
CAMERA = "camera"  # frame of the pictures; it has no pose, because they are drawn for people
HEADER = "rtc"  # name of the metadata record
LEVEL = {OutcomeKind.SUCCEEDED: Log.INFO, OutcomeKind.HALT_NOT_CONFIRMED: Log.ERROR}


class Recording:
    """Writes one file. `about`: facts of the run for the metadata record. `rate_hz`: maximum rate of arm samples.

    Raises FileExistsError, and OSError when the disk is full.
    """

    def __init__(self, path: Path, cell: Cell, about: dict[str, str], *, rate_hz: float, shares_clock: bool) -> None:
        self._file = open(path, "xb")  # noqa: SIM115  closed by `close`
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._offset_ns = time.time_ns() - time.monotonic_ns()  # Unix time minus CLOCK_MONOTONIC
        self._shares_clock = shares_clock  # times in messages are of this machine's clock
        self._frames = {arm.name: ArmFrames(cell, arm.name) for arm in cell.arms}
        self._cell = cell
        self._facts: dict[str, m.Fact] = {}
        self._period_s = 1.0 / rate_hz
        self._sampled_s, self._last_values = 0.0, dict[str, float]()
        self._flush = Every(FLUSH_S)
        self.events = self.samples = 0  # number of those written
        self._arms: dict[str, m.ArmSample] = {}  # the latest of each arm
        self._writer.start()
        self._writer.add_metadata(HEADER, about)
        now_ns = time.time_ns()
        for arm in cell.arms:
            self._writer.add_attachment(now_ns, now_ns, f"{arm.name}.urdf", "application/xml", urdf_of(cell, arm.name))
        self._writer.add_attachment(now_ns, now_ns, "cell.json", "application/json", cell.encode())
        self._writer.flush()  # type: ignore[no-untyped-call]

    def take(self, received: Received) -> None:
        """Write one message."""
        match received.message:
            case m.ProgressNote() as note:
                self._take_note(received.at_s, note)
            case m.CommandEnded() as ended:
                self._take_end(received.at_s, ended)
            case m.RequestRefused() as refused:
                self._take_refusal(received.at_s, refused)
            case m.HaltRequested() as halt:
                self._take_halt(received.at_s, halt)
            case m.Telemetry() as telemetry:
                self._take_sample(received.at_s, telemetry)
            case m.CommandRecord() as record:
                self._write_json("/rtc/commands", record, received.at_s, record.accepted_at_s)
            case m.View(facts=facts):
                self._facts |= {fact.key: fact for fact in facts}
            case m.StatusReply(status=status):
                self._take_status(received.at_s, status)

    def log(self, at_s: float, message: str, *, name: str = "recorder", level: Log.Level.ValueType = Log.INFO) -> None:
        """A line for people."""
        line = Log(timestamp=self._stamp(at_s), level=level, name=name, message=message)
        self._write_protobuf("/log", line, at_s, at_s)

    def add_picture(self, at_s: float, published_s: float, data: bytes, kind: str) -> None:
        """Write an encoded picture of the scene. `kind`: jpeg or png; `published_s`: time of what it shows."""
        stamp = self._stamp(self._own(at_s, published_s))
        image = CompressedImage(timestamp=stamp, frame_id=CAMERA, data=data, format=kind)
        self._write_protobuf("/picture", image, at_s, published_s)

    def flush_if_due(self, now_s: float) -> None:
        if self._flush.due(now_s):
            self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    # --- messages -------------------------------------------------------------------------------------

    def _take_note(self, at_s: float, note: m.ProgressNote) -> None:
        self.events += 1
        self._write_json("/rtc/progress", note, at_s, note.at_s)
        words = ": ".join(filter(None, [note.phase.value, note.step, in_words(note)]))
        self.log(self._own(at_s, note.at_s), words, name=note.command, level=Log.WARNING if note.warning else Log.INFO)

    def _take_end(self, at_s: float, ended: m.CommandEnded) -> None:
        self.events += 1
        self._write_json("/rtc/outcomes", ended, at_s, ended.at_s)
        end_s = self._own(at_s, ended.at_s)
        outcome = ended.outcome
        words = f"{outcome.kind.value}: {ended.text}" + (f": {outcome.message}" if outcome.message else "")
        self.log(end_s, words, name=ended.command, level=LEVEL.get(outcome.kind, Log.WARNING))
        about = {"command": ended.command, "sentence": ended.text, "outcome": outcome.kind.value}
        about |= {"message": outcome.message, "step": outcome.step, "stop": outcome.stop.value if outcome.stop else ""}
        self._write_event(at_s, end_s - ended.took_s, end_s, about)

    def _take_refusal(self, at_s: float, refused: m.RequestRefused) -> None:
        self.events += 1
        self._write_json("/rtc/refusals", refused, at_s, refused.at_s)
        words = f"refused: {refused.text or 'a request'}: {refused.refusal.message}"
        self.log(self._own(at_s, refused.at_s), words, name=refused.request, level=Log.WARNING)

    def _take_halt(self, at_s: float, halt: m.HaltRequested) -> None:
        self.events += 1
        self._write_json("/rtc/halts", halt, at_s, halt.at_s)
        words = f"halt {halt.scope}" + (f" refused: {halt.refused}" if halt.refused else "")
        end_s = self._own(at_s, halt.at_s)
        self.log(end_s, words, name=halt.halt, level=Log.WARNING)
        about = {"halt": halt.halt, "scope": halt.scope, "refused": halt.refused}
        self._write_event(at_s, end_s, end_s, about)

    def _take_sample(self, at_s: float, telemetry: m.Telemetry) -> None:
        values: dict[str, float] = {}
        arms = self._arms = self._arms | telemetry.arms  # each subsystem reports its own
        for name, arm in arms.items():
            if (frames := self._frames.get(name)) is not None:
                values |= frames.values(arm.joints, arm.hand_width_m)
        moved = any(abs(value - self._last_values.get(name, 1e9)) > MOVED for name, value in values.items())
        if at_s - self._sampled_s < (self._period_s if moved else STILL_S):
            return
        self._sampled_s, self._last_values = at_s, values
        self.samples += 1
        published_s, stamp = telemetry.at_s, self._stamp(self._own(at_s, telemetry.at_s))
        for name, arm in arms.items():
            self._write_json(f"/rtc/arms/{name}", arm, at_s, published_s)
        self._write_protobuf("/joint_states", _joint_states(stamp, values, arms), at_s, published_s)
        moves = [
            _transform(stamp, parent, child, pose)
            for frames in self._frames.values()
            for parent, child, pose in frames.transforms(values)
        ]
        for thing in believed(self._cell, self._facts, arms, None).objects:
            moves.append(_transform(stamp, WORLD, thing.name, thing.pose))
        self._write_protobuf("/tf", FrameTransforms(transforms=moves), at_s, published_s)

    def _write_event(self, at_s: float, start_s: float, end_s: float, about: dict[str, str]) -> None:
        metadata = [KeyValuePair(key=key, value=value) for key, value in about.items() if value]
        event = Event(start_time=self._stamp(start_s), end_time=self._stamp(end_s), metadata=metadata)
        self._write_protobuf("/events", event, at_s, end_s)

    def _take_status(self, at_s: float, status: m.Status) -> None:
        self._write("/rtc/status", msgspec.json.encode(status), at_s, at_s, "json", lambda: 0)

    # --- the file -------------------------------------------------------------------------------------

    def _own(self, received_s: float, published_s: float) -> float:
        """The time of a message on this machine's clock; that of its receipt if the sender has another clock."""
        return published_s if self._shares_clock else received_s

    def _ns(self, at_s: float) -> int:
        return int(at_s * 1e9) + self._offset_ns

    def _stamp(self, at_s: float) -> Timestamp:
        seconds, nanos = divmod(self._ns(at_s), 1_000_000_000)
        return Timestamp(seconds=seconds, nanos=nanos)

    def _write_json(self, topic: str, message: Any, at_s: float, published_s: float) -> None:
        def schema() -> int:
            name, body = f"rtc.{type(message).__name__}", msgspec.json.encode(viewer_schema(type(message)))
            return self._schemas.get(name) or self._register(name, "jsonschema", body)

        self._write(topic, msgspec.json.encode(message), at_s, published_s, "json", schema)

    def _write_protobuf(self, topic: str, message: Message, at_s: float, published_s: float) -> None:
        def schema() -> int:
            described = build_file_descriptor_set(type(message)).SerializeToString()
            return self._register(message.DESCRIPTOR.full_name, "protobuf", described)

        self._write(topic, message.SerializeToString(), at_s, published_s, "protobuf", schema)

    def _register(self, name: str, encoding: str, body: bytes) -> int:
        self._schemas[name] = self._writer.register_schema(name, encoding, body)
        return self._schemas[name]

    def _write(self, topic: str, body: bytes, at_s: float, published_s: float, encoding: str, schema: Any) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.register_channel(topic, encoding, schema())
        self._writer.add_message(channel, self._ns(at_s), body, self._ns(self._own(at_s, published_s)))


def _joint_states(stamp: Timestamp, values: dict[str, float], arms: dict[str, m.ArmSample]) -> JointStates:
    """Positions of all joints (rad, m); velocities (rad/s) of those that are measured."""
    speeds = {name: arm.velocities for name, arm in arms.items()}
    states = []
    for arm in arms:
        names = [name for name in values if name.startswith(f"{arm}/")]
        for n, name in enumerate(names):
            known = {"velocity": speeds[arm][n]} if n < len(speeds[arm]) else {}
            states.append(JointState(name=name, position=values[name], **known))
    return JointStates(timestamp=stamp, joints=states)


def _transform(stamp: Timestamp, parent: str, child: str, pose: Any) -> FrameTransform:
    x, y, z, qx, qy, qz, qw = (float(value) for value in pose)
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
