"""Without numba the package runs on pymunk; where numba is needed, an error names the Pythons that have it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import jackbox_env

CODE = """
import sys
sys.modules["numba"] = sys.modules["llvmlite"] = None
import gymnasium as gym
import numpy as np
import jackbox_env

for options in ({}, {"observation": "landing", "action": "landing", "action_repeat": "bounce"}):
    env = gym.make("JackInBox-v0", **options)
    env.reset(seed=0)
    env.step(env.action_space.sample())
envs = gym.make_vec("JackInBox-v0", num_envs=2)
envs.reset(seed=0)
envs.step(envs.action_space.sample())
for needs in (
    lambda: gym.make("JackInBox-v0", fidelity="exact"),
    lambda: gym.make_vec("JackInBox-v0", num_envs=2, fidelity="exact"),
    lambda: gym.make("JackInBox-v0", observation="pixels").reset(),
    lambda: jackbox_env.simulate({}, np.zeros(12), 0.1),
    lambda: jackbox_env.rollout(None, np.zeros((1, 12)), np.zeros((1, 2)), 0.02),
    lambda: jackbox_env.linearize(None, np.zeros(12), [0.0], 0.02),
):
    try:
        needs()
    except ImportError as error:
        print(error)
    else:
        print("no error")
"""


def test_without_numba_pymunk_runs_and_a_sentence_names_the_pythons_that_have_it() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False)
    sentence = (
        'the exact model, fidelity="exact", and pictures as observations need numba, which CPython 3.11 to 3.14 have: '
        'there is no numba; fidelity="balanced" needs none'
    )
    assert done.stdout.splitlines() == 6 * [sentence], done.stdout + done.stderr


def test_only_what_compiles_imports_numba() -> None:
    package = Path(jackbox_env.__file__).parent
    imports = re.compile(r"^ *(import|from) (numba|llvmlite)\b", re.MULTILINE)
    importing = {path.parent.name for path in package.rglob("*.py") if imports.search(path.read_text(encoding="utf-8"))}
    assert importing == {"jit"}
