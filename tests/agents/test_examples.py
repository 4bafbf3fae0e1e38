"""The worked examples run, and their results are as described."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.script import script


def test_ppo_trains_on_randomised_scenes(tmp_path: Path) -> None:
    out = script("examples/randomized", "--total-steps", "8192", "--episodes", "4", cwd=tmp_path).stdout
    lines = out.strip().splitlines()
    assert len(lines) == 6
    for line in lines:
        _, default, randomised = map(float, re.findall(r"-?\d+\.\d", line))  # restitution, and what both trainings earn
        assert default != randomised
        assert min(default, randomised) > 0.0


def through(steps: int, folder: Path) -> list[int]:
    """How many of the episodes before and after training throw the jack through the window."""
    out = script("examples/own_task", "--total-steps", str(steps), cwd=folder).stdout
    return [int(number) for number in re.findall(r"trained: (\d+) of 64 through the window", out)]


@pytest.mark.slow
def test_ppo_learns_the_custom_task(tmp_path: Path) -> None:
    before, after = through(200_000, tmp_path)
    assert before < 10
    assert after > 60
