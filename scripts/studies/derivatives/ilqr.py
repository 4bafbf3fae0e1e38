"""iLQR by derivatives through impacts, compared with iCEM: torques for 3.2 s of juggle from 32 starts, one thread each.

iLQR (Tassa et al. 2012, doi:10.1109/IROS.2012.6386025) with bounded torques (Tassa et al. 2014,
doi:10.1109/ICRA.2014.6907001): a backward pass over the linearised motion, then a line search by exact rollouts. A
step without a derivative interrupts the backward pass: earlier torques are chosen as if nothing followed.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import trange

from agents.policies.observing import observations
from agents.policies.scripted import LevelPolicy
from jackbox_env import Scene, linearize, rollout
from jackbox_env.commands.plots import GREY, JACK, write_figure
from jackbox_env.planning.icem import Search
from jackbox_env.states import THETA_BOX, THETA_JACK, X_BOX, X_JACK, Array
from jackbox_env.tasks import sample_start
from scripts.studies.derivatives.lyapunov import with_interval

SCENE = Scene(drive=None)
DT, REPEAT, KNOTS, PROBLEMS = 0.02, 5, 32, 32  # control step [s]; action repeat; torques; starts
# Iterations of iCEM; the longer one needs as much time as the planner's and iLQR after it.
ITERATIONS = {"level": 0, "planner": 3, "longer": 50}
LENGTHS = 0.5 ** np.arange(12)  # of the line search
LEAST_GAIN, MOST_ITERATIONS, MOST_DAMPING = 1e-3, 200, 1e6  # of a step [return]; number; [return / limit^2]
CLOSEST = 0.1  # [m] from the middle, where the reward's kink is smoothed
ROOM = SCENE.box_half_width - SCENE.jack_arm  # [m] distance at which the reward is 0


def advanced(states: Array, torques: Array) -> tuple[Array, Array]:
    """States after one torque each, shape (n, 12), and the sums of rewards, (n,); torques in units of the limit."""
    constant = torques[:, None] * SCENE.torque_limit
    played = rollout(SCENE, states, constant, DT, rewards="juggle", repeat=REPEAT, trajectories=False, num_threads=1)
    return played.trajectories[:, 1], played.rewards.sum(axis=1)


def level(start: Array) -> Array:
    """Torques of the PD controller from a start, at the planner's decisions, shape (KNOTS,)."""
    policy, now, torques = LevelPolicy(SCENE), start[None], np.zeros((KNOTS, 1))
    for torque in torques:
        torque[:] = np.clip(policy.act(observations(SCENE, now).astype(np.float64)), -1.0, 1.0)
        now, _ = advanced(now, torque)
    return torques[:, 0]


def searched(start: Array, iterations: int, seed: int) -> Array:
    """The best plan of iCEM, started from no torque, shape (KNOTS,)."""
    search = Search(
        "juggle", DT, repeat=REPEAT, knots=KNOTS, samples=256, elites=20, iterations=iterations, seed=seed,
        num_threads=1,
    )  # fmt: skip
    plan: Array = search.decide(SCENE, start[None], search.begin(1))[0].plans[0]
    return plan


def closed_loop(start: Array, plans: Array, old: Array, gains: Array) -> tuple[Array, Array, Array]:
    """Play plans, shape (n, KNOTS), plus gains, (KNOTS, 12), times the deviations from old states, (KNOTS + 1, 12).

    Returns:
        returns, (n,), torques within the limit, (n, KNOTS), states at which they begin and end, (n, KNOTS + 1, 12).
    """
    returns, torques, states = np.zeros(len(plans)), plans.copy(), np.repeat(start[None, None], len(plans), axis=0)
    for knot in range(KNOTS):
        unclipped = plans[:, knot] + (states[:, -1] - old[knot]) @ gains[knot]
        torques[:, knot] = np.clip(unclipped, -1.0, 1.0)
        now, rewards = advanced(states[:, -1], torques[:, knot])
        returns, states = returns + rewards, np.concatenate([states, now[:, None]], axis=1)
    return returns, torques, states


def expanded(start: Array, torques: Array) -> tuple[tuple[Array, Array, Array], int]:
    """The motion to first order and the lost reward to second, by the state and the torque at each knot's start.

    The curvature of a distance r is set to 1 / r along both axes: a paraboloid that touches the cone from above.

    Returns:
        derivatives of the next state, (KNOTS, 12, 13), slopes, (KNOTS, 13), and curvatures, (KNOTS, 13, 13); and the
        number of steps without a derivative.
    """
    lin = linearize(SCENE, start, torques * SCENE.torque_limit, DT, repeat=REPEAT, num_threads=1)
    ends = lin.trajectories[0, 1:]
    by_state = np.nan_to_num(lin.A).reshape(KNOTS, REPEAT, 12, 12)
    by_torque = np.nan_to_num(lin.B).reshape(KNOTS, REPEAT, 12) * SCENE.torque_limit
    off = (ends[:, X_JACK:THETA_JACK] - ends[:, X_BOX:THETA_BOX]).reshape(KNOTS, REPEAT, 2, 1)
    far = np.linalg.norm(off, axis=2, keepdims=True)
    weights = (far < ROOM) / (ROOM * np.maximum(far, CLOSEST))
    motion = np.repeat(np.eye(12, 13)[None], KNOTS, axis=0)
    slopes, curvatures = np.zeros((KNOTS, 13)), np.zeros((KNOTS, 13, 13))
    for step in range(REPEAT):
        motion = by_state[:, step] @ motion
        motion[:, :, 12] += by_torque[:, step]
        moved = motion[:, X_JACK:THETA_JACK] - motion[:, X_BOX:THETA_BOX]
        slopes += (weights[:, step] * off[:, step] * moved).sum(axis=1)
        curvatures += weights[:, step] * moved.transpose(0, 2, 1) @ moved
    return (motion, slopes, curvatures), int((~lin.smooth).sum())


def backward(torques: Array, model: tuple[Array, Array, Array], damping: float) -> tuple[Array, Array]:
    """Changes of the torques, shape (KNOTS,), and gains, (KNOTS, 12); zero where a torque reaches its limit."""
    changes, gains = np.zeros(KNOTS), np.zeros((KNOTS, 12))
    slope, curvature = np.zeros(12), np.zeros((12, 12))  # of the reward lost from this knot on, by the state
    for knot in range(KNOTS - 1, -1, -1):
        motion, slopes, curvatures = (part[knot] for part in model)
        slopes, curvatures = slopes + motion.T @ slope, curvatures + motion.T @ curvature @ motion
        unclipped = -slopes[12] / (curvatures[12, 12] + damping)
        changes[knot] = np.clip(unclipped, -1.0 - torques[knot], 1.0 - torques[knot])
        if changes[knot] == unclipped:
            gains[knot] = -curvatures[12, :12] / (curvatures[12, 12] + damping)
        closed = np.vstack([np.eye(12), gains[knot]])
        slope, curvature = closed.T @ (slopes + curvatures[:, 12] * changes[knot]), closed.T @ curvatures @ closed
    return changes, gains


def improved(start: Array, plan: Array) -> dict[str, float]:
    """Improve a plan by iLQR until no step gains ``LEAST_GAIN``: returns, time [s], iterations, nonsmooth steps."""
    began, count, damping = time.process_time(), 0, 1.0
    zeros = np.zeros((KNOTS, 12))
    best, torques, states = (part[0] for part in closed_loop(start, plan[None], zeros, zeros))
    before, (model, nonsmooth) = best, expanded(start, torques)
    while count < MOST_ITERATIONS and damping < MOST_DAMPING:
        changes, gains = backward(torques, model, damping)
        tried = closed_loop(start, torques + LENGTHS[:, None] * changes, states, gains)
        number, count = int(tried[0].argmax()), count + 1
        if tried[0][number] < best + LEAST_GAIN:
            damping *= 10.0
            continue
        best, torques, states = (part[number] for part in tried)
        damping = max(0.1 * damping, 1e-3) if number < 3 else damping
        model, missing = expanded(start, torques)
        nonsmooth += missing
    seconds = time.process_time() - began
    return {"before": float(before), "after": float(best), "seconds": seconds, "iterations": count, "rough": nonsmooth}


def measure() -> dict[str, Any]:
    """For each kind of plan: returns and core times [s], without iLQR and with it, compared with the longer iCEM."""
    runs: dict[str, list[dict[str, float]]] = {kind: [] for kind in ITERATIONS}
    for number in trange(-1, PROBLEMS, desc="iLQR", leave=False):  # the first compiles, and is not counted
        seed = max(0, number)
        start = sample_start(SCENE, np.random.default_rng(seed))
        for kind, iterations in ITERATIONS.items():
            began = time.process_time()
            plan = searched(start, iterations, seed) if iterations else level(start)
            planning = time.process_time() - began
            runs[kind] += [improved(start, plan) | {"planning": planning}] * (number >= 0)
    columns = {kind: {name: np.array([row[name] for row in rows]) for name in rows[0]} for kind, rows in runs.items()}
    same_time = columns["longer"]["before"]
    return {
        kind: {
            **{name: with_interval(column) for name, column in of.items()},
            "gain": with_interval(of["after"] - of["before"]),
            "beyond_longer_icem": with_interval(of["after"] - same_time),
            "stopped_by_limit": int((of["iterations"] >= MOST_ITERATIONS).sum()),
            "improved_by_1": int((of["after"] > of["before"] + 1.0).sum()),
            "above_longer_icem": int((of["after"] > same_time + 0.1).sum()),
            "below_longer_icem": int((of["after"] < same_time - 0.1).sum()),
            "returns": np.stack([of["before"], of["after"]], axis=1).tolist(),
        }
        for kind, of in columns.items()
    }


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw the returns of each start before and after iLQR, and their means with the times that they took."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for axes, (kind, iterations) in zip(panels, ITERATIONS.items(), strict=True):
        of = results[kind]
        *means, planning, seconds = (of[name]["mean"] for name in ("before", "after", "planning", "seconds"))
        axes.plot(np.transpose(of["returns"]), "o-", color=GREY, alpha=0.35, markersize=3.0, linewidth=0.8)
        axes.plot(means, "o-", color=JACK, markersize=8.0, linewidth=3.0)
        for end, mean in enumerate(means):
            offset = {"xytext": (20 * end - 10, 0), "textcoords": "offset points", "va": "center"}
            axes.annotate(f"{mean:.1f}", (end, mean), ha="left" if end else "right", **offset)
        axes.set_title(f"iCEM, {iterations} iterations" if iterations else "PD controller", fontsize="medium")
        axes.set_xticks([0, 1], [f"plan\n{planning:.3f} s", f"then iLQR\n{planning + seconds:.3f} s"])
        axes.set_xlim(-0.6, 1.6)
        axes.grid(True, axis="y")
    panels[0].set_ylabel("return of 160 control steps")
    write_figure(figure, path)
