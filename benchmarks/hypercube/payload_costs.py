"""Times the real broker's turns with the long messages of real planners, by the kind of the event.

As `broker_costs`, with one command in each turn, the sentences of the real workload and the products of its planners.
*Beside*: the other arm executes meanwhile, so that the planners' jobs carry its motion. *Rebound*: the other arm has
begun to move since the job of the binder was created, so the step is bound again.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import msgspec

from benchmarks.hypercube import broker_costs
from benchmarks.hypercube.broker_costs import SETTLED, SLOW_S, STAGES, BrokerBench, Sent, TurnCost
from benchmarks.hypercube.costs import ALONE, BESIDE, REBOUND
from benchmarks.hypercube.motions import ARMS, Motions, named
from benchmarks.throughput import MOTIONS
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.messages import WorkerKind

Turns = Iterator[tuple[str, TurnCost | None]]  # kind of the event and cost


class MotionBench(BrokerBench):
    """A broker with one worker of each kind, and the arms of the cell. `arm`: that of the next sentence."""

    def __init__(self, folder: Path, motions: Motions) -> None:
        self._motions, self.arm = motions, 0
        self._bound = {
            (n, beside): motions.bound(n, motions.binder_input(n, beside=beside))
            for n in range(ARMS)
            for beside in (False, True)
        }
        super().__init__(folder, slots=1)

    def performers(self) -> list[str]:
        return self._motions.performers

    def sentence(self) -> str:
        return f"{MOTIONS[self.arm]} -- {self._number}"  # new words: a repeated sentence is not parsed again

    def product(self, kind: WorkerKind, job: m.Job) -> msgspec.Raw:
        if kind is WorkerKind.PARSER:
            return wire.raw(self._motions.record(MOTIONS.index(_read_text(job.input).text.partition(" -- ")[0])))
        if kind is WorkerKind.ELABORATOR:
            return wire.raw(self._motions.script(self.arm, bool(_read_task(job.input).moving)))
        if kind is WorkerKind.BINDER:
            data = _read_step(job.input)
            arm = self.performers().index(data.context.arm)
            return wire.raw(named(self._bound[arm, bool(data.moving)], data.primitive_id))
        return super().product(kind, job)

    # --- commands -----------------------------------------------------------------------------------------

    def through(self, arm: int) -> Turns:
        """Pass one command of this arm through all stages."""
        out = yield from self._begin(arm, STAGES[:4])
        yield from self._on(out, STAGES[4:])

    def beside(self, arm: int, other: int) -> Turns:
        """The same while the other arm executes; its own turns are not given."""
        executing = _quietly(self._begin(other, STAGES[:4]))
        yield from self.through(arm)
        _quietly(self._on(executing, STAGES[4:]))

    def rebound(self, arm: int, other: int) -> Turns:
        """Another arm begins to move while the step is bound; the turn in which that is found."""
        binding = _quietly(self._begin(arm, STAGES[:3]))
        executing = _quietly(self._begin(other, STAGES[:4]))
        self.arm = arm
        turn, out = self.turn(*self.answer(binding, "bound", SLOW_S), "bound")
        yield REBOUND, turn
        for sent in (out, executing):
            _quietly(self._on(sent, STAGES[3:] if sent is out else STAGES[4:]))

    def _begin(self, arm: int, stages: tuple[str, ...]) -> Any:
        """Give a sentence and pass its command through these stages; returns what the last one has sent."""
        self.arm = arm
        self._number += 1
        text = m.CommandText(request=str(self._number), text=self.sentence(), progress=False, sent_at_s=1.0)
        for parts in wire.together([text]):
            self.client.send_multipart(parts)
        turn, out = self.turn(1, 1, stages[0])
        yield stages[0], turn
        return (yield from self._on(out, stages[1:]))

    def _on(self, out: Sent, stages: tuple[str, ...]) -> Any:
        for stage in stages:
            turn, out = self.turn(*self.answer(out, stage, SLOW_S), stage)
            yield stage, turn
        return out


def _quietly(turns: Any) -> Any:
    """Run to the end; what is returned there."""
    while True:
        try:
            next(turns)
        except StopIteration as ended:
            return ended.value


_read_text = wire.decoder(m.ParserInput)
_read_task = wire.decoder(m.ElaboratorInput)
_read_step = wire.decoder(m.BinderInput)


def measure(repetitions: int) -> dict[str, dict[str, float]]:
    """By condition and kind of event: processor time (s) of a turn with one event, more than in the trivial workload;
    both threads together."""
    usual = _medians(_trivial(repetitions))
    usual[REBOUND] = usual["bound"]
    found = {condition: _medians(turns) for condition, turns in _real(repetitions).items()}
    return {
        condition: {event: max(0.0, used_s - usual[event]) for event, used_s in by_event.items()}
        for condition, by_event in found.items()
    }


def _medians(turns: list[tuple[str, TurnCost | None]]) -> dict[str, float]:
    used_s: dict[str, list[float]] = {}
    for event, turn in turns:
        if turn is not None:
            used_s.setdefault(event, []).append(turn.main_s + turn.io_s)
    return {event: median(values) for event, values in used_s.items()}


def _real(repetitions: int) -> dict[str, list[tuple[str, TurnCost | None]]]:
    found: dict[str, list[tuple[str, TurnCost | None]]] = {ALONE: [], BESIDE: []}
    with tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        bench = MotionBench(Path(folder), Motions())
        try:
            with broker_costs.priority():
                for n in range(-SETTLED, repetitions):
                    arm, other = n % ARMS, (n + 1) % ARMS
                    alone = [*bench.through(arm)]
                    beside = [*bench.beside(arm, other), *bench.rebound(arm, other)]
                    if n >= 0:
                        found[ALONE] += alone
                        found[BESIDE] += beside
        finally:
            bench.close()
    return found


def _trivial(repetitions: int) -> list[tuple[str, TurnCost | None]]:
    found: list[tuple[str, TurnCost | None]] = []
    with broker_costs.bench(1) as broker, broker_costs.priority():
        for n in range(-SETTLED, repetitions):
            turns = [*zip(STAGES, broker.pass_through(1, SLOW_S), strict=False)]
            found += turns if n >= 0 else []
    return found
