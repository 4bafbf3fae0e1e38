"""Train PPO on jacks of random mass and restitution, and evaluate it on light and heavy, lively and dull ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from jackbox_env.tools.command_line import command_line

RANGES = {"jack_mass": (1.0, 40.0), "restitution": (0.8, 1.0)}


@dataclass(frozen=True)
class Arguments:
    """Train twice, on the default scene and on randomised ones; compare both on the same starts."""

    total_steps: int = 400_000
    """Environment steps of each training."""
    episodes: int = 64
    """Episodes of each policy in each scene, run together."""
    seed: int = 0
    """Seed of the network and of the training's starts; evaluation starts from others."""


@command_line
def main() -> None:
    """Train, evaluate, print."""
    import tyro
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy

    from jackbox_env.sb3 import make_sb3_vec_env

    arguments = tyro.cli(Arguments, description=__doc__)
    settings: dict[str, Any] = {"fidelity": "exact", "control_dt": 0.05, "episode_steps": 200}  # 10 s

    def trained(**more: Any) -> PPO:
        envs = make_sb3_vec_env(64, **settings, **more)
        model = PPO("MlpPolicy", envs, n_steps=128, batch_size=1024, seed=arguments.seed, device="cpu")
        return model.learn(arguments.total_steps)

    def mean_return(model: PPO, scene: dict[str, float]) -> float:
        envs = make_sb3_vec_env(arguments.episodes, scene=scene, **settings)
        envs.seed(1_000_000)
        mean, _ = evaluate_policy(model, envs, arguments.episodes)
        return float(mean)  # type: ignore[arg-type]

    models = {"trained on the default scene": trained(), "trained on randomised scenes": trained(randomize=RANGES)}
    for mass in (1.0, 4.0, 40.0):
        for restitution in (1.0, 0.8):
            scene = {"jack_mass": mass, "restitution": restitution}
            earned = ", ".join(f"{name} {mean_return(model, scene):6.1f}" for name, model in models.items())
            print(f"jack of {mass:4.0f} kg, restitution {restitution:.1f}: {earned}")


if __name__ == "__main__":
    main()
