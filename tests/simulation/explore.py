"""All interleavings: breadth first through every move of the model, until nothing new is found or a bound is met.

In every state that is reached the invariants hold; otherwise the shortest path to it is reported. Every command can
still end: without further faults all of them do. That is proven by following the fair moves until a state is met from
which it is proven already.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import msgspec

from broker.decisions.decide import decide
from broker.decisions.effects import AcknowledgeReport, TellClient
from tests.simulation.arrivals import late
from tests.simulation.environment import first, happen
from tests.simulation.model import Model, Move, Scenario, Violation, decode, encode
from tests.simulation.moves import fair, moves
from tests.simulation.state_key import key

SETTLE_LIMIT = 400  # fair moves until everything must have ended


class Found(msgspec.Struct, kw_only=True):
    """How far an exploration came."""

    scenario: str
    states: int = 0
    transitions: int = 0
    depth: int = 0
    complete: bool = False  # nothing was left to explore
    seconds: float = 0.0
    violation: str = ""
    path: list[Move] = []  # the shortest way to it


def explore(
    scenario: Scenario,
    *,
    depth: int = 1000,
    states: int = 10_000_000,
    seconds: float = 1e9,
    progress: Callable[[Found], None] = lambda found: None,
) -> Found:
    """Every state within `depth` moves of the start, or until so many states or seconds."""
    began = time.perf_counter()
    start = first(scenario)
    core, name = key(start)
    came: dict[bytes, tuple[bytes, Move] | None] = {name: None}
    settles: set[bytes] = set()
    frontier = [(name, encode(start))]
    found = Found(scenario=scenario.name, states=1)
    while frontier and found.depth < depth and not found.violation:
        following: list[tuple[bytes, bytes]] = []
        for here, packed in frontier:
            for move in moves(decode(packed), scenario):
                model = decode(packed)
                found.transitions += 1
                try:
                    happen(model, scenario, move)
                    core, name = key(model)
                    if name in came:
                        continue
                    body = encode(model)
                    nothing_late_counts(decode(body))
                    if core not in settles:
                        settle(decode(body), scenario, settles)
                except AssertionError as error:
                    found.violation = str(error) or repr(error)
                    found.path = [*_way(came, here), move, *getattr(error, "after", [])]
                    break
                came[name] = (here, move)
                following.append((name, body))
            found.states = len(came)
            found.seconds = time.perf_counter() - began
            if found.violation or found.seconds > seconds or found.states > states:
                following.clear()
                frontier.clear()
                break
        if not frontier:
            return found
        frontier = following
        found.depth += 1
        found.complete = not frontier
        progress(found)
    return found


def nothing_late_counts(model: Model) -> None:
    """What comes late or twice is answered at most, and changes nothing. Raises Violation."""
    before, _ = key(model)
    for event in late(model):
        done = [e for e in decide(model.du, event) if not isinstance(e, AcknowledgeReport | TellClient)]
        if done or key(model)[0] != before:
            raise Violation(f"late, and it counts: {event}")


def settle(model: Model, scenario: Scenario, settles: set[bytes]) -> None:
    """Nothing goes wrong any more: every command must end and let go of everything. Raises Violation."""
    trail: list[bytes] = []
    moves: list[Move] = []
    while True:
        core, _ = key(model)
        if core in settles:
            break
        trail.append(core)
        move = fair(model, scenario)
        if move is None:
            left = _left_over(model)
            if left:
                raise _after(moves, Violation(f"nothing more happens, and {'; '.join(left)}"))
            break
        moves.append(move)
        try:
            happen(model, scenario, move, paid=False)
            if len(trail) > SETTLE_LIMIT:
                raise Violation("it goes on and on")
        except AssertionError as error:
            raise _after(moves, error) from None
    settles.update(trail)


def _after(moves: list[Move], error: AssertionError) -> Violation:
    violation = Violation(str(error) or repr(error))
    violation.after = moves
    return violation


def _left_over(model: Model) -> list[str]:
    du = model.du
    left = [f"{c.id} is still {c.phase.value}" for c in du.commands.values()]
    r = du.resources
    left += [f"{what} is not empty: {it}" for what, it in (
        ("held", r.held), ("waiting", r.waiting), ("holders", r.holders), ("lines", r.lines),
        ("alone", r.alone), ("quarantine", r.quarantine), ("awaiting", du.awaiting), ("joining", du.joining),
        ("deferred", du.deferred_analyses),
    ) if it]  # fmt: skip
    missing = {f"C-{n}" for n in range(1, du.accepted + 1)} - set(du.ended)
    left += [f"{command} has no outcome" for command in sorted(missing)]
    return left


def _way(came: dict[bytes, tuple[bytes, Move] | None], here: bytes) -> list[Move]:
    path: list[Move] = []
    step = came[here]
    while step is not None:
        path.append(step[1])
        step = came[step[0]]
    return path[::-1]


def in_words(move: Move) -> str:
    if move[0] == "broker dies":
        when = "before the journal has it" if move[1] is None else f"with {move[1]} of its effects out"
        return f"broker dies {when}: [{in_words(move[2])}]"
    return " ".join(str(part) for part in move)


def describe(found: Found, scenario: Scenario) -> str:
    """A violation, and the shortest way there: each move with what the Decision Unit did about it."""
    from tests.broker.harness import brief

    model = first(scenario)
    lines = [f"{scenario.name}: {found.violation}", "the shortest way there:"]
    for n, move in enumerate(found.path, 1):
        try:
            effects = happen(model, scenario, move, paid=False)
            done = "; ".join(brief(e) for e in effects if not brief(e).startswith("note"))
        except AssertionError as error:
            done = f"!! {error}"
        lines.append(f"  {n:3}. {in_words(move):<40} {done}")
    return "\n".join(lines)
