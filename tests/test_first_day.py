"""The README's training and evaluation, as a person tries them: in an empty home and a folder of their own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_package import blocks

ROOT = Path(__file__).parents[1]
pytest.importorskip("stable_baselines3")


@pytest.mark.slow
def test_the_readmes_training_and_evaluation_succeed_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    environment = {**os.environ, "HOME": str(tmp_path / "home"), "USERPROFILE": str(tmp_path / "home")}

    def python(*words: str) -> str:
        ended = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stderr
        assert "Traceback" not in ended.stderr
        return ended.stdout

    python("-c", blocks(ROOT / "README.md")[0].replace("learn(500_000,", "learn(20_000,"))
    (evaluate,) = re.findall(r"^jackbox (evaluate .*?)  #", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert "juggler.zip" in python("-m", "jackbox_env", *evaluate.split(), "--episodes", "2")
    assert (tmp_path / "juggler.gif").stat().st_size > 100_000
