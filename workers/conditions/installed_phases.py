"""Phases of installed packages: a product passes through them before it leaves its worker (R144). Pure.

The program of a kind names them in `phases`, so a file that is loaded adds one, leaves one out, or changes their order.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

from rtc.plugins import registry
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason, Refused

Product = TypeVar("Product")


def refuse_unknown(names: Iterable[str]) -> None:
    """Raises ProgramError if a phase is not one that this process can call."""
    for name in names:
        if name not in registry.installed(registry.PHASES):
            failed = registry.loaded(registry.PHASES).failed.get(name, "no installed package has it")
            raise ProgramError(f"$.phases: {name}: {failed}")


def applied(names: Iterable[str], data: Any, product: Product) -> Product:
    """The product after all phases in their order. `data`: the input of the worker function. Raises Refused: a phase
    has refused it, has failed, or has returned something else."""
    for name in names:
        try:
            found = registry.installed(registry.PHASES)[name](data, product)
        except Refused:
            raise
        except Exception as error:  # code of others
            raise _refused(name, f"has failed: {type(error).__name__}: {error}") from None
        if isinstance(found, Refusal):
            raise Refused(found)
        if type(found) is not type(product):
            raise _refused(name, f"has returned {type(found).__name__}, not {type(product).__name__}")
        product = found
    return product


def _refused(name: str, problem: str) -> Refused:
    return Refused.because(
        RefusalReason.PROGRAM,
        f"the phase {name} {problem}",
        where=name,
        clears="rtc load a file without it in `phases`",
    )
