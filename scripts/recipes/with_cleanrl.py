"""PPO in one file, in the manner of CleanRL: torch, and Gymnasium's vector interface.

With --device cuda environments and networks stay on the GPU.
"""

import argparse
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import jackbox_env  # noqa: F401  # registers JackInBox-v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=2_000_000)
parser.add_argument("--task", default="juggle")
parser.add_argument("--device", choices=["cuda"])
arguments = parser.parse_args()
NUM_ENVS, LENGTH, EPOCHS, MINIBATCH, GAMMA, LAMBDA, CLIP = 256, 32, 5, 1024, 0.99, 0.9, 0.2

torch.manual_seed(0)
torch.set_num_threads(1)  # small networks are fastest on one
if arguments.device:
    torch.set_default_device(arguments.device)
keywords = {"task": arguments.task, "action_repeat": 4}  # an action every 0.08 s, 125 in an episode
keywords |= {"autoreset_mode": "SAME_STEP", "device": arguments.device}
envs = gym.make_vec("JackInBox-v0", NUM_ENVS, fidelity="exact", **keywords)
size = gym.spaces.flatdim(envs.single_observation_space)


def stepped(action: torch.Tensor) -> tuple[Any, ...]:
    """Step the environments; tensors and infos."""
    given = action.clamp(-1.0, 1.0)
    *results, infos = envs.step(given if arguments.device else given.numpy())
    return *map(torch.as_tensor, results), infos


def network(outputs: int) -> nn.Sequential:
    """Two layers of 64."""
    hidden = nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh()
    return nn.Sequential(*hidden, nn.Linear(64, outputs))


actor, critic, log_std = network(1), network(1), nn.Parameter(torch.full((1,), -0.7))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimiser = torch.optim.Adam(parameters, lr=1e-3, eps=1e-5)


def log_probability(observations: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
    """Log-probabilities of actions, shape (n, 1), under the policy: shape (n,)."""
    policy = torch.distributions.Normal(actor(observations), log_std.exp())
    return policy.log_prob(actions).sum(-1)  # type: ignore[no-any-return]


updates = max(1, arguments.steps // (NUM_ENVS * LENGTH))
observation, earned = torch.as_tensor(envs.reset(seed=0)[0]), torch.zeros(NUM_ENVS)
finished: list[float] = []
for update in range(updates):
    optimiser.param_groups[0]["lr"] = 1e-3 * (1.0 - update / updates)
    observed, acted, rewards, dones = [], [], [], []
    for _ in range(LENGTH):
        with torch.no_grad():
            action = torch.normal(actor(observation), log_std.exp())
        after, reward, terminated, truncated, infos = stepped(action)
        reward = reward.float()
        earned += reward
        if truncated.any():  # the time limit ends no task: add the value of what would follow
            final = infos["final_obs"][truncated]
            final = torch.as_tensor(final if arguments.device else np.stack(final))
            with torch.no_grad():
                reward[truncated] += GAMMA * critic(final).squeeze(-1)
        observed.append(observation)
        acted.append(action)
        rewards.append(reward)
        dones.append((terminated | truncated).float())
        finished += earned[truncated].tolist()
        earned[truncated] = 0.0
        observation = after
    with torch.no_grad():
        values = critic(torch.stack([*observed, observation])).squeeze(-1)
        advantages, last = torch.zeros(LENGTH, NUM_ENVS), torch.zeros(NUM_ENVS)
        for step in reversed(range(LENGTH)):
            alive = 1.0 - dones[step]
            error = rewards[step] + GAMMA * alive * values[step + 1] - values[step]
            last = error + GAMMA * LAMBDA * alive * last
            advantages[step] = last
        flat_observed, flat_acted = torch.cat(observed), torch.cat(acted)
        before = log_probability(flat_observed, flat_acted)
        flat, returns = advantages.flatten(), (advantages + values[:-1]).flatten()
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(flat)).split(MINIBATCH):
            ratio = (log_probability(flat_observed[rows], flat_acted[rows]) - before[rows]).exp()
            gain = (flat[rows] - flat[rows].mean()) / (flat[rows].std() + 1e-8)
            clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
            policy_loss = -torch.min(ratio * gain, clipped * gain).mean()
            value_loss = (critic(flat_observed[rows]).squeeze(-1) - returns[rows]).square().mean()
            optimiser.zero_grad()
            (policy_loss + 0.5 * value_loss).backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimiser.step()
    if finished and (update % 10 == 9 or update == updates - 1):
        actions, recent = (update + 1) * NUM_ENVS * LENGTH, np.mean(finished[-NUM_ENVS:])
        print(f"{actions:,} actions: {recent:.1f}", flush=True)

observation = torch.as_tensor(envs.reset(seed=1_000_000)[0])  # unseen starts
earned = torch.zeros(NUM_ENVS)
for _ in range(125):
    with torch.no_grad():
        action = actor(observation)
    observation, reward = stepped(action)[:2]
    earned += reward
interval = 1.96 * earned.std() / NUM_ENVS**0.5
actions = updates * NUM_ENVS * LENGTH
print(f"after {actions:,} actions: return {earned.mean():.1f} +- {interval:.1f}")
