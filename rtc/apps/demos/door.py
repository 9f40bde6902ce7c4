"""Demo of contact: a door is opened, the module behind it is drawn out, put back by a compliant arm, the door closed.

One sentence per line of `STEPS`. The true door, force and module are checked against the simulator. The whole is drawn
as a film; the demo uses `rtc.client.client` as any user does.
"""

from __future__ import annotations

import math
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import msgspec
from rich.console import Console

from rtc.apps.demos.narrator import Narrator
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.drawing.scene import FilmFrame, true_scene
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import ClusterError, OutcomeKind
from rtc.spatial import geometry, hinges

CELL, DOOR, MODULE, BAY = "unbolted", "DOOR-2", "MACS-OLD", "BAY-2"
OPENED_DEG, WITHIN_DEG = 90.0, 3.0
DOOR_N = 15.0  # greatest force on the door
SEATED_M = 0.004
DRAWN_OUT_M = 0.23
COMMAND_S = 1800.0  # on a machine with many busy processes
FRAME_S = 0.5  # of simulated time between two frames
FILM_S = 3600.0  # limit of drawing
STEPS = [
    f"GRASP LEFT-END-EFF {DOOR} LATCH-PULL",
    f"OPEN {DOOR} BY {OPENED_DEG:g} DEG WITH LEFT-ARM REPORT FORCES",
    f"RELEASE {DOOR}",
    f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A",
    f"LIFT {MODULE} BY 25 CM WITH RIGHT-ARM",
    f"INSERT {MODULE} INTO {BAY} WITH RIGHT-ARM",
    "STOW RIGHT-ARM",
    f"GRASP LEFT-END-EFF {DOOR} LATCH-PULL",
    f"CLOSE {DOOR} REPORT FORCES",
    f"RELEASE {DOOR}",
    "STOW LEFT-ARM",
]


class Filming:
    """Takes a scene every FRAME_S of simulated time, in a thread with a client of its own."""

    def __init__(self, run_dir: Path) -> None:
        self.caption = ""
        self.frames: list[FilmFrame] = []
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._take, args=(run_dir,), daemon=True)

    def __enter__(self) -> Filming:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join(5.0)

    def _take(self, run_dir: Path) -> None:
        due_s = 0.0
        with Client(run_dir) as rtc:
            while not self._done.wait(0.04):
                try:
                    truth = rtc.truth()
                except ClusterError:
                    return
                if truth.sim_s >= due_s and self.caption:
                    due_s = truth.sim_s + FRAME_S
                    self.frames.append(FilmFrame(scene=true_scene(truth), caption=self.caption))


def run(console: Console, speed: str = "1", out: Path = Path("out")) -> bool:
    """Run the demo; True if every check passed. Writes door.gif to `out`; ends all processes."""
    narrator = Narrator(console)
    narrator.chapter("A satellite with a closed bay: a door with a hinge, the old module behind it")
    with own_cluster(cell=CELL, speed=speed) as run_dir, Client(run_dir) as rtc, Filming(run_dir) as filming:
        _run(narrator, rtc, filming)
    narrator.chapter("The film of it")
    file = out / "door.gif"
    narrator.check(f"film {file} of {len(filming.frames)} frames", _draw(filming.frames, file))
    return narrator.passed()


def _run(narrator: Narrator, rtc: Client, filming: Filming) -> None:
    home = Cell.load(CELL).object(DOOR).frame.pose
    for text in STEPS:
        filming.caption = text.partition(" REPORT")[0]
        narrator.line(text)
        ended = rtc.run(text, timeout_s=COMMAND_S)
        if not narrator.check(
            f"{ended.command} {ended.outcome.kind.value} after {ended.took_s:.1f} s",
            ended.outcome.kind is OutcomeKind.SUCCEEDED,
        ):
            narrator.line(ended.outcome.message)
            return
        if text.split()[0] in CHECKS:
            CHECKS[text.split()[0]](narrator, rtc.truth(), ended, home)


def _opened(narrator: Narrator, truth: m.SimTruthReply, ended: m.CommandEnded, home: geometry.Array) -> None:
    angle = _angle_deg(truth, home)
    narrator.check(f"the door stands at {angle:.1f} deg", abs(angle - OPENED_DEG) <= WITHIN_DEG)
    _gently(narrator, ended)


def _closed(narrator: Narrator, truth: m.SimTruthReply, ended: m.CommandEnded, home: geometry.Array) -> None:
    angle = _angle_deg(truth, home)
    narrator.check(f"the door is closed to {angle:.1f} deg", angle <= WITHIN_DEG)
    _gently(narrator, ended)


def _gently(narrator: Narrator, ended: m.CommandEnded) -> None:
    measured = ended.outcome.measured
    peak_n = measured.peak_force_n if measured is not None else None
    narrator.check(f"with at most {peak_n or math.nan:.1f} N", peak_n is not None and peak_n <= DOOR_N)


def _drawn_out(narrator: Narrator, truth: m.SimTruthReply, ended: m.CommandEnded, home: geometry.Array) -> None:
    out_m = geometry.distance(truth.poses[MODULE], Cell.load(CELL).seated_pose(BAY))
    narrator.check(f"{MODULE} is {1e3 * out_m:.0f} mm out of its bay", out_m > DRAWN_OUT_M)


def _seated(narrator: Narrator, truth: m.SimTruthReply, ended: m.CommandEnded, home: geometry.Array) -> None:
    off_m = geometry.distance(truth.poses[MODULE], Cell.load(CELL).seated_pose(BAY))
    narrator.check(f"{MODULE} is {1e3 * off_m:.1f} mm from its place, and let go", off_m <= SEATED_M)


CHECKS: dict[str, Callable[[Narrator, m.SimTruthReply, m.CommandEnded, geometry.Array], None]] = {
    "OPEN": _opened,
    "CLOSE": _closed,
    "LIFT": _drawn_out,
    "INSERT": _seated,
}


def _angle_deg(truth: m.SimTruthReply, home: geometry.Array) -> float:
    hinge = Cell.load(CELL).object(DOOR).hinge
    assert hinge is not None
    return math.degrees(hinges.angle_of(home, hinge.axis, truth.poses[DOOR]))


def _draw(frames: list[FilmFrame], file: Path) -> bool:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.unlink(missing_ok=True)
    data = file.with_suffix(".jsonl")
    data.write_bytes(b"\n".join(map(msgspec.json.encode, frames)))
    command = [
        sys.executable,
        "-P",
        "-m",
        "sim_mcm.cameras.film",
        "--frames",
        str(data),
        "--cell",
        CELL,
        "--out",
        str(file),
    ]
    try:
        subprocess.run(command, timeout=FILM_S, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, check=False)
    except subprocess.TimeoutExpired:
        return False
    finally:
        data.unlink()
    return file.is_file()
