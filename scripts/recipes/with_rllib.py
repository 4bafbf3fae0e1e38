"""RLlib: PPO on two env runners, each with one compiled batch of eight environments.

The module in front of the name registers the environment on every worker. An iteration takes 250
steps of each environment and an episode 500, so in every second iteration no episode ends and there
is no mean return.
"""

import argparse

import ray
from ray.rllib.algorithms.ppo import PPOConfig

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--iterations", type=int, default=4)
iterations = parser.parse_args().iterations

ray.init("local", num_cpus=3, include_dashboard=False)  # whatever cluster this machine is in
config = (
    PPOConfig()
    .environment("jackbox_env:JackInBox-v0", env_config={"fidelity": "exact"})
    .env_runners(
        num_env_runners=2, num_envs_per_env_runner=8, gym_env_vectorize_mode="vector_entry_point"
    )
    .training(train_batch_size=4000)
)
algorithm = config.build_algo()
runners = algorithm.env_runner_group
names = runners.foreach_env_runner(
    lambda one: type(one.env.unwrapped).__name__, local_env_runner=False
)
print("Stepping", *names)
for _ in range(iterations):
    result = algorithm.train()
    mean = result["env_runners"].get("episode_return_mean")
    print(f"{result['num_env_steps_sampled_lifetime']:.0f} steps, mean return {mean}", flush=True)
algorithm.stop()
