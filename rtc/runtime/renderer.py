"""Client of the renderer process, which is separate because drawing needs the physics library and takes long."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
from types import TracebackType

import msgspec

from rtc.cells.scene import Drawn, Picture
from rtc.protocol.outcomes import RtcError

COMMAND = [sys.executable, "-P", "-m", "sim_mcm.render", "--serve"]
NICENESS = 15  # the servo's ticks go first
LIMIT_S = 60.0  # for one picture on a slow, busy machine; it takes one or two seconds
END_S = 2.0


class Renderer:
    """Context manager; the process starts with it and ends with it. One picture at a time."""

    def __enter__(self) -> Renderer:
        self._process = subprocess.Popen(
            ["nice", "-n", str(NICENESS), *COMMAND],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is ours; it ends when its stdin does, also when we are killed
        )
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

    def draw(self, picture: Picture) -> None:
        """Returns once the file is there. Raises RtcError with the reason when it cannot be drawn."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(msgspec.json.encode(picture) + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            raise RtcError(f"the renderer ({' '.join(COMMAND[3:])}) has ended; is pybullet installed?") from None
        line = self._line(process.stdout.fileno())
        try:
            answer = msgspec.json.decode(line, type=Drawn)
        except msgspec.DecodeError:
            raise RtcError(f"the renderer ({' '.join(COMMAND[3:])}) has ended; is pybullet installed?") from None
        if answer.error:
            raise RtcError(f"no picture: {answer.error}")

    def _line(self, fd: int) -> bytes:
        """The next line of the renderer that is an answer: its libraries print, too. Empty at the end."""
        read = b""
        while not (lines := [line for line in read.split(b"\n")[:-1] if line.startswith(b"{")]):
            if not select.select([fd], [], [], LIMIT_S)[0]:
                raise RtcError(f"the renderer has not answered within {LIMIT_S:.0f} s")
            if not (more := os.read(fd, 1 << 16)):
                return b""
            read += more
        return lines[0]
