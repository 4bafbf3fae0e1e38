"""Train PPO on a task of one's own: keep the jack on the left, and do it with little torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from jackbox_env.commands.common import command_line


def stay_left(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
    """How far left of the box's centre the jack is, over L, and what the torque costs."""
    share = torque / scene.torque_limit
    return (state[0] - state[3]) / scene.box_half_width, -0.1 * share * share


@dataclass(frozen=True)
class Arguments:
    """Evaluate before and after training, on the same starts."""

    total_steps: int = 400_000
    """Environment steps to train for."""
    episodes: int = 64
    """Episodes of each policy, run side by side."""
    seed: int = 0
    """Of the network and of the training's starts; evaluation starts from others."""


@command_line
def main() -> None:
    """Train, evaluate, print."""
    import tyro
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy

    from jackbox_env import Task
    from jackbox_env.sb3 import make_sb3_vec_env

    arguments = tyro.cli(Arguments, description=__doc__)
    settings: dict[str, Any] = {
        "fidelity": "exact", "control_dt": 0.05, "max_episode_steps": 200,  # 10 s
        "task": Task(terms=("left", "effort"), values=stay_left),
    }  # fmt: skip
    train_envs = make_sb3_vec_env(64, **settings)
    model = PPO("MlpPolicy", train_envs, n_steps=128, batch_size=1024, seed=arguments.seed, device="cpu")

    def mean_return() -> float:
        envs = make_sb3_vec_env(arguments.episodes, **settings)
        envs.seed(1_000_000)
        mean, _ = evaluate_policy(model, envs, arguments.episodes)
        return float(mean)  # type: ignore[arg-type]

    before = mean_return()
    model.learn(arguments.total_steps)
    print(f"untrained {before:7.1f}")
    print(f"trained   {mean_return():7.1f}")


if __name__ == "__main__":
    main()
