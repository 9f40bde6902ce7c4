"""How a demo tells its story: a clock in front of every line, and checks that decide whether it passed."""

from __future__ import annotations

import time

from rich.console import Console
from rich.text import Text


class Story:
    def __init__(self, console: Console) -> None:
        self._console = console
        self._begun_s = time.monotonic()
        self._checks: list[tuple[str, bool]] = []

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._begun_s

    def chapter(self, title: str) -> None:
        self._console.print()
        self._print(title, "bold cyan")

    def line(self, text: str, style: str = "") -> None:
        self._print(text, style)

    def check(self, what: str, passed: bool) -> bool:
        """One thing that must be so; `what` carries the figures."""
        self._checks.append((what, passed))
        self._print(("PASS  " if passed else "FAIL  ") + what, "green" if passed else "bold red")
        return passed

    def passed(self) -> bool:
        """The last line: whether all checks passed (and there were some)."""
        failed = [what for what, passed in self._checks if not passed]
        good = bool(self._checks) and not failed
        word = "PASSED" if good else "FAILED"
        self._console.print()
        self._print(f"{word}: {len(self._checks) - len(failed)} of {len(self._checks)} checks", "bold")
        for what in failed:
            self._print(f"  not so: {what}", "red")
        return good

    def _print(self, text: str, style: str) -> None:
        self._console.print(Text(f"{self.elapsed_s:6.1f} s  ", style="dim").append(text, style=style))
