"""Under the chirp, environments at the same time share its integrals: each still gets the bits that it gets alone."""

from __future__ import annotations

import numpy as np
import pytest

from jackbox_env import Chirp, JackInBoxVectorEnv, Scene, make_simulator

COUNT = 140  # two blocks


def staggered(scene: Scene) -> JackInBoxVectorEnv:
    """Jacks at rest and flying, in the middle and at walls, some far off or spinning fast, at three times."""
    env = JackInBoxVectorEnv(COUNT, contact="exact", scene=scene, torque="chirp", control_dt=0.03, with_infos=True)
    env.reset(seed=0)
    rng, states = np.random.default_rng(1), env.states
    states[:, 6:] += rng.normal(size=(COUNT, 6)) * 3.0
    states[5, [0, 3]] += 3e8  # where float64 resolves little
    states[6, 11] = 300.0
    states[7, [2, 5]] += 1e7
    times = rng.choice([0.0, 1.7, 250.0], COUNT)
    env.set_states(states, times)
    return env


@pytest.mark.parametrize("frequency", [0.5, 40.0, -3.0], ids=["slow", "several pieces", "backwards"])
def test_each_environment_gets_the_bits_that_it_gets_alone(frequency: float) -> None:
    scene = Scene(drive=Chirp(90000.0, frequency, 0.9))
    env = staggered(scene)
    singles = [make_simulator(scene, "exact") for _ in range(COUNT)]
    for single, state, time in zip(singles, env.states, env.times.tolist(), strict=True):
        single.reset(state, time)
    impacts = 0
    for _ in range(80):
        infos = env.step(None)[4]
        for number, single in enumerate(singles):
            single.step(0.03)
            np.testing.assert_array_equal(infos["state"][number], single.state)
            assert (infos["time"][number], infos["torque"][number]) == (single.time, single.torque)
            assert infos["impacts"][number] == len(single.impacts)
            impacts += len(single.impacts)
    assert impacts > 100
