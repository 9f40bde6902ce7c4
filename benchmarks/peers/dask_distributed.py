"""Dask distributed with four processes of one thread: each task gets the future of the one before it."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.peers import chain

WINDOW = 200  # commands in progress


def measure(sizes: Sequence[int], start: Callable[[], chain.Meter]) -> None:
    dask: Any = importlib.import_module("distributed")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # it logs errors for commands in progress at the end
    stages = sizes[1:]
    options = {"n_workers": len(stages), "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with dask.LocalCluster(**options) as cluster, dask.Client(cluster) as client:
        payload = bytes(sizes[0])

        def submit() -> Any:
            result: Any = payload
            for size in stages:
                result = client.submit(chain.work, size, result, pure=False)
            return result

        submit().result()
        under_way = dask.as_completed([submit() for _ in range(WINDOW)])
        meter = start()
        for _ in under_way:
            if not meter.ended():
                break
            under_way.add(submit())


if __name__ == "__main__":
    chain.main(measure)
