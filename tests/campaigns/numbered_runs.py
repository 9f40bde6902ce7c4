"""Runs of a campaign by their numbers: the first ones (`--runs`), or single ones again (`--only`)."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import TypeVar

from benchmarks.report import finish
from tests.campaigns import RESULTS

T = TypeVar("T")


def arguments(doc: str | None, runs: int = 100) -> argparse.ArgumentParser:
    words = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--runs", type=int, default=runs)
    words.add_argument("--only", type=int, nargs="+", help="these runs alone, without results file")
    return words


def chosen(given: argparse.Namespace, drawn: Iterable[T]) -> Iterator[tuple[int, T]]:
    """(number, conditions) of the runs to make. Earlier conditions are drawn too, so a number always has the same."""
    last = max(given.only) + 1 if given.only else given.runs
    return (one for one in enumerate(islice(drawn, last)) if not given.only or one[0] in given.only)


def report(name: str, metrics: dict[str, float | None], rows: list[tuple[str, str]], *, kept: bool) -> None:
    """Print the rows. `kept`: write the results file too; not for single runs and other laws."""
    if kept:
        finish(name, metrics, rows, RESULTS)
    else:
        print(rows)
