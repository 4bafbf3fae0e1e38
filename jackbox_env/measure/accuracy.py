"""Run a contact model, inspect every step, and compare impacts and poses.

A :class:`Case` is a scene, a start and torques. :func:`follow` runs a simulator on it and inspects every step.
Impact times, their order and containment are compared. Energy alone proves nothing: a jack outside the box keeps it
perfectly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import (
    THETA_BOX,
    THETA_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    clearance,
    deepest_restored,
)
from jackbox_env.simulators import Impact, JackLostError, Simulator
from jackbox_env.simulators.replay import replayed

_REPLAY_TOLERANCE = 1e-6  # over L, of the end of a replay from the end of the model's step


class Case(NamedTuple):
    """A start, and the torques that follow or the drive."""

    name: str
    scene: Scene
    state: Array  # (12,)
    steps: int  # control steps
    torques: Sequence[float] | None = None  # constant in each control step [N m]; None: the scene's drive
    dt: float = 0.02  # control step [s]
    time: float = 0.0  # at the start [s]


class Between(NamedTuple):
    """The inside of one control step; NaN if it cannot be determined."""

    depth: float  # deepest that a foot was in a wall at an impact or at the step's end [m]; negative: none was
    work: float  # of torque and side forces on the box [J]


Inspect = Callable[[Simulator, Array, float, float | None], Between]


class Course(NamedTuple):
    """The course of a simulator through a case."""

    states: Array  # (steps taken + 1, 12)
    impacts: list[Impact]
    depth: float  # deepest that a foot was in a wall at an impact or a step's end [m]; negative: none was
    imbalance: float  # largest |energy gained - work done| at the end of a step [J]
    energy: float  # largest kinetic energy [J], the scale of the imbalance
    escaped: bool  # the jack left the box, or the simulator refused to go on


# -- running a simulator ----------------------------------------------------------------------------------------------


def between(simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
    """Replay the last step of a contact model of this package (:mod:`jackbox_env.simulators.replay`).

    Each impact multiplies rounding by about 10. If the replay of a long step ends elsewhere than the model did, the
    result is NaN.

    Args:
        simulator: after the step.
        before: the state before it, shape (12,).
        time: the time before it [s].
        torque: constant through the step [N m]; None: the drive.
    """
    scene, after, impacts = simulator.scene, simulator.state, simulator.impacts
    again = replayed(scene, before.tolist(), time, impacts, simulator.time, torque)
    depth = max(again.depth, -clearance(scene, after.tolist()))
    allowed = _REPLAY_TOLERANCE * scene.box_half_width
    if not scene.elastic:  # overlap is moved apart, by no more than there is, at each contact
        allowed += (1 + len(impacts)) * max(depth, -clearance(scene, before.tolist()), 0.0)
    if not pose_errors(scene, np.array([again.state]), after[None])[0] <= allowed:
        return Between(math.nan, math.nan)
    return Between(depth, again.work)


def at_ends(simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
    """Inspect the end of a step only, for any dt. Enough for the exact model: its impacts act exactly on the wall."""
    return Between(-clearance(simulator.scene, simulator.state.tolist()), math.nan)


def follow(simulator: Simulator, case: Case, inspect: Inspect | None = between) -> Course:
    """Run a case and inspect every step.

    Args:
        simulator: of the case's scene.
        case: to run.
        inspect: evaluates the inside of a step; None: depth, imbalance and energy are NaN.

    Raises:
        ValueError: the case has fewer torques than steps, or a start that the simulator refuses.
    """
    if case.torques is not None and len(case.torques) < case.steps:
        raise ValueError(f"a case of {case.steps} steps must have as many torques, got {len(case.torques)}")
    simulator.reset(case.state, case.time)
    scene, state = case.scene, simulator.state
    states, impacts = [state], list[Impact]()
    start, depth, work, imbalance, largest = energy_of(scene, state.tolist()), -math.inf, 0.0, 0.0, 0.0
    escaped = False
    for number in range(case.steps):
        torque = None if case.torques is None else case.torques[number]
        before, time = state, simulator.time
        try:
            state, _, _, hits = simulator.step(case.dt, torque)
        except JackLostError:
            escaped = True
            break
        states.append(state)
        impacts += hits
        escaped = -clearance(scene, state.tolist()) > deepest_restored(scene)
        if inspect is not None:
            inside = inspect(simulator, before, time, torque)
            depth, work = float(np.maximum(depth, inside.depth)), work + inside.work  # a NaN stays
            now = energy_of(scene, state.tolist())
            imbalance = float(np.maximum(imbalance, abs(now - start - work)))
            largest = max(largest, now - scene.jack_mass * scene.gravity * float(state[Y_JACK]))
        if escaped:
            break
    if inspect is None:
        depth = imbalance = largest = math.nan
    return Course(np.array(states), impacts, depth, imbalance, largest, escaped)


# -- comparing --------------------------------------------------------------------------------------------------------


def pose_errors(scene: Scene, states: Array, reference: Array) -> Array:
    """Pose errors [m], shape (n,), of states, shape (n, 12), from their references.

    The largest of four: the errors of both centres, of the box's angle times L, of the jack's angle times l.
    """
    off = np.abs(np.asarray(states) - reference)
    parts = [
        np.hypot(off[:, X_BOX], off[:, Y_BOX]),
        scene.box_half_width * off[:, THETA_BOX],
        np.hypot(off[:, X_JACK], off[:, Y_JACK]),
        scene.jack_arm * off[:, THETA_JACK],
    ]
    largest: Array = np.max(parts, axis=0)
    return largest
