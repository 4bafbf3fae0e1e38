"""iLQR by derivatives through impacts, compared with iCEM: torques for 3.2 s of juggle from 32 starts, one thread each.

The method is that of ``jackbox_env.ilqr``.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import trange

from agents.policies.scripted import LevelPolicy
from agents.training.fitting import CONTROL_DT as DT
from agents.training.fitting import REPEAT, SCENE, advanced
from jackbox_env import ilqr
from jackbox_env.commands.plots import GREY, JACK, write_figure
from jackbox_env.envs.scoring import observed
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import sample_start
from jackbox_env.planning.icem import Search
from jackbox_env.planning.ilqr import MOST_ITERATIONS
from scripts.studies.derivatives.lyapunov import with_interval

KNOTS, PROBLEMS = 32, 32  # torques; starts
# Iterations of iCEM; the longer one needs as much time as the planner's and iLQR after it.
ITERATIONS = {"level": 0, "planner": 3, "longer": 50}


def level(start: Array) -> Array:
    """Torques of the PD controller from a start, at the planner's decisions, shape (KNOTS,)."""
    policy, now, torques = LevelPolicy(SCENE), start[None], np.zeros((KNOTS, 1))
    for torque in torques:
        torque[:] = policy.act(observed(SCENE, now))[0]
        now = advanced("juggle", now, torque)[0]
    return torques[:, 0]


def searched(start: Array, iterations: int, seed: int) -> Array:
    """The best plan of iCEM, started from no torque, shape (KNOTS,)."""
    search = Search(
        "juggle", DT, repeat=REPEAT, knots=KNOTS, samples=256, elites=20, iterations=iterations, seed=seed,
        num_threads=1,
    )  # fmt: skip
    plan: Array = search.decide(SCENE, start[None], search.begin(1))[0].plans[0]
    return plan


def improved(start: Array, plan: Array) -> dict[str, float]:
    """Improve a plan by iLQR: returns, time [s], iterations, steps without a derivative."""
    began = time.process_time()
    result = ilqr(SCENE, start, plan * SCENE.torque_limit, DT, repeat=REPEAT, num_threads=1)
    seconds = time.process_time() - began
    counts = {"iterations": result.iterations, "rough": result.nonsmooth}
    return {"before": result.before, "after": result.value, "seconds": seconds, **counts}


def measure() -> dict[str, Any]:
    """For each kind of plan: returns and core times [s], without iLQR and with it, compared with the longer iCEM."""
    runs: dict[str, list[dict[str, float]]] = {kind: [] for kind in ITERATIONS}
    for number in trange(-1, PROBLEMS, desc="iLQR", leave=False, disable=None):  # the first compiles, uncounted
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
    figure = Figure(figsize=(5.0, 4.2), layout="constrained")
    axes, rows = figure.subplots(), dict[int, str]()
    for number, (kind, iterations) in enumerate(ITERATIONS.items()):
        of, pair = results[kind], [3 * number, 3 * number + 1]
        *means, planning, seconds = (of[name]["mean"] for name in ("before", "after", "planning", "seconds"))
        axes.plot(np.transpose(of["returns"]), pair, "o-", color=GREY, alpha=0.35, markersize=3.0, linewidth=0.8)
        axes.plot(means, pair, "o-", color=JACK, markersize=8.0, linewidth=3.0)
        for mean, row, offset in zip(means, pair, (14, -14), strict=True):
            at: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "center"}
            axes.annotate(f"{mean:.1f}", (mean, row), (0, offset), **at)
        plan = f"iCEM, {iterations} iterations" if iterations else "PD controller"
        rows |= {pair[0]: f"{plan}\n{planning:.3f} s", pair[1]: f"then iLQR\n{planning + seconds:.3f} s"}
    axes.set_yticks(list(rows), list(rows.values()))
    axes.set_ylim(7.8, -0.8)
    axes.set_xlabel("return of 160 control steps")
    axes.grid(True, axis="x")
    write_figure(figure, path)
