"""The chirp that earns most on a task, of 400 that are tried on the exact model."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from agents.settings import EPISODE_STEPS
from agents.training.models import derived_seed
from jackbox_env import Chirp, JackInBoxVectorEnv, Scene

# Amplitudes over the torque's limit, Hz, Hz/s.
AMPLITUDES = tuple(sign * share for share in (0.1, 0.2, 0.4, 0.7, 1.0) for sign in (1.0, -1.0))
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0)
RATES = (0.0, 0.03, 0.1, 0.3, 0.9)
STARTS = 32  # of each chirp, the same for all, others than those of the evaluation


def chirps() -> list[dict[str, float]]:
    """The fields of all chirps that are tried."""
    limit = Scene().torque_limit
    return [
        {"amplitude": share * limit, "start_frequency": frequency, "rate": rate}
        for share, frequency, rate in product(AMPLITUDES, FREQUENCIES, RATES)
    ]


def returns_of(task: str, tried: list[dict[str, float]], starts: int, seed: int) -> NDArray[np.float64]:
    """What chirps earn on the exact model, shape (chirps, starts), all from the same starts."""
    scenes = [Scene(drive=Chirp(**fields)) for fields in tried for _ in range(starts)]
    env = JackInBoxVectorEnv(len(scenes), scene=scenes, contact="exact", task=task, torque="chirp")
    env.reset(seed=[seed + start for _ in tried for start in range(starts)])
    total = np.zeros(len(scenes))
    for _ in range(EPISODE_STEPS):
        total += env.step(None)[1]
    return total.reshape(len(tried), starts)


def best_chirp(task: str, seed: int) -> dict[str, float]:
    """The chirp of the sweep that earns most on a task; ``seed`` decides the starts."""
    tried = chirps()
    return tried[int(returns_of(task, tried, STARTS, derived_seed("chirps", seed)).mean(axis=1).argmax())]
