"""Correctness campaigns: long searches for lost, repeated or misreported work. Run: `python -m tests.campaigns.NAME`.

The suite runs short versions of `fuzz`, `two_arms`, `carry`, `model_check` and `simulation`. A campaign imports any
package of the project and no test file; its result file is `tests/campaigns/results/NAME.json`.
"""

from pathlib import Path

RESULTS = Path(__file__).parent / "results"
