"""Minari: record episodes of a PD controller that keeps the box level as a dataset, and read it back."""

import argparse
import os
import tempfile

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--episodes", type=int, default=4)
episodes = parser.parse_args().episodes

with tempfile.TemporaryDirectory() as folder:
    os.environ["MINARI_DATASETS_PATH"] = folder  # before it is imported
    import gymnasium as gym
    import minari
    import numpy as np

    import jackbox_env  # noqa: F401  # registers JackInBox-v0

    env = minari.DataCollector(gym.make("JackInBox-v0", fidelity="exact"), record_infos=True)
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        done = False
        while not done:
            angle, rate = np.arctan2(observation[5], observation[4]), observation[6]
            observation, _, terminated, truncated, _ = env.step(np.clip([-1.6 * angle - 1.45 * rate], -1.0, 1.0))
            done = terminated or truncated
    dataset = env.create_dataset("jackbox/level-v0", algorithm_name="level", eval_env="JackInBox-v0")
    episode = next(dataset.iterate_episodes())
    print(f"{dataset.total_steps:,} steps, the first episode earned {episode.rewards.sum():.0f}")
