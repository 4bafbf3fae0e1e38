"""The worked examples run, and what they show is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.agents.test_commands import script


def numbers_of(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"-?\d+\.\d", text)]


def test_ppo_trains_on_randomised_scenes(tmp_path: Path) -> None:
    out = script("examples/randomized", "--total-steps", "8192", "--episodes", "4", cwd=tmp_path).stdout
    lines = out.strip().splitlines()
    assert len(lines) == 6
    for line in lines:
        _, default, randomised = numbers_of(line)  # restitution, and what both trainings earn
        assert default != randomised
        assert min(default, randomised) > 0.0


def test_ppo_trains_on_a_task_of_ones_own(tmp_path: Path) -> None:
    out = script("examples/own_task", "--total-steps", "8192", "--episodes", "4", cwd=tmp_path).stdout
    assert [line.split()[0] for line in out.strip().splitlines()] == ["untrained", "trained"]


@pytest.mark.slow
def test_ppo_learns_the_task_of_ones_own(tmp_path: Path) -> None:
    before, after = numbers_of(script("examples/own_task", "--total-steps", "150000", cwd=tmp_path).stdout)
    assert after > max(before, 0.0) + 4.0  # a box without torque earns nothing
