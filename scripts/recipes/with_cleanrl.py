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
parser.add_argument("--landing", action="store_true", help="act once a bounce")
parser.add_argument("--device", choices=["cuda"])
arguments = parser.parse_args()
NUM_ENVS, LENGTH, EPOCHS, MINIBATCH, LAMBDA, CLIP = 512, 12, 10, 1024, 0.9, 0.2
GAMMA = 0.72  # in a second

torch.manual_seed(0)
torch.set_num_threads(1)  # small networks are fastest on one
if arguments.device:
    torch.set_default_device(arguments.device)
keywords = {"task": arguments.task, "action_repeat": 4}  # an action every 0.08 s, 125 in an episode
if arguments.landing:  # an action is the box's angle and rate at the next landing
    keywords |= {"observation": "landing", "action": "landing", "action_repeat": "bounce"}
keywords |= {"autoreset_mode": "SAME_STEP", "device": arguments.device}
envs = gym.make_vec("JackInBox-v0", NUM_ENVS, fidelity="exact", **keywords)
size, width = map(gym.spaces.flatdim, (envs.single_observation_space, envs.single_action_space))


def stepped(action: torch.Tensor) -> tuple[Any, ...]:
    """Step the environments; tensors and infos."""
    given = action.clamp(-1.0, 1.0)
    *results, infos = envs.step(given if arguments.device else given.numpy())
    return *map(torch.as_tensor, results), infos


def layer(inputs: int, outputs: int, gain: float = 2.0**0.5) -> nn.Linear:
    """A layer whose weights are orthogonal at first."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def network(outputs: int, gain: float) -> nn.Sequential:
    """Two layers of 64."""
    hidden = layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh()
    return nn.Sequential(*hidden, layer(64, outputs, gain))


actor, critic = network(width, 0.01), network(1, 1.0)
log_std = nn.Parameter(torch.full((width,), -1.0))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimiser = torch.optim.Adam(parameters, lr=2e-3, eps=1e-5)


def log_probability(observations: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
    """Log-probabilities of actions, shape (n, width), under the policy: shape (n,)."""
    policy = torch.distributions.Normal(actor(observations), log_std.exp())
    return policy.log_prob(actions).sum(-1)  # type: ignore[no-any-return]


updates = max(1, arguments.steps // (NUM_ENVS * LENGTH))
observation, earned = torch.as_tensor(envs.reset(seed=0)[0]), torch.zeros(NUM_ENVS)
finished: list[float] = []
for update in range(updates):
    optimiser.param_groups[0]["lr"] = 2e-3 * (1.0 - update / updates)
    observed, acted, rewards, discounts = [], [], [], []
    for _ in range(LENGTH):
        with torch.no_grad():
            action = torch.normal(actor(observation), log_std.exp())
        after, reward, terminated, truncated, infos = stepped(action)
        reward, seconds = reward.float(), torch.as_tensor(infos["duration"])
        earned += reward
        if truncated.any():  # the time limit ends no task: add the value of what would follow
            final = infos["final_obs"][truncated]
            final = torch.as_tensor(final if arguments.device else np.stack(final))
            seconds = seconds + torch.as_tensor(infos["final_info"]["duration"])
            with torch.no_grad():
                follows = critic(final).squeeze(-1)
            reward[truncated] += GAMMA ** seconds[truncated].float() * follows
        observed.append(observation)
        acted.append(action)
        rewards.append(reward)
        discounts.append(GAMMA ** seconds.float() * ~(terminated | truncated))
        finished += earned[truncated].tolist()
        earned[truncated] = 0.0
        observation = after
    with torch.no_grad():
        values = critic(torch.stack([*observed, observation])).squeeze(-1)
        advantages, last = torch.zeros(LENGTH, NUM_ENVS), torch.zeros(NUM_ENVS)
        for step in reversed(range(LENGTH)):
            error = rewards[step] + discounts[step] * values[step + 1] - values[step]
            last = error + discounts[step] * LAMBDA * last
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
earned, ended = torch.zeros(NUM_ENVS), torch.zeros(NUM_ENVS, dtype=torch.bool)
while not ended.all():
    with torch.no_grad():
        action = actor(observation)
    observation, reward, terminated, truncated, _ = stepped(action)
    earned += reward * ~ended
    ended |= terminated | truncated
interval = 1.96 * earned.std() / NUM_ENVS**0.5
actions = updates * NUM_ENVS * LENGTH
print(f"after {actions:,} actions: return {earned.mean():.1f} +- {interval:.1f}")
