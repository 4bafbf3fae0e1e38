"""A trajectory: the states of a simulation or of an episode, step by step, its impacts, and files of them."""

from __future__ import annotations

import csv
import importlib
import json
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, Array, Numbers
from jackbox_env.simulators import Impact, JackLostError, Simulator
from jackbox_env.tools.files import new_file


@dataclass(frozen=True)
class Trajectory:
    """The states of a simulation or an episode in n - 1 steps, and its impacts.

    Attributes:
        times: [s], shape (n,).
        states: SI units, shape (n, 12).
        torques: mean torque on the box over each step [N m], shape (n - 1,).
        counts: number of impacts of each step, shape (n - 1,).
        impacts: in time order.
        driven: whether the torques were the scene's drive's; otherwise each was constant through its step.
        failure: the reason of an early end, if there was one.
    """

    times: NDArray[np.float64]
    states: NDArray[np.float64]
    torques: NDArray[np.float64]
    counts: NDArray[np.int64]
    impacts: list[Impact]
    driven: bool = True
    failure: str | None = None


class TrajectoryRecorder:
    """Collects the steps of a trajectory.

    Args:
        state: at the start, shape (12,), SI units.
        time: at the start [s].
        driven: whether the torques are the scene's drive's.
    """

    def __init__(self, state: Array, time: float, driven: bool = True) -> None:
        self._times, self._states, self._driven = [time], [state], driven
        self._torques, self._counts, self._impacts = list[float](), list[int](), list[Impact]()

    def add(self, state: Array, time: float, torque: float, impacts: Sequence[Impact]) -> None:
        """Record a step: state and time [s] at its end, its mean torque [N m], its impacts."""
        self._times.append(time)
        self._states.append(state)
        self._torques.append(torque)
        self._counts.append(len(impacts))
        self._impacts += impacts

    def trajectory(self, failure: str | None = None) -> Trajectory:
        """The trajectory so far."""
        return Trajectory(
            np.array(self._times),
            np.array(self._states),
            np.array(self._torques),
            np.array(self._counts, dtype=np.int64),
            list(self._impacts),
            self._driven,
            failure,
        )


def simulate(
    simulator: Simulator, seconds: float, dt: float, progress: bool = True, torques: Numbers | None = None
) -> Trajectory:
    """Step for ``seconds`` in steps of ``dt`` [s]; a jack that leaves the box ends it early.

    Args:
        simulator: from its present state on.
        seconds: simulated time [s].
        dt: duration of a step [s].
        progress: show a bar.
        torques: on the box in each step [N m]; None: the scene's drive acts.
    """
    recorder = TrajectoryRecorder(simulator.state, simulator.time, torques is None)
    with _bar(range(max(1, round(seconds / dt))), progress) as steps:
        for number in steps:
            try:
                recorder.add(*simulator.step(dt, None if torques is None else torques[number]))
            except JackLostError as error:
                return recorder.trajectory(str(error))
    return recorder.trajectory()


def _bar(steps: Iterable[int], progress: bool) -> AbstractContextManager[Iterable[int]]:
    """The steps, with a progress bar if tqdm is installed; it is erased at the block's end."""
    try:
        tqdm: Any = importlib.import_module("tqdm").tqdm
    except ImportError:
        return nullcontext(steps)
    bar: AbstractContextManager[Iterable[int]] = tqdm(steps, unit="step", leave=False, disable=not progress)
    return bar


def write_csv(trajectory: Trajectory, scene: Scene, folder: Path) -> list[Path]:
    """Write states.csv (time, the 12 numbers, torque), impacts.csv (time, wall, foot, impulse) and scene.json.

    Digits are in full. The first line names each column with its unit. A row's torque is the mean over the step that
    begins there; the last row's is empty.

    Raises:
        FileExistsError: a file is there already.
        ValueError: the scene's drive has no JSON form.
    """
    fields = scene.as_dict()
    units = zip(STATE_NAMES, STATE_UNITS, strict=True)
    states = ["time [s]", *(f"{name} [{unit}]" for name, unit in units), "torque [N m]"]
    torques: list[float | str] = [*trajectory.torques.tolist(), ""]
    rows = np.column_stack([trajectory.times, trajectory.states]).tolist()
    impacts = ["time [s]", "wall", "foot", "impulse [N s]"]
    return [
        _table(folder / "states.csv", states, [[*row, torque] for row, torque in zip(rows, torques, strict=True)]),
        _table(folder / "impacts.csv", impacts, trajectory.impacts),
        _json(folder / "scene.json", fields),
    ]


def _json(path: Path, content: Any) -> Path:
    with new_file(path) as partial:
        partial.write_text(json.dumps(content, indent=2) + "\n")
    return path


def _table(path: Path, names: Sequence[str], rows: Iterable[Sequence[float | str]]) -> Path:
    with new_file(path) as partial, partial.open("w", newline="") as file:
        csv.writer(file).writerows([names, *rows])
    return path


def write_npz(trajectory: Trajectory, scene: Scene, folder: Path) -> list[Path]:
    """Write trajectory.npz: time (n,), state (n, 12), torque (n - 1,), and impact_time, _wall, _foot, _impulse (m,).

    Its text ``scene`` is the JSON of the scene's fields.

    Raises:
        FileExistsError: the file is there already.
        ValueError: the scene's drive has no JSON form.
    """
    path = folder / "trajectory.npz"
    arrays: dict[str, NDArray[Any]] = {
        "time": trajectory.times,
        "state": trajectory.states,
        "torque": trajectory.torques,
    }
    arrays["scene"] = np.array(json.dumps(scene.as_dict()))
    for name in Impact._fields:
        arrays[f"impact_{name}"] = np.array([getattr(hit, name) for hit in trajectory.impacts])
    with new_file(path) as partial:
        np.savez(partial, **arrays)  # type: ignore[arg-type]
    return [path]
