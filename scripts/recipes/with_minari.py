"""Minari: record a PD controller that keeps the box level, and a game shared by `jackbox play`, as datasets."""

import argparse
import os
import tempfile

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--episodes", type=int, default=4)
parser.add_argument("--game", metavar="TEXT", help="also record this game, played without the chirp")
arguments = parser.parse_args()

with tempfile.TemporaryDirectory() as folder:
    os.environ.setdefault("MINARI_DATASETS_PATH", folder)  # before it is imported
    import gymnasium as gym
    import minari
    import numpy as np

    import jackbox_env  # noqa: F401  # registers JackInBox-v0
    from jackbox_env.recording.game import read_game

    env = minari.DataCollector(gym.make("JackInBox-v0", fidelity="exact"), record_infos=True)
    for seed in range(arguments.episodes):
        observation, _ = env.reset(seed=seed)
        done = False
        while not done:
            angle, rate = np.arctan2(observation[5], observation[4]), observation[6]
            observation, _, terminated, truncated, _ = env.step(np.clip([-1.6 * angle - 1.45 * rate], -1.0, 1.0))
            done = terminated or truncated
    datasets = [env.create_dataset("jackbox/level-v0", algorithm_name="level", eval_env="JackInBox-v0")]
    if arguments.game:
        game = read_game(arguments.game)
        if None in game.shares or not game.shares:
            raise SystemExit("a dataset needs a game of at least one step, and a torque for each: without the chirp")
        scene, steps = game.scene.as_dict(), len(game.shares)
        made = gym.make("JackInBox-v0", steps, fidelity="exact", task=game.task, scene=scene, control_dt=game.dt)
        env = minari.DataCollector(made, record_infos=True)
        env.reset(options={"state": game.start})
        for share in game.shares:
            env.step(np.array([share]))
        datasets.append(env.create_dataset("jackbox/game-v0", algorithm_name="person", eval_env=made))
    for dataset in datasets:
        episode = next(dataset.iterate_episodes())
        print(f"{dataset.id}: {dataset.total_steps:,} steps, the first episode earned {episode.rewards.sum():.1f}")
