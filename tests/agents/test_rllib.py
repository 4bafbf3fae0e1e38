"""RLlib on the native batch. It needs a separate virtual environment, because RLlib pins Gymnasium 1.2.2.

``python scripts/recipes/run.py rllib`` makes that in ``runs/recipes/rllib``: 5 minutes, a package index, 2 GB. Then
this takes a minute and three processes.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ENVIRONMENT = Path(os.environ.get("JACKBOX_RLLIB", ROOT / "runs" / "recipes" / "rllib"))
MISSING = f"RLLIB IS NOT TESTED: python scripts/recipes/run.py rllib makes {ENVIRONMENT}"


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(not (ENVIRONMENT / "ready").exists(), reason=MISSING)
def test_rllib_trains_on_two_runners_that_each_step_one_native_batch() -> None:
    command = [str(ENVIRONMENT / "bin" / "python"), "scripts/recipes/with_rllib.py", "--iterations", "4"]
    out = subprocess.check_output(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": ""}, text=True)
    assert "Stepping JackInBoxVectorEnv JackInBoxVectorEnv\n" in out
    steps, returns = zip(*re.findall(r"(\d+) steps, mean return (\S+)", out), strict=True)
    assert len(steps) == 4, out
    assert int(steps[-1]) >= 16_000
    means = [float(mean) for mean in returns if mean not in ("None", "nan")]  # where an episode ended
    assert len(means) >= 2
    assert 0.0 < min(means) <= max(means) < 500.0
