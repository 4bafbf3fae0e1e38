"""Action repeat: by a trained policy in the ordinary environment, and in training."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.network import NetworkPolicy, layers_of
from agents.policies.registry import find_policy
from agents.runs import describe
from agents.training import ppo as training
from agents.training.models import make_ppo, make_vec_env
from jackbox_env.files import new_folder
from tests.agents.small_run import TINY

REPEAT = 5
REPEATED = replace(TINY, contact="exact", repeat=REPEAT, preview=True)


# -- playing -----------------------------------------------------------------------------------------------------------


def test_each_environment_decides_when_its_episode_starts() -> None:
    model = make_ppo(REPEATED, make_vec_env(REPEATED.env_settings, 1, 0))
    policy = NetworkPolicy(REPEATED, layers_of(model.get_parameters()["policy"]))
    rng = np.random.default_rng(1)
    observations = rng.uniform(-1.0, 1.0, (23, 3, 10)).astype(np.float32)
    starts = np.zeros((23, 3), dtype=bool)
    starts[0] = True
    starts[7, 1] = starts[9, 1] = starts[10, 2] = True
    state: Any = None
    age, repeated = np.zeros(3, dtype=int), np.zeros((3, 1), dtype=np.float32)
    for seen, start in zip(observations, starts, strict=True):
        actions, state = policy.predict(seen, state, start)
        for number in range(3):
            age[number] = 0 if start[number] else age[number]
            if age[number] % REPEAT == 0:
                repeated[number] = model.predict(seen[number], deterministic=True)[0]
            age[number] += 1
        np.testing.assert_allclose(actions, repeated, atol=1e-6)
    with pytest.raises(ValueError, match="state must be that of 2 environments, as observation is, got 3"):
        policy.predict(np.zeros((2, 10), dtype=np.float32), state)


def test_a_model_with_lookahead_is_trained_and_loaded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = replace(REPEATED, lookahead=8)
    folder = new_folder(tmp_path / "run", "run", lambda made: describe(made, settings))
    training.train(settings, folder, progress=False)
    summary = capsys.readouterr().out.strip().splitlines()[-2]  # what the time went to
    match = re.fullmatch(r"([0-9,]+) steps in [0-9]+ s, [0-9,]+ per second: (.*)", summary)
    assert match, summary
    assert int(match[1].replace(",", "")) >= settings.total_steps
    shares = {name: float(share) for name, share in re.findall(r"([a-z ,]+) ([0-9.]+)%", match[2])}
    assert sum(shares.values()) == pytest.approx(100.0, abs=0.5)
    assert shares[", looking ahead"] > shares["environment"] > 0.0
    (earned,) = evaluate("PPO", find_policy(str(folder), settings).policy, settings.env_settings, 1, 0).returns
    assert earned > 0.0


# -- run folders -------------------------------------------------------------------------------------------------------
