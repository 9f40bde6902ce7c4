"""Does the broker stay as small as it was over many commands?

    python -m benchmarks.soak [--commands 100000] [--dim 2]

Trivial commands (`benchmarks.load`), journal on. The first tenth fills the bounded stores (outcomes kept for repeated
requests, records). Growth is counted from the second tenth to the last. Each is the median of its samples, because
each snapshot of the state takes some MB for a moment.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from benchmarks.load.client import LoadClient
from benchmarks.load.cluster import Running, cluster
from benchmarks.load.trivial import sentence
from benchmarks.report import RESULTS, finish, question
from rtc.protocol.outcomes import OutcomeKind

SAMPLE_EVERY = 500  # commands

Sample = tuple[int, float, float]  # commands done, broker MB, journal MB on disk


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commands", type=int, default=100_000)
    parser.add_argument("--dim", type=int, default=2)
    parser.add_argument("--window", type=int, default=1000, help="commands under way at a time")
    given = parser.parse_args()
    question("soak", f"does the broker grow over {given.commands} commands?")
    with cluster(given.dim) as running, LoadClient(running.settings, sentence, given.window) as client:
        samples = run(running, client, given.commands)
        outcomes = client.outcomes
    if outcomes != {OutcomeKind.SUCCEEDED: given.commands}:
        raise SystemExit(f"not every command succeeded: {dict(outcomes)}")
    most = max(samples, key=lambda sample: sample[2])
    tenths = [median_mb(samples, tenth, given.commands) for tenth in range(10)]
    draw(samples)
    finish(
        "soak",
        {"commands": given.commands, "broker_growth_mb": tenths[9] - tenths[1]},
        [
            ("broker at the start", f"{samples[0][1]:.1f} MB"),
            ("broker, median of each tenth", ", ".join(f"{megabytes:.1f}" for megabytes in tenths) + " MB"),
            ("journal on disk, at most", f"{most[2]:.1f} MB, after {most[0]} commands"),
        ],
    )


def run(running: Running, client: LoadClient, commands: int) -> list[Sample]:
    samples = [_sample(running, 0)]
    for done in client.finish(commands):
        client.latencies_s.clear()
        if done - samples[-1][0] >= SAMPLE_EVERY or done == commands:
            samples.append(_sample(running, done))
            if done // 10_000 > samples[-2][0] // 10_000:
                print(f"  {done} commands: broker {samples[-1][1]:.1f} MB", flush=True)
    return samples


def median_mb(samples: Sequence[Sample], tenth: int, commands: int) -> float:
    """The broker's memory in one tenth of the commands."""
    return median(mb for done, mb, _ in samples if tenth * commands <= 10 * done <= (tenth + 1) * commands)


def _sample(running: Running, done: int) -> Sample:
    journal = sum(file.stat().st_size for file in Path(running.run_dir).glob("journal.db*")) / 2**20
    return done, running.memory_mb("broker"), journal


def draw(samples: Sequence[Sample]) -> None:
    """results/soak.png; skipped without matplotlib."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot
    except ImportError:
        return
    figure, axes = pyplot.subplots(figsize=(7, 4))
    done = [sample[0] for sample in samples]
    axes.plot(done, [sample[1] for sample in samples], label="broker, resident memory")
    axes.plot(done, [sample[2] for sample in samples], label="journal on disk")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("commands done")
    axes.set_ylabel("MB")
    axes.legend()
    RESULTS.mkdir(exist_ok=True)
    figure.tight_layout()
    figure.savefig(RESULTS / "soak.png", dpi=120)


if __name__ == "__main__":
    main()
