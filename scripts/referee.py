"""Score the motions that another engine computes for the 40 cases of docs/reference.md.

Prints a table, and writes scores.json and a plot of the errors of the impact times into a new folder. The states must
include those at the end of every control step. Cases that the file does not have are named and not scored.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.fits.text import read_rows
from jackbox_env.measure.accuracy import Case, pose_errors
from jackbox_env.mechanics import energy_of
from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.model.states import (
    LARGEST,
    OMEGA_BOX,
    RATES,
    STATE_NAMES,
    THETA_BOX,
    THETA_JACK,
    Y_JACK,
    Array,
    clearance,
)
from jackbox_env.simulators import Impact
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import ROOT, command_line
from jackbox_env.tools.files import new_folder, write_json

STATES, IMPACTS = ("case", "time", *STATE_NAMES), ("case", "time", "wall", "foot")  # columns of the files
TOLERANCE = 0.01  # [s]
NEAR = 1e-6  # [s] a state this near to the end of a control step is the state there
EVERY = 0.1  # [s] between proven states
LEAST = 1e-17  # stands for 0: an error in the plot [s], the arm of a jack that is only its centre [m], no energy [J]

Known = tuple[Case, list[Impact]]  # a case of the reference, and its impacts
Table = dict[str, list[list[float]]]  # by case: the numbers of its lines


@dataclass(frozen=True)
class Arguments:
    """Score a file of states."""

    file: Path  # CSV of states with the columns case, time and the 12 numbers, x_box to omega_jack
    impacts: Path | None = None  # CSV of impacts: case, time, wall and foot; None: only the states are scored
    tolerance: float = TOLERANCE  # largest error of a correct impact's time [s]
    folder: Path | None = None  # new folder for scores.json and the plot; None: runs/referee-<date>-<time>


class Score(NamedTuple):
    """The score of one case; None if it cannot be measured."""

    case: str
    known: int  # impacts of the reference
    correct: int | None  # impacts before the first wrong one
    complete: bool | None  # whether all impacts are correct, and there are no others
    errors: list[float] | None  # of the correct impacts' times [s]
    penetration: float  # deepest that a foot of a state was in a wall [m]
    imbalance: float | None  # largest |energy gained - work| over the largest kinetic energy
    escaped: bool  # the jack's centre left the box, or the output ends early
    pose: float | None  # largest error of a pose before the first wrong impact [m], as by ``pose_errors``
    rate: float | None  # the same of the rates [m/s]


# -- the reference -----------------------------------------------------------------------------------------------------


def prefix_errors(impacts: Sequence[Impact], reference: Sequence[Impact]) -> list[float]:
    """Errors of the impact times [s] over the longest common start of both, by wall and foot.

    Impacts recorded at one time (a substep's end, two feet at once) have no order.
    """
    rest, errors = list(impacts), list[float]()
    for number, expected in enumerate(reference):
        index = number
        while index < len(rest) and rest[index][1:3] != expected[1:3]:
            index += 1
            together = index < len(rest) and rest[index].time == rest[number].time
            alike = index < len(reference) and reference[index].time == expected.time
            if not (together or alike):
                return errors
        if index >= len(rest):
            return errors
        rest.insert(number, rest.pop(index))
        errors.append(abs(rest[number].time - expected.time))
    return errors


def scene_of(record: dict[str, Any]) -> Scene:
    """The scene of a case in the file, with its chirp as the drive."""
    torque = dict(record["torque"])
    return Scene(**record["scene"], drive=Chirp(**torque) if torque.pop("kind") == "chirp" else None)


@cache
def _records() -> list[dict[str, Any]]:
    """The cases of the file."""
    records: list[dict[str, Any]] = json.loads((ROOT / "docs" / "reference" / "cases.json").read_text())["cases"]
    return records


@cache
def proven_states() -> dict[str, Array]:
    """The states after every 0.1 s, shape (n, 12), by the cases' names."""
    return {one["name"]: np.array(one["states"]) for one in _records()}


@cache
def reference() -> dict[str, Known]:
    """The 40 cases by name."""
    cases = dict[str, Known]()
    for one in _records():
        start, steps, torques = np.array(one["start"]), round(one["duration"] / one["dt"]), one["torque"].get("values")
        impacts = [Impact(float(hit["time"]), hit["wall"], hit["foot"], hit["impulse"]) for hit in one["impacts"]]
        cases[one["name"]] = Case(one["name"], scene_of(one), start, steps, torques, one["dt"]), impacts
    return cases


# -- scoring -----------------------------------------------------------------------------------------------------------


def score(
    known: Known, times: Array, states: Array, impacts: list[Impact] | None, tolerance: float = TOLERANCE
) -> Score:
    """Score states, shape (n, 12), at increasing times, shape (n,) [s], and impacts.

    Raises:
        ValueError: the states lack the end of a control step before their last.
    """
    (case, expected), scene = known, known[0].scene
    ends = case.dt * np.arange(1, case.steps + 1)
    ends = ends[ends <= times[-1] + NEAR]
    rows = np.searchsorted(times, ends + NEAR, side="right") - 1  # the last of those at an end: after an impact there
    if lacking := ends[(rows < 0) | (np.abs(times[rows] - ends) > NEAR)].tolist():
        raise ValueError(f"{case.name} must have a state at t = {lacking[0]:g} s, the end of a control step")
    at_ends, point = np.vstack([case.state, states[rows]]), scene.changed(jack_arm=LEAST)
    errors = None
    if impacts is not None:
        errors = list(takewhile(lambda error: error <= tolerance, prefix_errors(impacts, expected)))
    correct = 0 if errors is None else len(errors)
    wrong = expected[correct].time if correct < len(expected) else math.inf
    return Score(
        case.name,
        len(expected),
        None if errors is None else len(errors),
        None if errors is None or impacts is None else len(errors) == len(expected) == len(impacts),
        errors,
        max(0.0, *(-clearance(scene, state) for state in states.tolist())),
        _imbalance(case, at_ends),
        len(ends) < case.steps or any(clearance(point, state) < 0.0 for state in states.tolist()),
        *_motion_errors(case, at_ends, wrong),
    )


def _motion_errors(case: Case, states: Array, wrong: float) -> tuple[float | None, float | None]:
    """Largest errors of poses [m] and rates [m/s] from the proven states before the time ``wrong`` [s].

    Of the states at the ends of the control steps, the start first; None if there are none to compare.
    """
    every, proven = round(EVERY / case.dt), proven_states()[case.name]
    count = min(len(states[every::every]), math.ceil(min(wrong / EVERY, len(proven) + 1)) - 1)
    if count <= 0:
        return None, None
    off = states[every::every][:count] - proven[:count]
    off[:, [THETA_BOX, THETA_JACK]] -= _whole_turns(off[:, [THETA_BOX, THETA_JACK]])
    poses, rates = (pose_errors(case.scene, part, np.zeros_like(part)) for part in (off, np.roll(off, -RATES, axis=1)))
    return float(poses.max()), float(rates.max())


def _whole_turns(angles: Array) -> Array:
    """The nearest whole turns [rad]."""
    turns: Array = 2.0 * np.pi * np.round(angles / (2.0 * np.pi))
    return turns


def _imbalance(case: Case, states: Array) -> float | None:
    """Energy against work, from the states at the ends of the control steps; None with loss or under a chirp.

    An angle that wraps jumps by whole turns: those nearest to what the rates do not explain are taken out.
    """
    scene = case.scene
    if not scene.elastic or scene.drive is not None:
        return None
    energies = np.array([energy_of(scene, state) for state in states.tolist()])
    turned, rates = np.diff(states[:, THETA_BOX]), states[:, OMEGA_BOX]
    turned -= _whole_turns(turned - 0.5 * case.dt * (rates[1:] + rates[:-1]))
    works = np.cumsum((case.torques or [0.0] * case.steps)[: len(turned)] * turned)
    kinetic = energies - scene.jack_mass * scene.gravity * states[:, Y_JACK]
    return float(np.abs(energies[1:] - energies[0] - works).max(initial=0.0) / max(LEAST, kinetic.max()))


def summary(scores: Sequence[Score], tolerance: float = TOLERANCE) -> dict[str, Any]:
    """Totals, medians and worst values over cases."""
    firsts = [one.errors[0] for one in scores if one.errors]
    energies = [one.imbalance for one in scores if one.imbalance is not None]
    poses = [one.pose for one in scores if one.pose is not None]
    return {
        "cases": len(scores),
        "tolerance": tolerance,
        "known": sum(one.known for one in scores),
        "correct": sum(one.correct or 0 for one in scores),
        "complete": sum(bool(one.complete) for one in scores),
        "first_median": float(np.median(firsts)) if firsts else None,
        "first_worst": max(firsts, default=None),
        "penetration": max((one.penetration for one in scores), default=None),
        "energy_median": float(np.median(energies)) if energies else None,
        "energy_worst": max(energies, default=None),
        "escaped": sum(one.escaped for one in scores),
        "pose_median": float(np.median(poses)) if poses else None,
        "pose_worst": max(poses, default=None),
        "rate_worst": max((one.rate for one in scores if one.rate is not None), default=None),
    }


# -- files -------------------------------------------------------------------------------------------------------------


def read_table(path: Path, columns: Sequence[str]) -> Table:
    """Read a CSV file.

    Raises:
        OSError: the file cannot be read.
        ValueError: no CSV, other columns, an unknown case, something that is not a number below 1e100, or times that
            decrease or are not within the case.
    """
    table: Table = {}
    head, lines, rows_of_file, *_ = read_rows(path, columns[0])
    if tuple(head) != tuple(columns):
        raise ValueError(f"{path} must begin with the columns {','.join(columns)}, got {check.shown(','.join(head))}")
    for number, (name, *cells) in zip(lines, rows_of_file, strict=True):
        line = f"{path}, line {number}:"
        if name not in reference():
            raise ValueError(f"{line} there is no case {check.shown(name)}{check.closest(name[:80], reference())}")
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            numbers = []
        if len(numbers) != len(columns) - 1 or not all(abs(number) < LARGEST for number in numbers):
            raise ValueError(
                f"{line} a case must be followed by {len(columns) - 1} numbers below {LARGEST:g}, got "
                f"{check.shown(','.join(cells))}"
            )
        rows, case = table.setdefault(name, []), reference()[name][0]
        since = rows[-1][0] if rows else 0.0
        if not since <= numbers[0] <= case.dt * case.steps + NEAR:
            bounds = f"from {since:g} s{', that of the line before,' * bool(rows)} to {case.dt * case.steps:g} s"
            raise ValueError(f"{line} the time must be {bounds}, got {numbers[0]:g} s")
        rows.append(numbers)
    return table


def scores_of(states: Table, impacts: Table | None, tolerance: float) -> list[Score]:
    """Score what two files have.

    Raises:
        ValueError: impacts of a case without states, a wall or a foot that is not 0, 1, 2 or 3, or no case at all.
    """
    for name, hits in (impacts or {}).items():
        if name not in states:
            raise ValueError(f"{name} has impacts, so it must have states too")
        if wrong := [hit for hit in hits if not {*hit[1:]} <= {0, 1, 2, 3}]:
            raise ValueError(f"walls and feet of {name} must be 0, 1, 2 or 3, got {wrong[0][1:]}")
    if not states:
        raise ValueError("there is no case in the file of states")
    scores = []
    for name, rows in states.items():
        times, numbers = np.split(np.array(rows), [1], axis=1)
        reported = None if impacts is None else [Impact(*hit, np.nan) for hit in impacts.get(name, [])]  # type: ignore[call-arg,arg-type]
        scores.append(score(reference()[name], times[:, 0], numbers, reported, tolerance))
    return scores


def table_of(scores: Iterable[Score]) -> str:
    """A line for each case."""
    rows: list[tuple[str, ...]] = [
        (
            "case",
            "correct impacts",
            "first impact [s]",
            "pose [m]",
            "rate [m/s]",
            "penetration [m]",
            "energy",
            "escaped",
        )
    ]
    for one in scores:
        correct = (
            "-"
            if one.correct is None
            else f"{one.correct} of {one.known}" + ", and others" * (one.correct == one.known and not one.complete)
        )
        first = one.errors[0] if one.errors else None
        numbers = (
            "-" if number is None else f"{number:.1e}"
            for number in (first, one.pose, one.rate, one.penetration, one.imbalance)
        )
        rows.append((one.case, correct, *numbers, "yes" * one.escaped))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def medians(scores: Iterable[Score]) -> list[float]:
    """The median error of the k-th impact over the cases in which it is correct [s], for k = 1, 2 and so on."""
    errors = [one.errors for one in scores if one.errors]
    ranked = ([one[k] for one in errors if len(one) > k] for k in range(max(map(len, errors), default=0)))
    return [max(LEAST, float(np.median(some))) for some in ranked]


def draw(scores: Sequence[Score], path: Path) -> None:
    """Draw the error of the k-th impact against k: a line for each case, and the median."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import GREY, JACK, write_figure

    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for one in scores:
        axes.plot(range(1, len(one.errors or []) + 1), np.maximum(one.errors or [], LEAST), color=GREY, alpha=0.4)
    axes.plot(range(1, len(medians(scores)) + 1), medians(scores), "o-", color=JACK)
    axes.set(
        yscale="log",
        xticks=range(1, len(medians(scores)) + 1, 2),
        xlabel="impact",
        ylabel="error of its time [s]",
        title="Correct impacts; with dots: median",
    )
    write_figure(figure, path)


@command_line
def main() -> None:
    """Read, score, print, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__, config=(tyro.conf.PositionalRequiredArgs,))
    tolerance = check.real("tolerance", arguments.tolerance, above=0.0)
    impacts = None if arguments.impacts is None else read_table(arguments.impacts, IMPACTS)
    scores = scores_of(read_table(arguments.file, STATES), impacts, tolerance)
    total = summary(scores, tolerance)
    lines = (f"{name}: {'-' if value is None else format(value, '.4g')}" for name, value in total.items())
    print(table_of(scores), *lines, sep="\n")
    if missing := [name for name in reference() if name not in {one.case for one in scores}]:
        print(f"{len(missing)} of {len(reference())} cases are missing and not scored: {', '.join(missing)}")

    def fill(folder: Path) -> None:
        write_json(folder / "scores.json", {"summary": total, "cases": [one._asdict() for one in scores]})
        draw(scores, folder / "impacts.png")

    print(f"Wrote {new_folder(arguments.folder, 'referee', fill)}")


if __name__ == "__main__":
    main()
