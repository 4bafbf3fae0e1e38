"""Returns of policies over seeded episodes, with intervals, as rows of a table and as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from stable_baselines3.common.evaluation import evaluate_policy
from tqdm import tqdm

from agents.policies.scripted import PolicyWithEnv
from agents.training.models import derived_seed, make_vec_env

SIDE_BY_SIDE = 16  # environments


@dataclass(frozen=True)
class Returns:
    """Returns of one policy: one number per episode."""

    policy: str
    returns: tuple[float, ...]
    environments: int = 1  # that were played side by side

    @property
    def mean(self) -> float:
        """Mean return."""
        return float(np.mean(self.returns))

    @property
    def half_width(self) -> float:
        """Half width of Student's 95 % interval of the mean; infinite for a single episode."""
        count = len(self.returns)
        return float(stats.t.ppf(0.975, count - 1) * stats.sem(self.returns)) if count > 1 else math.inf

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of the mean."""
        return self.mean - self.half_width, self.mean + self.half_width

    def as_json(self) -> dict[str, Any]:
        """All figures and returns, for a JSON file."""
        return {
            "policy": self.policy,
            "mean": self.mean,
            "interval_95": self.interval if len(self.returns) > 1 else None,
            "episodes": len(self.returns),
            "environments": self.environments,
            "returns": self.returns,
        }


def evaluate(
    name: str,
    acting: PolicyWithEnv,
    env_settings: dict[str, Any],
    episodes: int,
    seed: int,
    deterministic: bool = True,
    progress: bool = False,
) -> Returns:
    """Run whole episodes of a policy in its environment, from starts that ``seed`` determines and no training uses.

    Args:
        name: of the row.
        acting: the policy and its keywords of the environment, which go before ``env_settings``.
        env_settings: keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.
        episodes: their number; up to ``SIDE_BY_SIDE`` are played at a time.
        seed: of the starts.
        deterministic: the policy draws no actions.
        progress: show a progress bar.
    """
    starts, count = derived_seed("evaluation", seed), min(SIDE_BY_SIDE, episodes)
    environments = make_vec_env({**env_settings, **acting.keywords}, count, starts)
    environments.reset()  # compiles, before the bar
    environments.seed(starts)
    with tqdm(total=episodes, desc=name, unit="episode", disable=None if progress else True, leave=False) as bar:
        rewards, _ = evaluate_policy(
            acting.policy,
            environments,
            n_eval_episodes=episodes,
            deterministic=deterministic,
            callback=lambda inner, _: bar.update(int(inner["done"])) if inner["done"] else None,
            return_episode_rewards=True,
        )
    environments.close()
    assert isinstance(rewards, list)
    return Returns(name, tuple(float(reward) for reward in rewards), count)


def table(rows: list[Returns]) -> str:
    """A Markdown table: mean, 95 % interval, number of episodes."""
    width = max(len("policy"), *(len(row.policy) for row in rows))
    lines = [f"| {'policy':<{width}} | mean return | 95 % interval    | episodes |"]
    lines.append(f"|{'-' * (width + 2)}|------------:|:----------------:|---------:|")
    for row in rows:
        low, high = row.interval
        interval = f"{low:.1f} to {high:.1f}" if len(row.returns) > 1 else "unknown"
        lines.append(f"| {row.policy:<{width}} | {row.mean:11.1f} | {interval:^16} | {len(row.returns):8d} |")
    return "\n".join(lines)


def above(rows: list[Returns], upper: str, lower: str) -> str:
    """A sentence: whether the whole interval of one policy's mean is above another's."""
    by_policy = {row.policy: row for row in rows}
    high, low = by_policy[upper], by_policy[lower]
    is_above = high.interval[0] > low.interval[1]
    return (
        f"{upper}'s interval ({high.interval[0]:.1f} to {high.interval[1]:.1f}) is {'' if is_above else 'not '}above "
        f"{lower}'s ({low.interval[0]:.1f} to {low.interval[1]:.1f})"
    )
