"""The growth of small errors: the largest Lyapunov exponent over an episode of 10 s.

From each start the steps' derivatives are multiplied, in units of L, v0, v0/L and v0/l. The product's largest singular
value sigma is the growth of the worst small error. The exponent is log sigma(10 s) / 10 s. It is that of the open loop:
the policy's torques do not react to the error. The flight before the first impacts adds growth that is not exponential.
The growth per impact excludes it: it is measured from before the second to before the last impact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.figure import Figure
from scipy import stats
from tqdm import tqdm

from agents.evaluation.episodes import control_steps
from agents.policies.registry import find_policy
from agents.settings import EPISODE_STEPS, EnvSettings
from jackbox_env import Scene, linearize
from jackbox_env.commands.plots import BOX, GREY, JACK, write_figure
from jackbox_env.model.states import Array

SCENE, DT, STARTS, SEED = Scene(), 0.02, 256, 1
LENGTH, SPEED = SCENE.box_half_width, SCENE.speed_scale
UNITS = np.array([LENGTH, LENGTH, 1.0] * 2 + [SPEED, SPEED, SPEED / LENGTH, SPEED, SPEED, SPEED / SCENE.jack_arm])
STYLES = {"zero": (GREY, ":", "^"), "chirp": (BOX, "--", "s"), "ppo": (JACK, "-", "o")}  # of policies
LAST = "impacts; a line ends at the last one after which\nat least half of the jacks bounce again within 10 s"
PANELS = (  # of the picture: quantity, its step, points for each mark, label with the reason for the lines' ends
    ("by_time", 5.0 * DT, 10, "time [s]; an episode ends at 10 s"),
    ("by_impact", 1.0, 1, LAST),
)
FORGOTTEN = math.log(0.1 / 1e-16)  # of sigma, when rounding has grown to a tenth


def played(policy: str) -> tuple[Array, Array, Array]:
    """A policy's first states (STARTS, 12), torques (STARTS, steps) [N m] and cumulated impacts (STARTS, steps)."""
    settings = EnvSettings(contact="exact")
    acting = find_policy(policy, settings)
    env = gym.make("JackInBox-v0", **{**settings.env_settings, **acting.keywords})
    starts, torques, impacts = [], [], []
    for start in range(STARTS):
        observation, info = env.reset(seed=SEED + start)
        steps = list(control_steps(env, acting, observation))
        starts.append(info["state"])
        torques.append([step.torque for step in steps])
        impacts.append([len(step.impacts) for step in steps])
    return np.array(starts), np.array(torques), np.cumsum(impacts, axis=1, dtype=np.float64)


def growth(by_state: Array) -> Array:
    """Log of sigma after each step, (n, steps), from derivatives (n, steps, 12, 12); the product is rescaled to 1."""
    grown, scale, logs = np.eye(12), np.zeros(len(by_state)), []
    for k in range(by_state.shape[1]):
        grown = (by_state[:, k] * UNITS / UNITS[:, None]) @ grown
        sigma = np.linalg.norm(grown, 2, axis=(1, 2))
        grown, scale = grown / sigma[:, None, None], scale + np.log(sigma)
        logs.append(scale)
    return np.stack(logs, axis=1)


def with_interval(values: Array) -> dict[str, float]:
    """The mean and the half width of its 95 % interval."""
    half_width = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    return {"mean": float(values.mean()), "half_width": half_width}


def at_impacts(logs: Array, impacts: Array) -> Array:
    """The log of sigma after 1, 2, ... impacts, at the end of the last step before the next; NaN if none comes."""
    by_impact = np.full((len(logs), int(impacts.max())), np.nan)
    for count in range(1, by_impact.shape[1]):
        more = impacts > count
        by_impact[:, count - 1] = np.where(more[:, -1], logs[np.arange(len(logs)), more.argmax(axis=1) - 1], np.nan)
    return by_impact


def figures(policy: str) -> dict[str, Any]:
    """All measures of the motion under a policy; starts with a step that has no derivative are left out."""
    starts, torques, impacts = played(policy)
    drive = {"torques": None, "steps": EPISODE_STEPS} if policy == "chirp" else {"torques": torques}
    lin = linearize(SCENE, starts, dt=DT, **drive)
    smooth = lin.smooth.all(axis=1)
    logs, impacts = growth(lin.A[smooth]), impacts[smooth]
    by_impact = at_impacts(logs, impacts)
    exponent = with_interval(logs[:, -1] / (DT * EPISODE_STEPS))
    per_impact = with_interval((np.nanmax(by_impact, axis=1) - by_impact[:, 0]) / (impacts[:, -1] - 2.0))
    common = np.isfinite(by_impact).mean(axis=0) >= 0.5
    return {
        "starts": STARTS,
        "skipped": int((~smooth).sum()),
        "exponent": exponent,  # [1/s]
        "log_per_impact": per_impact,
        "impacts": with_interval(impacts[:, -1]),
        "forgotten_after": FORGOTTEN / exponent["mean"],  # [s]
        "forgotten_after_impacts": 1.0 + (FORGOTTEN - float(by_impact[:, 0].mean())) / per_impact["mean"],
        "share_forgotten": float((logs[:, -1] > FORGOTTEN).mean()),
        "by_time": np.quantile(logs, (0.1, 0.5, 0.9), axis=0)[:, 4::5].tolist(),
        "by_impact": np.nanquantile(by_impact[:, common], (0.1, 0.5, 0.9), axis=0).tolist(),
    }


def measure() -> dict[str, Any]:
    """The exponents of the motion under each policy, and how its errors grow with time."""
    return {policy: figures(policy) for policy in tqdm(STYLES, desc="exponents", leave=False, disable=None)}


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw the growth of errors with time and with impacts: the median over the starts, and the middle 80 %."""
    figure = Figure(figsize=(5.0, 6.4), layout="constrained")
    for axes, (by, step, every, label) in zip(figure.subplots(2, 1), PANELS, strict=True):
        for policy, (color, line, marker) in STYLES.items():
            low, middle, high = np.exp(results[policy][by])
            along, marks = step * np.arange(1, len(middle) + 1), (every - 1, every)
            axes.fill_between(along, low, high, color=color, alpha=0.2, linewidth=0.0)
            axes.semilogy(along, middle, line, marker=marker, markevery=marks, markersize=5, color=color, label=policy)
        axes.axhline(math.exp(FORGOTTEN), color=GREY, linestyle=(0, (1, 3)))
        axes.text(along[0], 2.0 * math.exp(FORGOTTEN), "an error of 1e-16 has grown to 0.1", color=GREY)
        axes.set(xlabel=label, ylim=(1.0, 1e18))
        axes.grid(True)
    axes.legend(frameon=False, labelcolor=GREY, loc="lower right", title="torques of")
    title = "Growth of the worst small error [times]\nLine: median. Band: 80 % of the starts."
    figure.suptitle(title, x=0.02, ha="left", fontsize="medium")
    write_figure(figure, path)
