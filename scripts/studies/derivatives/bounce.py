"""A periodic bounce: located by Newton's method, its Floquet multipliers, and an LQR that stabilises it.

The jack bounces upright on one foot on the level box, 51 control steps from impact to impact. Each impact makes the box
sink faster. But the motion of box and jack relative to each other does not depend on a shared position or velocity, and
that motion repeats. So 8 of the 12 numbers remain:

    z = (x, y of the jack relative to the box, angles of box and jack, and the rates of these four).

``REDUCE`` (8, 12) maps a state to z. ``LIFT`` (12, 8) maps z to a state whose box is at the origin with its centre at
rest. The derivative of a period is the product of REDUCE A LIFT over its steps. Its eigenvalues are the Floquet
multipliers. The motion is Hamiltonian, so they come in pairs of product 1. One pair is (1, 1): the bounce may start at
any phase, and bounces of other heights are next to it. So each Newton step is the shortest solution of its equations.

The LQR turns the box by angles and sideways motion. To first order no torque changes the height, so it is left alone.
The gains belong to the 51 phases of a period. They are chosen by the clock, or by the phase that the jack is in.
A jack starts in each of these phases, with some spin. Its lean is the angle by which it is not upright.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tqdm import trange

from jackbox_env import Scene, linearize, rollout
from jackbox_env.commands.plots import BOX, GREY, JACK, write_figure
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
)

SCENE = Scene(drive=None)
DT, PERIOD = 0.02, 51  # control step [s]; control steps of the bounce
FLOOR = SCENE.jack_arm - SCENE.box_half_width  # y at the impact [m]
SPEED = (SCENE.gravity * SCENE.jack_arm) ** 0.5  # unit of speeds [m/s]
UNITS = np.array([SCENE.jack_arm] * 2 + [1.0] * 2 + [SPEED] * 2 + [SPEED / SCENE.jack_arm] * 2)
_ORDER = [X_JACK, Y_JACK, THETA_BOX, THETA_JACK, VX_JACK, VY_JACK, OMEGA_BOX, OMEGA_JACK]
REDUCE, LIFT = np.eye(12)[_ORDER], np.eye(12)[:, _ORDER]
REDUCE[[0, 1, 4, 5], [X_BOX, Y_BOX, VX_BOX, VY_BOX]] = -1.0

WEIGHTS = np.array([0.01, 0.0, 1.0, 1.0, 0.01, 0.0, 1.0, 1.0])  # of z^2 in UNITS; position and sideways speed may wait
EFFORT = 100.0  # weight of a torque^2 in units of the limit
SPINS, SHOWN = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0), 10.0  # at the start [°/s]; the one over time
STYLES = {"gains by phase": (JACK, "-", "o"), "gains by clock": (BOX, "--", "s"), "no torque": (GREY, ":", "^")}
SECONDS, UPRIGHT = 20.0, 3.0  # a jack is stabilised that leans less [°] throughout the last period


def period(z: Array) -> tuple[Array, Array, Array]:
    """The motion through a period without torque, (PERIOD + 1, 8), and its steps' derivatives by z and by torque."""
    lin = linearize(SCENE, LIFT @ z, np.zeros(PERIOD), DT)  # its derivatives are NaN if an impact ends a step
    return lin.trajectories[0] @ REDUCE.T, REDUCE @ lin.A[0] @ LIFT, lin.B[0] @ REDUCE.T


def product(matrices: Array) -> Array:
    """Product of matrices (n, 8, 8), of which the first acts first."""
    result: Array = np.linalg.multi_dot(list(matrices[::-1]))
    return result


def multipliers(matrices: Array) -> NDArray[np.complex128]:
    """Eigenvalues of the product of matrices (n, 8, 8), the largest first."""
    eigenvalues = np.linalg.eigvals(product(matrices)).astype(np.complex128)
    return eigenvalues[np.argsort(-abs(eigenvalues))]


def newton(z: Array, iterations: int = 6) -> tuple[Array, list[float]]:
    """A start to which the motion returns after a period, and for each iteration the distance between start and end."""
    residuals = []
    for _ in range(iterations):
        motion, by_state, _ = period(z)
        residuals.append(float(np.linalg.norm(motion[-1] - z)))
        z = z + np.linalg.lstsq(product(by_state) - np.eye(8), z - motion[-1], rcond=1e-6)[0]
    return z, residuals


def gains(by_state: Array, by_torque: Array, periods: int = 40) -> Array:
    """Gains (PERIOD, 8) of torque = -gain (z - bounce) [N m]: Riccati's recursion, back through some periods."""
    weights, effort = np.diag(WEIGHTS / UNITS**2), EFFORT / SCENE.torque_limit**2
    cost, gain = np.zeros((8, 8)), np.zeros((PERIOD, 8))
    for k in list(range(PERIOD - 1, -1, -1)) * periods:
        a, b = by_state[k], by_torque[k]
        gain[k] = b @ cost @ a / (effort + b @ cost @ b)
        cost = weights + a.T @ cost @ (a - np.outer(b, gain[k]))
        cost = 0.5 * (cost + cost.T)
    return gain


def phase(z: Array) -> Array:
    """The elapsed share of its bounce for each jack of z (n, 8), from its height and speed."""
    landing = np.sqrt(z[:, 5] ** 2 + 2.0 * SCENE.gravity * np.maximum(z[:, 1] - FLOOR, 0.0))
    return 0.5 - 0.5 * z[:, 5] / np.maximum(landing, 1e-9)


def leans_of(bounce: Array, feedback: Array, clock: bool) -> Array:
    """The jacks' leans [°] after each step, (steps, SPINS, PERIOD), from each spin in each phase of the bounce.

    ``feedback`` has the gains (PERIOD, 8), chosen by the ``clock`` or by the jack's phase.
    """
    starts = np.tile(bounce[:PERIOD], (len(SPINS), 1, 1))
    starts[..., _ORDER.index(OMEGA_JACK)] += np.radians(SPINS)[:, None]
    states, phases, leaning = starts.reshape(-1, 8) @ LIFT.T, np.tile(np.arange(PERIOD), len(SPINS)), []
    for step in trange(round(SECONDS / DT), desc="bounces", unit="step", leave=False, disable=None):
        z = states @ REDUCE.T
        ahead = phases + step if clock else np.rint((phase(z) - phase(bounce[:1])) * PERIOD)
        k = ahead.astype(np.intp) % PERIOD
        torques = -((z - bounce[k]) * feedback[k]).sum(axis=1).clip(-SCENE.torque_limit, SCENE.torque_limit)
        states = rollout(SCENE, states, torques[:, None], DT, trajectories=False)[0][:, 1]
        leaning.append(np.degrees(abs(states[:, THETA_JACK])).reshape(len(SPINS), PERIOD))
    return np.array(leaning)


def measure() -> dict[str, Any]:
    """Newton's residuals, multipliers (real, imaginary), products of their pairs, and leans of spun jacks."""
    start, residuals = newton(np.array([0.1, FLOOR + 1.3, 0.02, 0.03, 0.02, 0.05, -0.01, 0.03]))
    bounce, by_state, by_torque = period(start)
    feedback = gains(by_state, by_torque)
    closed_loop = by_state - by_torque[:, :, None] * feedback[:, None]
    free, controlled = multipliers(by_state), multipliers(closed_loop)
    runs = {
        "gains by phase": (feedback, False),
        "gains by clock": (feedback, True),
        "no torque": (np.zeros_like(feedback), True),
    }
    leaning = {name: leans_of(bounce, *how) for name, how in runs.items()}
    return {
        "start": start.tolist(),
        "residuals": residuals,
        "multipliers": np.stack([free.real, free.imag], axis=1).tolist(),
        "pairs": abs(free * free[::-1])[:4].tolist(),
        "controlled": np.stack([controlled.real, controlled.imag], axis=1).tolist(),
        "starts": PERIOD,
        "seconds": SECONDS,
        "spins": SPINS,
        "share_held": {
            name: (of[-PERIOD:].max(axis=0) < UPRIGHT).mean(axis=1).tolist() for name, of in leaning.items()
        },
        "lean": {name: np.median(of[4::5, SPINS.index(SHOWN)], axis=1).tolist() for name, of in leaning.items()},
    }


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw how the lean grows or fades, and the share of stabilised jacks against their spin at the start."""
    figure = Figure(figsize=(5.0, 6.2), layout="constrained")
    upper, lower = figure.subplots(2, 1)
    for name, (color, line, marker) in STYLES.items():
        leans, shares = results["lean"][name], 100.0 * np.array(results["share_held"][name])
        times = results["seconds"] * np.arange(1, len(leans) + 1) / len(leans)
        upper.semilogy(times, leans, line, marker=marker, markevery=25, markersize=5, color=color, label=name)
        lower.semilogx(results["spins"], shares, line, marker=marker, markersize=5, color=color)
    upper.set_title(f"Lean after a spin of {SHOWN:g} °/s: median [°]", loc="left", fontsize="medium")
    upper.set(xlabel="time [s]", xlim=(0.0, results["seconds"]), xticks=range(0, 21, 5))
    upper.legend(frameon=False, labelcolor=GREY)
    lower.set_title(f"Jacks upright after {results['seconds']:g} s [%]", loc="left", fontsize="medium")
    lower.set_xlabel("spin at the start [°/s]")
    lower.set_xticks(results["spins"], [f"{spin:g}" for spin in results["spins"]], minor=False)
    lower.minorticks_off()
    for axes in (upper, lower):
        axes.grid(True)
    write_figure(figure, path)
