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
from jackbox_env.states import (
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
SIDEWAYS, DISTURBED = [0, 2, 3, 4, 6, 7], [0, 3, 4, 7]  # all but the height; those of the jack
_ORDER = [X_JACK, Y_JACK, THETA_BOX, THETA_JACK, VX_JACK, VY_JACK, OMEGA_BOX, OMEGA_JACK]
REDUCE, LIFT = np.eye(12)[_ORDER], np.eye(12)[:, _ORDER]
REDUCE[[0, 1, 4, 5], [X_BOX, Y_BOX, VX_BOX, VY_BOX]] = -1.0

WEIGHTS = np.array([0.01, 0.0, 1.0, 1.0, 0.01, 0.0, 1.0, 1.0])  # of z^2 in UNITS; position and sideways speed may wait
EFFORT = 100.0  # weight of a torque^2 in units of the limit
SIZES, SHOWN = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0), 3  # of disturbances; which one is drawn
STARTS, SECONDS, NEAR, SEED = 256, 20.0, 0.1, 1  # of each size; deviation in the last period that counts as held


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


def disturbed(bounce: Array) -> Array:
    """Starts (sizes * STARTS, 8): x, angle, sideways speed and spin of the jack moved in random directions."""
    directions = np.random.default_rng(SEED).standard_normal((len(SIZES), STARTS, len(DISTURBED)))
    directions *= np.array(SIZES)[:, None, None] / np.linalg.norm(directions, axis=2, keepdims=True)
    starts = np.tile(bounce[0], (len(SIZES), STARTS, 1))
    starts[..., DISTURBED] += directions * UNITS[DISTURBED]
    return starts.reshape(-1, 8)


def deviations(bounce: Array, feedback: Array, clock: bool) -> Array:
    """Distances of the jacks from the bounce after each step, in UNITS without the height, (steps, sizes, STARTS).

    ``feedback`` has the gains (PERIOD, 8), chosen by the ``clock`` or by the jack's phase.
    """
    states, distances = disturbed(bounce) @ LIFT.T, []
    for step in trange(round(SECONDS / DT), desc="bounces", unit="step", leave=False):
        z = states @ REDUCE.T
        ahead = np.full(len(z), step) if clock else np.rint((phase(z) - phase(bounce[:1])) * PERIOD)
        k = ahead.astype(np.intp) % PERIOD
        torques = -((z - bounce[k]) * feedback[k]).sum(axis=1).clip(-SCENE.torque_limit, SCENE.torque_limit)
        states = rollout(SCENE, states, torques[:, None], DT, trajectories=False)[0][:, 1]
        off = (states @ REDUCE.T - bounce[0])[:, SIDEWAYS] / UNITS[SIDEWAYS]
        distances.append(np.linalg.norm(off, axis=1).reshape(len(SIZES), STARTS))
    return np.array(distances)


def measure() -> dict[str, Any]:
    """Newton's residuals, multipliers (real, imaginary), products of their pairs, and deviations of disturbed jacks."""
    start, residuals = newton(np.array([0.1, FLOOR + 1.3, 0.02, 0.03, 0.02, 0.05, -0.01, 0.03]))
    bounce, by_state, by_torque = period(start)
    feedback = gains(by_state, by_torque)
    closed_loop = by_state - by_torque[:, :, None] * feedback[:, None]
    free, controlled = multipliers(by_state), multipliers(closed_loop)
    runs = {
        "by phase": (feedback, False),
        "by clock": (feedback, True),
        "no torque": (np.zeros_like(feedback), True),
    }
    off = {name: deviations(bounce, *how) for name, how in runs.items()}
    return {
        "start": start.tolist(),
        "residuals": residuals,
        "multipliers": np.stack([free.real, free.imag], axis=1).tolist(),
        "pairs": abs(free * free[::-1])[:4].tolist(),
        "controlled": np.stack([controlled.real, controlled.imag], axis=1).tolist(),
        "starts": STARTS,
        "seconds": SECONDS,
        "sizes": SIZES,
        "share_held": {name: (one[-PERIOD:].max(axis=0) < NEAR).mean(axis=1).tolist() for name, one in off.items()},
        "deviation": {name: np.median(one[4::5, SHOWN], axis=1).tolist() for name, one in off.items()},
    }


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Draw how a disturbance grows or fades, and the share held against the disturbance's size."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    styles = {"by phase": (JACK, "-"), "by clock": (BOX, "--"), "no torque": (GREY, ":")}
    for name, (color, line) in styles.items():
        off = results["deviation"][name]
        times = results["seconds"] * np.arange(1, len(off) + 1) / len(off)
        left.semilogy(times, off, line, color=color)
        shares = 100.0 * np.array(results["share_held"][name])
        right.semilogx(results["sizes"], shares, line, marker="o", markersize=4, color=color, label=name)
    left.set(xlabel="time [s]", ylabel=f"deviation (median), from {SIZES[SHOWN]:g}")
    right.set(xlabel="size of the disturbance", ylabel=f"held for {results['seconds']:g} s [%]")
    right.legend(frameon=False, labelcolor=GREY)
    for axes in (left, right):
        axes.grid(True)
    write_figure(figure, path)
