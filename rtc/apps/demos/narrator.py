"""Output of a demo: lines with elapsed time, and checks that decide whether it passed."""

from __future__ import annotations

import time

from rich.console import Console
from rich.text import Text


class Narrator:
    """Prints the course of a demo and collects its checks."""

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
        """Record and print one check; `what` describes it, with its figures. Returns `passed`."""
        self._checks.append((what, passed))
        self._print(("PASS  " if passed else "FAIL  ") + what, "green" if passed else "bold red")
        return passed

    def passed(self) -> bool:
        """Print the summary; True if there were checks and all passed."""
        failed = [what for what, passed in self._checks if not passed]
        good = bool(self._checks) and not failed
        word = "PASSED" if good else "FAILED"
        self._console.print()
        self._print(f"{word}: {len(self._checks) - len(failed)} of {len(self._checks)} checks", "bold")
        for what in failed:
            self._print(f"  failed: {what}", "red")
        return good

    def _print(self, text: str, style: str) -> None:
        self._console.print(Text(f"{self.elapsed_s:6.1f} s  ", style="dim").append(text, style=style))
