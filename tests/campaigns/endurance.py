"""Do all commands come to a true end, each done once, when a process of the cluster is killed every second?

    python -m tests.campaigns.endurance [--seconds 600] [--commands 500] [--every 1] [--kill any] [--speed 1]

A client sends commands to a real cluster (kinematic arms, real time), one after the other for each arm. 500 commands
take about five minutes. Every second SIGKILL kills one process; the supervisor is excluded, because the cluster ends
with it. The run ends when all commands have ended or the time is up. Then the results that the client received are
compared with the journal, the MCM's log and the true positions of the arms.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import Counter

from benchmarks.load.errands import ARMS, Errands
from benchmarks.load.verdict import JournalReader, Verdict, judge
from benchmarks.report import finish, percentile, question, spread
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.messages import Validity
from tests.campaigns import RESULTS
from tests.campaigns.chaos import VICTIMS, Chaos, Strike

SEED = 20
FAR_DEG = 50  # a command moves for more than a second
LOOK_S = 0.005
WORLD_ERROR_RAD = 0.01
BACK_LIMIT_S = 30.0


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.campaigns.endurance",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seconds", type=float, default=600.0, help="at most")
    parser.add_argument("--commands", type=int, default=500)
    parser.add_argument("--speed", default="1", help="of the arms: 1 as real ones, max as fast as possible")
    parser.add_argument("--every", type=float, default=1.0, help="seconds between two kills")
    parser.add_argument("--kill", default="any", choices=list(VICTIMS))
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    question(
        "endurance", f"do {given.commands} commands end truly with a kill every {given.every:g} s?", seed=given.seed
    )
    with own_cluster(mcm="kinematic", speed=given.speed) as run_dir:
        chaos, journal = Chaos(run_dir, random.Random(given.seed)), JournalReader(run_dir)
        journal.follow()
        began_s = time.monotonic()
        with Errands(run_dir, far_deg=FAR_DEG, nonsense=False, how_many=given.commands) as errands:
            next_s = began_s + given.every
            while errands.running and time.monotonic() - began_s < given.seconds:
                if time.monotonic() >= next_s:
                    next_s += given.every
                    chaos.strike(given.kill)
                    if len(chaos.strikes) % 20 == 0:
                        print(
                            f"  {time.monotonic() - began_s:.0f} s: {len(errands.done)} commands ended, "
                            f"{len(chaos.strikes)} kills",
                            flush=True,
                        )
                chaos.returned()
                time.sleep(LOOK_S)
        took_s = time.monotonic() - began_s
        while chaos.missing and time.monotonic() - began_s - took_s < BACK_LIMIT_S:
            chaos.returned()
            time.sleep(LOOK_S)
        journal.close()
        verdict = judge(errands.done, journal, run_dir, chaos.strikes)
        with Client(run_dir) as rtc:
            verdict.wrong += _false_beliefs(rtc)
    verdict.print_faults()
    _report(given.commands, took_s, chaos.strikes, errands, verdict)


def _false_beliefs(rtc: Client) -> list[str]:
    """Arms that the world says are where they are not. What it does not vouch for is no lie."""
    truth = rtc.truth()
    false = []
    for arm in ARMS:
        fact = next(fact for fact in rtc.world.view(keys=[f"{arm}.joints"]).facts)
        off = max(abs(a - b) for a, b in zip(fact.value, truth.joints[arm], strict=True))
        if fact.validity is Validity.VALID and off > WORLD_ERROR_RAD:
            false.append(f"{arm} is {off:.3f} rad from where the world believes it to be")
    return false


def _report(commands: int, took_s: float, strikes: list[Strike], errands: Errands, verdict: Verdict) -> None:
    killed = Counter(strike.name for strike in strikes)
    back_s = [strike.back_s for strike in strikes if strike.back_s is not None]
    held_up_s = [errand.ended_at_s - errand.sent_at_s for errand in errands.done]
    metrics: dict[str, float | None] = {
        "commands": len(errands.done),
        "kills": len(strikes),
        "seconds": took_s,
        "commands_lost": len(verdict.lost) + commands - len(errands.done),
        "commands_repeated": len(verdict.repeated),
        "wrong_outcomes": len(verdict.wrong),
        "outcomes_not_seen": len(verdict.not_seen),
        "command_p50_s": percentile(held_up_s, 50),
        "command_worst_s": max(held_up_s),
    }
    rows = [
        ("commands ended", f"{len(errands.done)} of {commands} in {took_s:.0f} s"),
        ("outcomes", ", ".join(f"{n} {kind}" for kind, n in verdict.outcomes.most_common())),
        ("kills", f"{len(strikes)}: {', '.join(f'{n} {name}' for name, n in killed.most_common())}"),
        ("back after", spread(back_s, 1e3, "ms")),
        ("a command took", spread(held_up_s)),
        (
            "lost, repeated, untrue",
            f"{metrics['commands_lost']}, {len(verdict.repeated)}, {len(verdict.wrong)}",
        ),
        ("not seen; missed batches of the journal", f"{len(verdict.not_seen)}; {verdict.missed}"),
    ]
    finish("endurance", metrics, rows, RESULTS)
    sys.exit(0 if verdict.faultless and not metrics["commands_lost"] else 1)


if __name__ == "__main__":
    main()
