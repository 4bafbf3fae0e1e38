"""Minari: record a PD controller, and a game shared by `jackbox play`, as datasets."""

import argparse
import os
import tempfile
from typing import Any

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--episodes", type=int, default=4)
parser.add_argument("--game", metavar="TEXT", help="also record this game, without the chirp")
arguments = parser.parse_args()

with tempfile.TemporaryDirectory() as folder:
    os.environ.setdefault("MINARI_DATASETS_PATH", folder)  # before it is imported
    import gymnasium as gym
    import minari
    import numpy as np

    import jackbox_env  # noqa: F401  # registers JackInBox-v0
    from jackbox_env.commands.game import read_game

    env = minari.DataCollector(gym.make("JackInBox-v0", fidelity="exact"), record_infos=True)
    for seed in range(arguments.episodes):
        observation, _ = env.reset(seed=seed)
        done = False
        while not done:
            angle, rate = np.arctan2(observation[5], observation[4]), observation[6]
            action = np.clip([-1.6 * angle - 1.45 * rate], -1.0, 1.0)  # keeps the box level
            observation, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
    level = env.create_dataset("jackbox/level-v0", algorithm_name="level", eval_env="JackInBox-v0")
    datasets = [level]
    if arguments.game:
        game = read_game(arguments.game)
        if None in game.shares or not game.shares:
            raise SystemExit("a dataset needs a game of at least one step, without the chirp")
        setting: dict[str, Any] = {
            "task": game.task,
            "scene": game.scene.as_dict(),
            "control_dt": game.dt,
        }
        made = gym.make("JackInBox-v0", len(game.shares), fidelity="exact", **setting)
        env = minari.DataCollector(made, record_infos=True)
        env.reset(options={"state": game.start})
        for share in game.shares:
            env.step(np.array([share]))
        played = env.create_dataset("jackbox/game-v0", algorithm_name="person", eval_env=made)
        datasets.append(played)
    for dataset in datasets:
        episode = next(dataset.iterate_episodes())
        earned = episode.rewards.sum()
        print(f"{dataset.id}: {dataset.total_steps:,} steps, the first episode earned {earned:.1f}")
