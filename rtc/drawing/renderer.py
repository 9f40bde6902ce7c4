"""Client of the renderer process, which is separate because drawing needs the physics library and takes long."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

import msgspec
import numpy as np
from numpy.typing import NDArray

from rtc.drawing.scene import CameraPicture, Drawn, Picture, SceneView
from rtc.protocol.outcomes import RtcError
from rtc.sensing.optics import Window

COMMAND = [sys.executable, "-P", "-m", "sim_mcm.cameras.render"]
NICENESS = 5  # as the workers: the ticks go first
ASKED_NICENESS = -10  # of a picture that a person has asked for, if it is permitted
LIMIT_S = 60.0  # for one picture on a slow, busy machine; it takes one or two seconds
END_S = 2.0


class Renderer:
    """Context manager; the process starts with it and ends with it. It draws in the order of the requests. Without the
    permission for a negative niceness the process has that of its parent. It has a session of its own, because a Linux
    with autogroups shares the processors among sessions: inside that of a shell its niceness would count for nothing.
    """

    def __init__(self, niceness: int = NICENESS) -> None:
        self._niceness = niceness

    def __enter__(self) -> Renderer:
        self._unread = b""
        self._folder = TemporaryDirectory(prefix="rtc-camera-")
        self._file = f"{self._folder.name}/pixels.npy"
        self._process = subprocess.Popen(
            ["nice", "-n", str(self._niceness), *COMMAND],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is ours; it ends when its stdin does, also when we are killed
        )
        with contextlib.suppress(OSError):  # not permitted, or a system without autogroups
            niceness = os.getpriority(os.PRIO_PROCESS, 0) + self._niceness
            Path(f"/proc/{self._process.pid}/autogroup").write_text(str(niceness))
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def draw(self, picture: Picture | CameraPicture) -> None:
        """Returns once the file is there. Raises RtcError with the reason when it cannot be drawn."""
        self.request(picture)
        if not self.drawn(LIMIT_S):
            load = os.getloadavg()[0]
            words = f"the picture is not drawn after {LIMIT_S:.0f} s; {load:.0f} processes compete for {os.cpu_count()}"
            raise RtcError(f"{words} processors: repeat it when the machine is less busy")

    def photograph(self, cell: str, camera: str, scene: SceneView, seed: int | None = None) -> NDArray[np.uint8]:
        """What a camera of the cell sees: height x width x 3. `seed`: of its noise. Raises RtcError."""
        return self._pixels(CameraPicture(out=self._file, cell=cell, camera=camera, scene=scene, seed=seed))

    def windows(
        self, cell: str, camera: str, scene: SceneView, windows: Sequence[Window]
    ) -> Sequence[NDArray[np.uint8]]:
        """Parts of what a camera of the cell sees: height x width x 3 each. Raises RtcError."""
        parts = [(window.x, window.y, window.width, window.height) for window in windows]
        flat = self._pixels(CameraPicture(out=self._file, cell=cell, camera=camera, scene=scene, windows=parts))
        ends = np.cumsum([3 * window.width * window.height for window in windows])
        pieces = np.split(flat, ends[:-1])
        return [one.reshape(window.height, window.width, 3) for one, window in zip(pieces, windows, strict=True)]

    def _pixels(self, picture: CameraPicture) -> NDArray[np.uint8]:
        self.draw(picture)
        pixels: NDArray[np.uint8] = np.load(picture.out)
        return pixels

    def request(self, picture: Picture | CameraPicture) -> None:
        """Order one picture, without waiting; call `drawn` once for each until it is there. Raises RtcError."""
        stdin = self._process.stdin
        assert stdin is not None
        try:
            stdin.write(msgspec.json.encode(picture) + b"\n")
            stdin.flush()
        except BrokenPipeError:
            raise _ended() from None

    def drawn(self, timeout_s: float) -> bool:
        """True if the requested file is there within `timeout_s`. Raises RtcError when it cannot be drawn."""
        stdout = self._process.stdout
        assert stdout is not None
        until_s = time.monotonic() + timeout_s
        while not (line := self._line()):
            if not select.select([stdout], [], [], max(0.0, until_s - time.monotonic()))[0]:
                return False
            if not (more := os.read(stdout.fileno(), 1 << 16)):
                raise _ended()
            self._unread += more
        answer = msgspec.json.decode(line, type=Drawn)
        if answer.error:
            raise RtcError(f"no picture: {answer.error}")
        return True

    def _line(self) -> bytes:
        """The next complete line that is an answer, or nothing: the libraries of the renderer print, too."""
        while b"\n" in self._unread:
            line, _, self._unread = self._unread.partition(b"\n")
            if line.startswith(b"{"):
                return line
        return b""


def _ended() -> RtcError:
    return RtcError(f"the renderer ({' '.join(COMMAND[3:])}) has ended; is pybullet installed?")
