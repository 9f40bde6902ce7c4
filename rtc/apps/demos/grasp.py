"""Demo of the main task: two arms grasp and lift a module each, are halted in motion, continue, put back and stow.

The results are checked against the simulator's true poses. The demo uses `rtc.client.client` as any user does; only
the checks query the simulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from rtc.apps.demos.narrator import Narrator
from rtc.apps.demos.own_cluster import own_cluster
from rtc.apps.demos.pictures import DemoPictures
from rtc.client.client import Client
from rtc.drawing.renderer import Renderer
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.spatial import geometry

CELL = "swapout"
HELD = {"RIGHT-ARM": "MACS-NEW", "LEFT-ARM": "MACS-OLD"}  # module that each arm carries
GRASPS = ["GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "GRASP LEFT-END-EFF MACS-OLD HANDLE-B"]
LIFTS = ["LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM", "LIFT MACS-OLD BY 15 CM WITH LEFT-ARM"]
MOVE = "MOVE RIGHT-ARM TO BAY-2-FRONT"
VERIFY = "VERIFY MACS-NEW AT RIGHT-END-EFF"
PLACES = ["PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM", "PLACE MACS-OLD ON RACK-2 WITH LEFT-ARM"]
STOWS = ["STOW RIGHT-ARM", "STOW LEFT-ARM"]

SLIP_M = 0.002  # maximum motion of a module in the hand during the lift
WORLD_ERROR_M = 0.005  # maximum difference of the world's fact from the true pose
LIFTED_M = 0.14  # minimum of the commanded 0.15
SEATED_M = 0.005  # maximum distance of a module from its seat at the end
STOWED_RAD = 0.01
UNDER_WAY_M = 0.08  # distance that the tool has moved at the call of the halt
# Limits for a machine with many busy processes.
COMMAND_S = 1800.0
REST_S = 60.0  # until the arm reports rest


@dataclass
class Overlap:
    """Receives progress notes; knows whether two commands executed at the same time."""

    narrator: Narrator
    executing: set[str] = field(default_factory=set)
    seen: bool = False

    def __call__(self, note: m.ProgressNote) -> None:
        if note.phase is m.Phase.EXECUTING:
            if note.command not in self.executing and note.step:
                self.narrator.line(f"{note.command}  {note.step}", "dim")
            self.executing.add(note.command)
        else:
            self.executing.discard(note.command)
        self.seen |= len(self.executing) > 1


def run(console: Console, speed: str = "1", out: Path = Path("out")) -> bool:
    """Run the demo; True if every check passed. Writes pictures to `out`; ends all processes."""
    narrator = Narrator(console)
    narrator.chapter("A cluster: broker, world database, four workers, and two arms in a physics simulator")
    with Renderer() as renderer:
        pictures = DemoPictures(out, renderer, CELL)
        with own_cluster(cell=CELL, speed=speed) as run_dir, Client(run_dir) as rtc:
            narrator.line(f"ready; {len(rtc.status().workers)} workers, run directory {run_dir}")
            _run(narrator, rtc, pictures)
        narrator.line("everything stopped")
        pictures.check(narrator)
    return narrator.passed()


def _run(narrator: Narrator, rtc: Client, pictures: DemoPictures) -> None:
    narrator.chapter("Two grasps at once; the cluster detects that they need different arms")
    if not _all(narrator, rtc, GRASPS, together=True):
        return
    gripped = rtc.truth()
    pictures.take("1-grasped", gripped)

    narrator.chapter("Lift both; the modules must follow their hands")
    if not _all(narrator, rtc, LIFTS, together=True):
        return
    _check_followed(narrator, gripped, lifted := rtc.truth())
    _check_world(narrator, rtc, lifted)
    pictures.take("2-lifted", lifted, camera="RACK-1")

    narrator.chapter(f"{MOVE}, and a halt in the middle of it")
    _check_halt(narrator, rtc)

    narrator.chapter("After a halt a carried object is in doubt: feel whether it is still in the hand, then continue")
    if not _all(narrator, rtc, [VERIFY]) or not _all(narrator, rtc, [MOVE]):
        return

    narrator.chapter("Put both back, and stow")
    if not _all(narrator, rtc, PLACES, together=True) or not _all(narrator, rtc, STOWS, together=True):
        return
    ended = rtc.truth()
    _check_put_back(narrator, gripped, ended)
    _check_stowed(narrator, rtc, ended)
    _check_world(narrator, rtc, ended)
    pictures.take("3-put-back", ended)


def _all(narrator: Narrator, rtc: Client, texts: list[str], *, together: bool = False) -> bool:
    """Submit these sentences and wait for them; False, with the reason printed, if one did not succeed."""
    overlap = Overlap(narrator)

    def accepted(n: int, command: str) -> None:
        narrator.line(f"{command}  submitted: {texts[n]}")

    def ended(_: int, end: m.CommandEnded) -> None:
        narrator.line(
            f"{end.command}  {end.outcome.kind.value} after {end.took_s:.1f} s  {end.outcome.message}".rstrip()
        )

    ends = rtc.run_many(texts, on_accept=accepted, on_progress=overlap, on_end=ended, timeout_s=COMMAND_S)
    good = all(end.outcome.kind is OutcomeKind.SUCCEEDED for end in ends)
    if not good:
        narrator.check(f"{' and '.join(text.split()[0] for text in texts)} succeeded", False)
    elif together:
        narrator.check(f"{texts[0].split()[0]} x {len(texts)}: both arms were in motion at the same time", overlap.seen)
    return good


def _check_halt(narrator: Narrator, rtc: Client) -> None:
    samples = rtc.telemetry(silence_s=5.0)
    start = next(samples).arms["RIGHT-ARM"].tcp_pose
    command = rtc.submit(MOVE)
    narrator.line(f"{command}  submitted: {MOVE}")
    for sample in samples:
        if math.dist(sample.arms["RIGHT-ARM"].tcp_pose[:3], start[:3]) > UNDER_WAY_M:
            break
    result = rtc.halt("RIGHT-ARM", timeout_s=REST_S)
    latency = "never" if result.latency_s is None else f"{result.latency_s * 1e3:.2f} ms"
    moving = ", ".join(result.moving) or "nothing"
    narrator.check(
        f"halt called in motion: {moving} began to decelerate after {latency}", result.moving == ["RIGHT-ARM"]
    )
    narrator.check("rest is confirmed", result.confirmed)
    ended = command.wait(COMMAND_S)
    narrator.check(f"{command} ended as {ended.outcome.kind.value}", ended.outcome.kind is OutcomeKind.HALTED)


def _check_followed(narrator: Narrator, before: m.SimTruthReply, after: m.SimTruthReply) -> None:
    for arm, module in HELD.items():
        slip_m = math.dist(_in_hand(before, arm, module), _in_hand(after, arm, module))
        rise_m = after.poses[module][2] - before.poses[module][2]
        narrator.check(f"{module} rose {rise_m * 1e3:.1f} mm with {arm}", rise_m > LIFTED_M)
        narrator.check(f"{module} moved {slip_m * 1e3:.2f} mm in the hand (limit {SLIP_M * 1e3:.0f})", slip_m <= SLIP_M)


def _in_hand(truth: m.SimTruthReply, arm: str, module: str) -> list[float]:
    """Position of the module's origin in tool axes."""
    return geometry.compose(geometry.inverse(truth.tcp[arm]), truth.poses[module])[:3].tolist()


def _check_world(narrator: Narrator, rtc: Client, truth: m.SimTruthReply) -> None:
    for module in HELD.values():
        fact = rtc.world.view(keys=[f"{module}.frame"]).facts[0]
        off_m = math.dist(fact.value[:3], truth.poses[module][:3])
        what = f"the world's pose of {module} is {off_m * 1e3:.2f} mm off ({fact.validity.value})"
        narrator.check(what, off_m <= WORLD_ERROR_M and fact.validity is m.Validity.VALID)


def _check_put_back(narrator: Narrator, before: m.SimTruthReply, after: m.SimTruthReply) -> None:
    for arm, module in HELD.items():
        off_m = math.dist(before.poses[module][:3], after.poses[module][:3])
        narrator.check(f"{module} is {off_m * 1e3:.1f} mm from where it was", off_m <= SEATED_M)
        narrator.check(f"{arm} holds nothing", not after.held.get(arm))


def _check_stowed(narrator: Narrator, rtc: Client, truth: m.SimTruthReply) -> None:
    for arm in Cell.load(rtc.settings.cell).arms:
        off_rad = max(abs(a - b) for a, b in zip(truth.joints[arm.name], arm.stow_rad, strict=True))
        narrator.check(f"{arm.name} is {off_rad:.4f} rad from its stow posture", off_rad <= STOWED_RAD)
