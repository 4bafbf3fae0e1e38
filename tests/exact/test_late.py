"""What is compiled when a step first needs it: the call goes on where it ended, and ends with the same bits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Scene, linearize, rollout
from jackbox_env.exact import late, workspace
from jackbox_env.planning import rollouts
from tests.batches.several import assert_same

LOSSY = Scene(restitution=0.4)


def flown(scene: Scene) -> list[Any]:
    """Rollouts and their derivatives: in the first step four rows strike, then some rest or strike with two feet."""
    states = np.zeros((8, 12))
    states[:4, 5], states[4:, 5] = 0.3, math.pi / 4.0
    states[:4, 4], states[4:, 4] = -5.99 + math.cos(0.3), -6.0 + math.cos(math.pi / 4.0)
    states[:, 10] = -5.0
    if scene.elastic:
        states[4:, 4] += 0.01
    torques = np.zeros((8, 100))
    played = rollout(scene, states, torques, 0.02, rewards="juggle", impacts=True, num_threads=1)
    linear = linearize(scene, states, torques, 0.02, num_threads=1)
    assert played.impacts is not None
    assert (played.impacts[:, 0] > 0).all()
    return [*played, *linear, *(linear.impacts(row) for row in range(8))]


@pytest.mark.parametrize("scene", [LOSSY, Scene(drive=None)], ids=["rest", "together"])
def test_a_call_that_lacks_compiled_code_goes_on_with_the_same_bits(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacked, with_all = list[int](), late.with_all

    def counted(workspaces: Any) -> Any:
        lacked.append(len(workspaces))
        return with_all(workspaces)

    def whole(*arguments: Any) -> workspace.ThreadMemory:
        memory = workspace.new_memory(*arguments)
        with_all(memory.workspaces)
        return memory

    monkeypatch.setattr(late, "with_all", counted)
    first = flown(scene)
    assert len(lacked) == 2
    monkeypatch.setattr(rollouts, "new_memory", whole)
    assert_same(flown(scene), first)
    assert len(lacked) == 2
