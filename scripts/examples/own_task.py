"""Train PPO on a task of your own: throw the jack through a window in the upper half of the box."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jackbox_env.model.states import THETA_JACK, X_JACK, Y_JACK
from jackbox_env.tools.command_line import command_line, progress

REPEAT = 4  # control steps of an action


def through(scene: Any, state: Any, torque: float, impulse: float) -> bool:
    """The jack's centre is in a window of 2 m by 2 m that turns with the box."""
    x, y = state.x_jack - state.x_box, state.y_jack - state.y_box
    cosine, sine = math.cos(state.theta_box), math.sin(state.theta_box)
    return bool(abs(cosine * x + sine * y) < 1.0 and abs(cosine * y - sine * x - 3.0) < 1.0)


def reward(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
    """1 for reaching the window, minus 0.002 for each step until then."""
    return 1.0 if through(scene, state, torque, impulse) else 0.0, -0.002


def below(scene: Any, rng: np.random.Generator) -> Any:
    """The jack at rest in the lower half of a box at rest."""
    state = np.zeros(12)
    state[X_JACK], state[Y_JACK] = rng.uniform(-2.0, 2.0), rng.uniform(-3.0, -1.0)
    state[THETA_JACK] = rng.uniform(-0.5, 0.5)
    return state


@dataclass(frozen=True)
class Arguments:
    """Evaluate before and after training, on the same starts."""

    total_steps: int = 200_000
    """Control steps to train for."""
    episodes: int = 64
    """Episodes of each policy, run together."""
    seed: int = 0
    """Seed of the network and of the training's starts; evaluation starts from others."""


@command_line
def main() -> None:
    """Train, evaluate, print."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    progress("Loading PyTorch and Stable-Baselines3 ...")
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy

    from jackbox_env import Task
    from jackbox_env.sb3 import JackInBoxVecEnv, make_sb3_vec_env

    task = Task(("there", "time"), reward, over=through, start=below)

    def make_envs(count: int) -> JackInBoxVecEnv:
        return make_sb3_vec_env(count, fidelity="exact", task=task, action_repeat=REPEAT)

    torch.set_num_threads(1)
    policy = {"log_std_init": -0.7}
    model = PPO(
        "MlpPolicy", make_envs(256), n_steps=32, batch_size=1024, learning_rate=1e-3, gae_lambda=0.9,
        policy_kwargs=policy, seed=arguments.seed, device="cpu",
    )  # fmt: skip

    def report(name: str) -> None:
        envs = make_envs(arguments.episodes)
        envs.seed(1_000_000)
        _, steps = evaluate_policy(model, envs, arguments.episodes, return_episode_rewards=True)
        times = [0.02 * REPEAT * count for count in steps if REPEAT * count < 500]  # type: ignore[union-attr]
        mean = f", after {np.mean(times):.1f} s in the mean" if times else ""
        print(f"{name}: {len(times)} of {len(steps)} through the window{mean}", flush=True)  # type: ignore[arg-type]

    report("untrained")
    model.learn(arguments.total_steps, progress_bar=True)
    report("trained")


if __name__ == "__main__":
    main()
