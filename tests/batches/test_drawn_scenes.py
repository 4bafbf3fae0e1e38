"""Where scenes are drawn, what an option changes beside holds for one episode."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env import Chirp, JackInBoxEnv, JackInBoxVectorEnv
from tests.batches.test_scenes import EVERY_MODEL, RANGES, SHAKEN, TURNED, assert_same, choosy, play, play_singles


@EVERY_MODEL
@pytest.mark.parametrize("drive", [None, Chirp(2e4, 1.0, 0.0), SHAKEN, TURNED])
@pytest.mark.parametrize("randomize", [RANGES, choosy])
def test_a_drive_of_the_option_ends_with_the_episode_where_scenes_are_drawn(
    contact: str, drive: Any, randomize: Any
) -> None:
    count, limit = 3, 9
    batch = JackInBoxVectorEnv(count, limit, contact=contact, randomize=randomize, with_infos=True)
    singles = [JackInBoxEnv(contact=contact, randomize=randomize) for _ in range(count)]
    batch.reset(seed=0)
    mask = np.array([True, False, True])
    batch.reset(options={"scene": {"drive": drive}, "reset_mask": mask})
    for number, env in enumerate(singles):
        env.reset(seed=number)
        if mask[number]:
            env.reset(options={"scene": {"drive": drive}})
    assert [scene.drive is drive for scene in batch.scenes] == mask.tolist() or randomize is choosy
    assert_same(play(batch, 35, 0), play_singles(singles, 35, 0, limit))
    assert batch.scenes == [env.scene for env in singles]
