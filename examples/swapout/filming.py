"""A film of the swap-out, drawn by other processes at low priority while it goes on."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from rtc.apps.demos.narrator import Narrator
from rtc.client.client import Client
from rtc.drawing.scene import SceneView, true_scene
from rtc.protocol.outcomes import ClusterError

POLL_S = 0.04
FILM_S = 3600.0  # limit for a machine with many busy processes
ROOT = Path(__file__).parents[2]  # of the checkout


class FilmFrame(msgspec.Struct, frozen=True, kw_only=True):
    """One picture of a film (`film`): a scene, and lines of text below it."""

    scene: SceneView
    caption: str = ""


class FilmProgress(msgspec.Struct, frozen=True, kw_only=True):
    """What a film reports while it is drawn after its last frame: how many of its frames are drawn."""

    drawn: int
    frames: int


class Film:
    """A film of the true scene: context manager. `period_s`: of simulated time, between two frames."""

    def __init__(self, file: Path, cell: str, period_s: float) -> None:
        self.caption = ""  # below the next frames; always of as many lines
        self.frames = 0
        self._file, self._period_s = file, period_s
        self._done = threading.Event()
        file.parent.mkdir(parents=True, exist_ok=True)
        file.unlink(missing_ok=True)
        command = [sys.executable, "-m", "examples.swapout.film", "--cell", cell, "--out", str(file.absolute())]
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )

    def __enter__(self) -> Film:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()  # unless `check` has waited for it
        with self._process:  # waits, and closes its pipes
            pass

    @contextmanager
    def shooting(self, run_dir: Path) -> Iterator[None]:
        """Meanwhile a thread with a client of its own takes the frames, from the first caption on.

        Afterwards what is not drawn yet is drawn at normal priority."""
        thread = threading.Thread(target=self._shoot, args=(run_dir,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._done.set()
            thread.join(FILM_S)
            assert self._process.stdin is not None
            with suppress(BrokenPipeError):  # it has ended: `check` fails
                self._process.stdin.close()

    def check(self, narrator: Narrator) -> None:
        """Wait for the film, and print how much of it is drawn."""
        assert self._process.stdout is not None
        limit = threading.Timer(FILM_S, self._process.kill)
        limit.start()
        try:
            for line in self._process.stdout:
                if line.startswith(b"{"):  # the libraries of the processes that draw print, too
                    progress = msgspec.json.decode(line, type=FilmProgress)
                    narrator.line(f"film: {progress.drawn} of {progress.frames} frames drawn", "dim")
            self._process.wait()
        finally:
            limit.cancel()
        narrator.check(f"film {self._file} of {self.frames} frames", self._file.is_file())

    def _shoot(self, run_dir: Path) -> None:
        assert self._process.stdin is not None
        due_s = 0.0
        with Client(run_dir) as rtc:
            while not self._done.wait(POLL_S):
                try:
                    truth = rtc.truth()
                    if truth.sim_s >= due_s and self.caption:
                        due_s = truth.sim_s + self._period_s
                        frame = FilmFrame(scene=true_scene(truth), caption=self.caption)
                        self._process.stdin.write(msgspec.json.encode(frame) + b"\n")
                        self._process.stdin.flush()
                        self.frames += 1
                except (ClusterError, BrokenPipeError):
                    return
