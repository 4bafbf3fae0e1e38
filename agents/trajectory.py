"""The scene under its own drive for a while: states, impacts, and files of them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from agents.storage import new_file
from jackbox_env import Impact, JackLostError, Simulator
from jackbox_env.states import STATE_NAMES


@dataclass(frozen=True)
class Trajectory:
    """What a simulation went through.

    Attributes:
        times: [s], shape (n,).
        states: SI units, shape (n, 12).
        impacts: in time order.
        failure: what ended it early, if anything.
    """

    times: NDArray[np.float64]
    states: NDArray[np.float64]
    impacts: list[Impact]
    failure: str | None = None


def simulate(simulator: Simulator, seconds: float, dt: float, progress: bool = True) -> Trajectory:
    """Step under the scene's drive for ``seconds`` in steps of ``dt`` [s]; a jack that leaves the box ends it early."""
    times, states, impacts = [simulator.time], [simulator.state], list[Impact]()
    for _ in tqdm(range(max(1, round(seconds / dt))), disable=not progress, unit="step", leave=False):
        try:
            simulator.step(dt)
        except JackLostError as error:
            return Trajectory(np.array(times), np.array(states), impacts, str(error))
        times.append(simulator.time)
        states.append(simulator.state)
        impacts += simulator.impacts
    return Trajectory(np.array(times), np.array(states), impacts)


def write_csv(trajectory: Trajectory, folder: Path) -> list[Path]:
    """Write states.csv (time and the 12 numbers) and impacts.csv (time, wall, foot, impulse), digits in full."""
    paths = [folder / "states.csv", folder / "impacts.csv"]
    with new_file(paths[0]) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *STATE_NAMES])
        for time, state in zip(trajectory.times.tolist(), trajectory.states.tolist(), strict=True):
            writer.writerow([repr(time), *map(repr, state)])
    with new_file(paths[1]) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Impact._fields)
        writer.writerows(trajectory.impacts)
    return paths


def write_npz(trajectory: Trajectory, folder: Path) -> list[Path]:
    """Write trajectory.npz: time (n,), state (n, 12), impact_time, impact_wall, impact_foot, impact_impulse (m,)."""
    path = folder / "trajectory.npz"
    columns = list(zip(*trajectory.impacts, strict=True)) or [()] * len(Impact._fields)
    named = {f"impact_{name}": np.array(column) for name, column in zip(Impact._fields, columns, strict=True)}
    with new_file(path) as partial:
        np.savez(partial, time=trajectory.times, state=trajectory.states, **named)  # type: ignore[arg-type]
    return [path]
