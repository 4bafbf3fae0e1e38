"""Rewards in compiled code, of one state or of a block of rows.

Single environments call :func:`judge`; ``run.py`` calls :func:`score_block` after each step of a block. ``score_one``
and ``score_block`` are compiled for each task, with its functions in place of :func:`task_terms` and :func:`task_over`.
``judge`` and ``run`` are compiled once and call them by their address, see :mod:`jackbox_env.exact.compiler`.
"""

from __future__ import annotations

import math
from typing import Any

from jackbox_env.exact.compiler import called_at
from jackbox_env.exact.observe import state_in
from jackbox_env.exact.step import make_numbers
from jackbox_env.exact.workspace import HIT, IMPULSE_SUM, TORQUE
from jackbox_env.model.scene import SceneNumbers, total
from jackbox_env.model.states import Array, Flags, Floats, State

block_scorer = called_at("i8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8, i8, i8, f8[::1], b1[::1], f8[:, ::1])")
row_scorer = called_at("b1(f8[::1], f8[::1], f8, f8, f8[::1])")
row_observer = called_at("b1(f8[::1], f8[::1], f8, f4[::1])")

# Columns of a report: torque and reward's terms, impacts and their impulse, summed over the steps of a decision.
REPORTED_TORQUE, REPORTED_HITS, REPORTED_IMPULSE, TERMS = range(4)


def task_terms(scene: SceneNumbers, state: State, torque: float, impulse: float) -> tuple[float, ...]:
    """Placeholder for the task's function of reward terms, which replaces it when a task is compiled."""
    raise NotImplementedError


def one_term(scene: SceneNumbers, state: State, torque: float, impulse: float) -> tuple[float]:
    """Replaces :func:`task_terms` for a task whose function returns a number, not a tuple."""
    return (task_number(scene, state, torque, impulse),)


def task_number(scene: SceneNumbers, state: State, torque: float, impulse: float) -> float:
    """Placeholder for the task's function if it returns a number."""
    raise NotImplementedError


def task_over(scene: SceneNumbers, state: State, torque: float, impulse: float) -> bool:
    """Placeholder for the task's function that ends episodes, which replaces it when a task is compiled."""
    return False


def score_one(values: Array, state: Array, torque: float, impulse: float, terms: Array) -> bool:
    """Fill in the values of the reward's terms after a step to a state. Return whether the episode is over."""
    scene, named = make_numbers(values), state_in(state)
    earned = task_terms(scene, named, torque, impulse)
    for term in range(len(earned)):
        terms[term] = earned[term]
    return task_over(scene, named, torque, impulse)


def judge(
    values: Array, state: Array, time: float, torque: float, impulse: float, observation: Floats, terms: Array,
    observer: Any, scorer: Any,
) -> int:  # fmt: skip
    """Observe and score one state, in one call from Python.

    Args:
        observation: to be written; of length 0: not wanted.
        terms: to be written.
        observer: address of ``observe_one``.
        scorer: address of :func:`score_one`.

    Returns:
        1 if the episode is over, 0 if not, -1 if an observation is NaN.
    """
    over = row_scorer(scorer)(values, state, torque, impulse, terms)
    if observation.shape[0] and not row_observer(observer)(values, state, time, observation):
        return -1
    return 1 if over else 0


def score_block(
    values: Array, after: Array, lanes: Array, over: Array, waiting: int, first: int, made: int, rewards: Array,
    terminations: Flags, reports: Array,
) -> int:  # fmt: skip
    """Reward a step of a block, and report it if wanted. The task is not evaluated for episodes that are over.

    Return the number of episodes that the task ends, or -1 if a reward is NaN or infinite.

    Args:
        values: the scenes' numbers, one row for all environments or one for each.
        after: the block after the step.
        lanes: torques, impacts and impulses of the step, shape (LANES, width).
        over: not 0 where an episode was over before the step, shape (width,).
        waiting: number of those.
        first: number of the block's first environment.
        made: steps of the call before this one, whose reports are added to.
        rewards: of all environments, shape (N,).
        terminations: set where the task ends an episode, shape (N,).
        reports: of all environments, shape (N, TERMS + number of terms), or (0, ...) if not wanted.
    """
    torque, hits, impulses, unusable = lanes[TORQUE], lanes[HIT], lanes[IMPULSE_SUM], 0
    ends, several, count = 0, values.shape[0] > 1, min(after.shape[1], rewards.shape[0] - first)
    if not (several or waiting):
        scene = make_numbers(values[0])
        for k in range(count):
            rewards[first + k] = total(task_terms(scene, state_in(after[:, k]), torque[k], impulses[k]))
        for k in range(count):
            if task_over(scene, state_in(after[:, k]), torque[k], impulses[k]):
                terminations[first + k] = True
                ends += 1
    else:
        for k in range(count):
            rewards[first + k] = 0.0
            if over[k] == 0.0:
                row_scene = make_numbers(values[first + k if several else 0])
                rewards[first + k] = total(task_terms(row_scene, state_in(after[:, k]), torque[k], impulses[k]))
                if task_over(row_scene, state_in(after[:, k]), torque[k], impulses[k]):
                    terminations[first + k] = True
                    ends += 1
    for k in range(count):
        unusable += 0 if abs(rewards[first + k]) < math.inf else 1
    for k in range(count if reports.shape[0] else 0):
        if over[k] == 0.0:
            report = reports[first + k]
            row_scene = make_numbers(values[first + k if several else 0])
            earned = task_terms(row_scene, state_in(after[:, k]), torque[k], impulses[k])
            if made == 0:  # -0.0 stays -0.0
                report[:] = -0.0
            report[REPORTED_TORQUE] += torque[k]
            report[REPORTED_HITS] += hits[k]
            report[REPORTED_IMPULSE] += impulses[k]
            for term in range(len(earned)):
                report[TERMS + term] += earned[term]
    return -1 if unusable else ends
