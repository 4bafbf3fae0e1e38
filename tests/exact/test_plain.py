"""The compiled functions give the same bits as plain Python, under NUMBA_DISABLE_JIT=1."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from jackbox_env import Scene, Task, rollout
from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.envs.vector import JackInBoxVectorEnv
from tests.batches.several import SHAKEN
from tests.fingerprints import digest
from tests.states import started


def test_plain_python_gives_the_bits_of_the_compiled_code() -> None:
    command, environment = [sys.executable, "-W", "error", "-m", __name__], os.environ | {"NUMBA_DISABLE_JIT": "1"}
    plain = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=600)
    assert plain.stdout.split() == [*played(1.0), *played(0.8)]


SCALE = np.ones(1)


def height(scene: Any, state: Any, torque: float, impulse: float) -> float:
    return float(SCALE[0] * (state[4] - state[1]))


def struck(scene: Any, state: Any, torque: float, impulse: float) -> bool:
    return bool(impulse > 0.0)


HEIGHT = Task(("height",), height, struck)


def played(restitution: float) -> list[str]:
    """Digests of a batch that restarts, a rollout and a single environment under the chirp, 60 steps with impacts.

    And of decisions until an impact, of which some wait for the restart of the only environment whose drive has pieces.
    """
    scene, rng = Scene(restitution=restitution), np.random.default_rng(0)
    batch = started(JackInBoxVectorEnv(5, 40, contact="exact", scene=scene, with_infos=True, task=HEIGHT), seed=3)
    SCALE[0] = 2.0  # the task keeps what it read first
    stepped = [batch.step(rng.uniform(-1.0, 1.0, (5, 1))) for _ in range(60)]
    states = np.zeros((2, 12))
    states[:, 9:] = [[13.0, -12.0, 4.0], [15.0, 1.0, -7.0]]
    rollouts = rollout(scene, states, rng.uniform(-9e4, 9e4, (2, 60)), 0.02, rewards=HEIGHT, impacts=True, energy=True)
    assert rollouts.impacts is not None
    assert rollouts.impacts.sum(axis=1).min() > 0
    env = started(JackInBoxEnv(contact="exact", scene=scene, torque="chirp", task=HEIGHT), seed=1)
    alone = [env.step(0.0)[:3] for _ in range(60)]
    shaken = Scene(drive=SHAKEN, gravity=20.0, restitution=restitution)
    nouns: Any = {
        "task": "rattle", "observation": "landing", "action": "landing", "action_repeat": "bounce",
        "episode_steps": 100,
    }  # fmt: skip
    aimed = started(JackInBoxVectorEnv(2, contact="exact", scene=[shaken, scene], **nouns), seed=0)
    decisions = [aimed.step(np.zeros((2, 2))) for _ in range(12)]
    assert any(infos["duration"][0] == 0.0 < infos["duration"][1] for *_, infos in decisions)
    chosen = started(
        JackInBoxEnv(contact="exact", scene=scene, task="spin", action="discrete", action_repeat=3), seed=2
    )
    lying = rollout(Scene(restitution=0.2, drive=None), -4.4 * np.eye(12)[4] + 0.7 * np.eye(12)[5], np.zeros(60), 0.02)
    assert lying[0][-1, 11] == pytest.approx(lying[0][-1, 8], abs=1e-12)  # two feet lie on a wall
    results: list[Iterable[object]] = [
        [part for number in range(20) for part in chosen.step(number % 3)[:2]],
        [part for seen, reward, _, _, infos in stepped for part in (seen, reward, infos["state"])],
        [part for part in (*rollouts, *lying) if part is not None],
        [part for step in alone for part in step],
        [part for seen, reward, _, _, infos in decisions for part in (seen, reward, infos["duration"])],
    ]
    return [digest(parts) for parts in results]


if __name__ == "__main__":
    print(*played(1.0), *played(0.8))
