"""Phases of installed packages: a product passes through them before it leaves its worker (R144). Pure.

The program of a kind names them in `phases`, so a file that is loaded adds one, leaves one out, or changes their order.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar, cast

from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused

Product = TypeVar("Product")


def applied(names: Iterable[str], data: Any, product: Product) -> Product:
    """The product after all phases in their order. `data`: the input of the worker function. Raises Refused: a phase
    has refused it, has failed, or has returned something else."""
    for name in names:
        try:
            with registry.guarded(registry.PHASES, name):
                product = _checked(registry.installed(registry.PHASES)[name](data, product), product)
        except PluginError as error:
            clears = "rtc load a file without it in `phases`"
            raise Refused.because(RefusalReason.PROGRAM, str(error), where=name, clears=clears) from None
    return product


def _checked(found: Any, product: Product) -> Product:
    """What a phase has returned, as its reader will have it: a field of another type fails here, not on the way."""
    if isinstance(found, Refusal):
        raise Refused(found)
    if type(found) is not type(product):
        raise TypeError(f"it has returned {type(found).__name__}, not {type(product).__name__}")
    return cast("Product", wire.decoder(type(product))(wire.encode(found)))
