"""RLlib: PPO on two remote workers; the environment is registered by its name with the module in front."""

import argparse

import ray
from ray.rllib.algorithms.ppo import PPOConfig

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--iterations", type=int, default=3)
iterations = parser.parse_args().iterations

ray.init(num_cpus=3, include_dashboard=False)
config = (
    PPOConfig()
    .environment("jackbox_env:JackInBox-v0", env_config={"contact": "exact"})
    .env_runners(num_env_runners=2, num_envs_per_env_runner=8, gym_env_vectorize_mode="vector_entry_point")
    .training(train_batch_size=4000)
)
algorithm = config.build_algo()
for _ in range(iterations):
    found = algorithm.train()
    print(found["num_env_steps_sampled_lifetime"], found["env_runners"].get("episode_return_mean"))
algorithm.stop()
