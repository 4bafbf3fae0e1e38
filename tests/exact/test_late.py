"""What is compiled when a step first needs it: the call goes on where it ended, and ends with the same bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env import Scene, linearize, rollout
from jackbox_env.exact import compiler, late, rest, run, workspace
from jackbox_env.planning import rollouts
from jackbox_env.simulators.exact import ExactSimulator
from tests.fingerprints import digest

LOSSY = Scene(restitution=0.4)


def flown(scene: Scene) -> str:
    """Digest of rollouts of which many rows strike before others rest, or strike with two feet, with derivatives."""
    rng = np.random.default_rng(0)
    states = np.zeros((60, 12))
    states[:, 3], states[:, 4] = rng.uniform(-1.0, 1.0, (2, 60))
    states[:, 5] = rng.choice([0.3, np.pi / 4.0], 60)
    states[:, 9:11] = rng.normal(0.0, 6.0, (60, 2))
    torques = np.zeros((60, 200))
    played = rollout(scene, states, torques, 0.02, rewards="juggle", impacts=True, num_threads=1)
    linear = linearize(scene, states, torques, 0.02, num_threads=1)
    parts: list[Any] = [played.trajectories, played.rewards, played.impacts, played.impulse, *linear]
    for row in range(60):
        parts += linear.impacts(row)
    return digest(parts)


@pytest.mark.parametrize("scene", [LOSSY, Scene(drive=None)], ids=["rest", "together"])
def test_a_call_that_lacks_compiled_code_goes_on_with_the_same_bits(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacked, with_all = list[int](), late.with_all

    def counted(workspaces: Any) -> Any:
        lacked.append(len(workspaces))
        return with_all(workspaces)

    def whole(*arguments: Any) -> workspace.Memory:
        memory = workspace.new_memory(*arguments)
        with_all(memory.workspaces)
        return memory

    monkeypatch.setattr(late, "with_all", counted)
    first = flown(scene)
    assert len(lacked) == 2
    monkeypatch.setattr(rollouts, "new_memory", whole)
    assert flown(scene) == first
    assert len(lacked) == 2


def test_a_step_that_lacks_compiled_code_changes_nothing_and_is_repeated() -> None:
    ended, state = [], np.zeros(12)
    state[4], state[5] = -5.0, 0.0
    for prepared in (False, True):
        simulator = ExactSimulator(LOSSY)
        simulator.reset(state)
        for call in simulator._calls if prepared else []:
            late.with_all(call.memory.workspaces)
        ended.append([(simulator.step(0.02, 100.0), simulator.state)[1].tobytes() for _ in range(50)])
    assert ended[0] == ended[1]


def test_the_hot_code_has_no_feet_at_rest() -> None:
    assert not {"settle", "stretch", "project", "nearest"} & compiler._reachable_names(run.run)
    assert "settle" in compiler._reachable_names(rest.settle_and_advance)
