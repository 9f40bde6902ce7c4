"""Are cut links noticed within their limit, is nothing lost or repeated, and do halts stay as fast as before?

    python -m tests.campaigns.hosts [--cuts 20] [--delay-ms 50] [--jitter-ms 20]         # needs root

A real cluster (exact arms) in one network namespace, one worker of each kind in another, and a slow link. While
commands run on both arms, the link is cut and later restored. An arm is halted once with the link cut and once with it
up. At the end the link is cut for good and the workers behind it are killed. Two times are measured per worker: from
the cut until `rtc status` does not list it any more, and from the restoration until it is registered again. Then all
reported outcomes are compared with the journal and the MCM's log.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.load.errands import Errand, Errands
from benchmarks.load.two_hosts import TwoHosts, Unavailable, inside, two_hosts
from benchmarks.load.verdict import JournalReader, Verdict, judge
from benchmarks.report import finish, percentile, question, spread
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.runtime.keys import LINK_LIMIT_S
from tests.campaigns import RESULTS

SEED = 20
NODES = (4, 5, 6, 7)  # one worker of each kind on the other host
CUTS_S = (5.0, 10.0)  # durations of the cuts, alternating
LATER_S = 0.5  # maximum time from a job of a far worker to the cut
LOOK_S, GIVE_UP_S = 0.01, 60.0
MOVING_RAD_S = 0.05
AWAY = "MOVE RIGHT-ARM TO JOINTS -40 110 -160 0 50 0 DEG JOINT-MOTION"
STOW = "STOW RIGHT-ARM"


class Campaign:
    def __init__(self, hosts: TwoHosts, run_dir: Path, rtc: Client, rng: random.Random) -> None:
        self._hosts, self._run_dir, self._rtc, self._rng = hosts, run_dir, rtc, rng
        self.journal = JournalReader(run_dir)
        self.journal.follow()
        self.errands: list[Errand] = []
        self.noticed_s: list[float] = []
        self.back_s: list[float] = []
        self.halts_s: dict[str, list[float]] = {"cut": [], "up": []}
        self.unconfirmed = 0
        self._far = set(hosts.start_workers(run_dir, NODES))
        self._wait_until(lambda: self._far <= self._workers())

    def cut(self, for_s: float) -> None:
        """One cut in the middle of jobs, and the return."""
        with self._errands():
            self._wait_until(self._is_far_worker_busy)
            time.sleep(self._rng.uniform(0.0, LATER_S))
            cut_s = time.monotonic()
            self._hosts.cut()
            self.noticed_s += self._times(lambda there: self._far - there, cut_s)
        self._halt("cut")
        self._wait_until(lambda: time.monotonic() > cut_s + for_s)
        restored_s = time.monotonic()
        self._hosts.restore()
        self.back_s += self._times(lambda there: self._far & there, restored_s)
        self._halt("up")

    def die(self) -> None:
        """The link is cut for good in the middle of jobs, and the workers behind it die."""
        with self._errands():
            self._wait_until(self._is_far_worker_busy)
            self._hosts.cut()
            for name in self._far:
                self._hosts.kill(name)
            self._wait_until(lambda: not self._workers() & self._far)

    def verdict(self) -> Verdict:
        self.journal.close()
        return judge(self.errands, self.journal, self._run_dir, [])

    def stale(self) -> int:
        """Late results that gateway and broker have refused."""
        counters = self._rtc.status().counters
        return sum(n for name, n in counters.items() if name.endswith(("_stale", "dropped_results")))

    @contextlib.contextmanager
    def _errands(self) -> Iterator[None]:
        with Errands(self._run_dir, nonsense=False) as errands:
            yield
        self.errands += errands.done

    def _times(self, wanted: Callable[[set[str]], set[str]], began_s: float) -> list[float]:
        """The time of each far worker until it is in the wanted set."""
        found: dict[str, float] = {}

        def all_found() -> bool:
            for name in wanted(self._workers()):
                found.setdefault(name, time.monotonic() - began_s)
            return self._far <= found.keys()

        self._wait_until(all_found)
        return list(found.values())

    def _halt(self, link: str) -> None:
        """Halt a moving arm."""
        self._rtc.run(STOW, timeout_s=GIVE_UP_S)
        command = self._rtc.submit(AWAY)
        for sample in self._rtc.telemetry(silence_s=GIVE_UP_S):
            if max(map(abs, sample.arms["RIGHT-ARM"].velocities)) > MOVING_RAD_S:
                break
        result = self._rtc.halt("RIGHT-ARM")
        command.wait(timeout_s=GIVE_UP_S)
        if result.latency_s is None or not result.confirmed:
            self.unconfirmed += 1
        else:
            self.halts_s[link].append(result.latency_s)

    def _workers(self) -> set[str]:
        return {row.name for row in self._rtc.status().workers}

    def _is_far_worker_busy(self) -> bool:
        return any(row.busy_with and row.name in self._far for row in self._rtc.status().workers)

    def _wait_until(self, condition: Callable[[], bool]) -> None:
        end_s = time.monotonic() + GIVE_UP_S
        while not condition():
            if time.monotonic() > end_s:
                raise SystemExit(f"waited for {GIVE_UP_S:g} s in vain; workers: {sorted(self._workers())}")
            time.sleep(LOOK_S)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.campaigns.hosts",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--delay-ms", type=float, default=50.0, help="of the link, each way")
    parser.add_argument("--jitter-ms", type=float, default=20.0, help="of the delay, +-")
    given = parser.parse_args()
    question("hosts", f"are {given.cuts} cuts of a link to another host noticed, and is anything lost?", seed=SEED)
    try:
        with contextlib.ExitStack() as stack:
            hosts = stack.enter_context(two_hosts(given.delay_ms / 1e3, given.jitter_ms / 1e3))
            with inside(hosts.near):
                cluster = own_cluster(mcm="kinematic", listen=hosts.address, least=0, most=1)
                run_dir = stack.enter_context(cluster)
            rtc = stack.enter_context(Client(run_dir))
            campaign = Campaign(hosts, run_dir, rtc, random.Random(SEED))
            for n in range(given.cuts):
                campaign.cut(CUTS_S[n % len(CUTS_S)])
                print(f"  {n + 1} of {given.cuts}: noticed {spread(campaign.noticed_s)}", flush=True)
            campaign.die()
            verdict, stale = campaign.verdict(), campaign.stale()
    except Unavailable as why:
        raise SystemExit(f"no second host on this machine: {why}") from None
    _report(campaign, given.cuts, verdict, stale)


def _report(campaign: Campaign, cuts: int, verdict: Verdict, stale: int) -> None:
    verdict.print_faults()
    late = sum(took_s > LINK_LIMIT_S for took_s in campaign.noticed_s)
    halts = campaign.halts_s
    metrics: dict[str, float | None] = {
        "cuts": cuts,
        "noticed_p50_s": percentile(campaign.noticed_s, 50),
        "noticed_worst_s": max(campaign.noticed_s),
        "noticed_limit_s": LINK_LIMIT_S,
        "back_p50_s": percentile(campaign.back_s, 50),
        "back_worst_s": max(campaign.back_s),
        "halt_cut_p50_ms": percentile(halts["cut"], 50) * 1e3,
        "halt_cut_worst_ms": max(halts["cut"]) * 1e3,
        "halt_up_p50_ms": percentile(halts["up"], 50) * 1e3,
        "halt_up_worst_ms": max(halts["up"]) * 1e3,
        "halts_unconfirmed": campaign.unconfirmed,
        "stale_results_refused": stale,
        "commands": len(campaign.errands),
        "commands_lost": len(verdict.lost),
        "commands_repeated": len(verdict.repeated),
        "wrong_outcomes": len(verdict.wrong),
        "outcomes_not_seen": len(verdict.not_seen),
    }
    rows = [
        ("cut until noticed, per worker", f"{spread(campaign.noticed_s)}; {late} later than {LINK_LIMIT_S:g} s"),
        ("restored until registered", spread(campaign.back_s)),
        ("halt with the link cut", spread(halts["cut"], 1e3, "ms")),
        ("halt with the link up", spread(halts["up"], 1e3, "ms")),
        ("halts not confirmed", str(campaign.unconfirmed)),
        ("stale results refused", str(stale)),
        ("commands", f"{len(campaign.errands)}: {', '.join(f'{n} {k}' for k, n in verdict.outcomes.most_common())}"),
        ("lost, repeated, untrue", f"{len(verdict.lost)}, {len(verdict.repeated)}, {len(verdict.wrong)}"),
        ("not seen; missed batches of the journal", f"{len(verdict.not_seen)}; {verdict.missed}"),
    ]
    finish("hosts", metrics, rows, RESULTS)
    sys.exit(0 if verdict.faultless and not late and not campaign.unconfirmed else 1)


if __name__ == "__main__":
    main()
