"""Work that continues in copies of this process: what was prepared once need not be repeated."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_copies(work: Callable[[Item], Result], items: Iterable[Item], processes: int = 1) -> Iterator[Result]:
    """`work` of each item in a copy of this process that ends with it, at most so many at once, as they finish.

    A copy may itself make copies. Raises RuntimeError if one ends without a result.
    """
    context = multiprocessing.get_context("fork")
    left, running = list(items), dict[Connection, tuple[Item, BaseProcess]]()
    while left or running:
        while left and len(running) < processes:
            receiver, sender = context.Pipe(duplex=False)
            item = left.pop(0)
            process = context.Process(target=_send, args=(sender, work, item))
            process.start()
            sender.close()
            running[receiver] = (item, process)
        for ready in wait(list(running)):
            assert isinstance(ready, Connection)
            item, process = running.pop(ready)
            try:
                result = ready.recv()
            except EOFError:
                process.join()
                raise RuntimeError(f"no result of {item}: its process ended with {process.exitcode}") from None
            process.join()
            yield result


def _send(sender: Connection, work: Callable[[Any], Any], item: Any) -> None:
    sender.send(work(item))
