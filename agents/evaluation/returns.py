"""Returns of policies over seeded episodes, with intervals, as rows of a table and as JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from stable_baselines3.common.evaluation import evaluate_policy
from tqdm import tqdm

from agents.policies.network import SHIPPED, WEIGHTS, read_policy
from agents.policies.one_bounce import LANDING, read_landing
from agents.policies.planner import DECISION, VALUED_PIECES, Planner
from agents.policies.scripted import BASELINES, Baseline, Policy, baseline
from agents.policies.value import VALUE, read_value
from agents.settings import EPISODE_STEPS, EnvSettings
from agents.training.models import derived_seed, load_model, make_vec_env
from jackbox_env import Scene


@dataclass(frozen=True)
class Returns:
    """Returns of one policy: one number per episode."""

    policy: str
    returns: tuple[float, ...]

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
        """Everything, for a file."""
        return {
            "policy": self.policy,
            "mean": self.mean,
            "interval_95": self.interval if len(self.returns) > 1 else None,
            "episodes": len(self.returns),
            "returns": self.returns,
        }


def evaluate(
    name: str,
    policy: Policy,
    env_settings: dict[str, Any],
    episodes: int,
    seed: int,
    deterministic: bool = True,
    progress: bool = False,
) -> Returns:
    """Run whole episodes, up to 16 side by side, from starts that ``seed`` decides; training has not seen them."""
    starts = derived_seed("evaluation", seed)
    environments = make_vec_env(env_settings, min(16, episodes), starts)
    environments.seed(starts)
    steps = episodes * EPISODE_STEPS
    with tqdm(total=steps, desc=name, unit="step", unit_scale=True, disable=not progress, leave=False) as bar:
        rewards, _ = evaluate_policy(
            policy,
            environments,
            n_eval_episodes=episodes,
            deterministic=deterministic,
            callback=lambda *_: bar.update(),
            return_episode_rewards=True,
        )
    environments.close()
    assert isinstance(rewards, list)
    return Returns(name, tuple(float(reward) for reward in rewards))


def find_policy(name: str, settings: EnvSettings, seed: int, trust: bool = False) -> Baseline:
    """A baseline, the planner or a policy that is shipped by its name, or a trained one by its run folder or file.

    Raises:
        FileNotFoundError: it is none of these.
    """
    scene = Scene.of(settings.scene_fields)
    if name in BASELINES:
        return baseline(name, scene, seed)
    if name == "planner":
        return Baseline(_planner(settings, scene, seed), {})
    if name in shipped_names(settings.task):
        return Baseline(_read(SHIPPED / f"{settings.task}-{name}"), {})
    if not Path(name).exists():
        known = ", ".join((*BASELINES, "planner", *shipped_names(settings.task)))
        raise FileNotFoundError(f"a policy must be one of {known}, or a run folder or model file, got {name!r}")
    if (Path(name) / WEIGHTS).is_file():
        return Baseline(_read(Path(name)), {})
    return Baseline(load_model(Path(name), trust), {})


def _read(folder: Path) -> Policy:
    return read_landing(folder) if (folder / LANDING).is_file() else read_policy(folder)


def _planner(settings: EnvSettings, scene: Scene, seed: int) -> Planner:
    """The planner of an environment; its plans are shorter where a value was made for this very scene and task.

    Raises:
        FileNotFoundError, ValueError: the value that comes with the repository is damaged.
    """
    piece = max(1, round(DECISION / settings.control_dt))
    given: dict[str, Any] = {"piece": piece, "seed": seed}
    folder = SHIPPED / f"{settings.task}-value"
    if folder.is_dir():
        value = read_value(folder)
        made = value.settings
        made_for = made.task, made.control_dt, Scene.of(made.scene_fields).changed(drive=None)
        if made_for == (settings.task, settings.control_dt, scene.changed(drive=None)):
            given |= {"pieces": VALUED_PIECES, "value": value}
    return Planner(scene, settings.task, settings.control_dt, **given)


def shipped_names(task: str) -> list[str]:
    """Names of the trained policies for a task that come with the repository."""
    folders = [path for path in SHIPPED.glob(f"{task}-*") if not (path / VALUE).is_file()]
    return sorted(path.name.removeprefix(f"{task}-") for path in folders)


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
    """In words: whether the whole interval of one policy's mean is above that of another's."""
    found = {row.policy: row for row in rows}
    high, low = found[upper], found[lower]
    is_above = high.interval[0] > low.interval[1]
    return (
        f"{upper}'s interval ({high.interval[0]:.1f} to {high.interval[1]:.1f}) is {'' if is_above else 'not '}above "
        f"{lower}'s ({low.interval[0]:.1f} to {low.interval[1]:.1f})"
    )
