"""Rewards, observations and torques of actions in compiled code, of one state or of a block of rows.

``run.py`` calls :func:`act_block` before each step of a block, :func:`score_block` after it, and :func:`observe_block`
or :func:`observe_rows` after the last one; a single environment is a block of one row. They are called by their address
(:mod:`jackbox_env.jit.compiler`): they are compiled for each task, observation and action with its functions in place
of :func:`task_terms`, :func:`task_over`, :func:`observation_values` and :func:`action_torque`, while ``run`` is
compiled once. For a user's observation :func:`observe_values` replaces :func:`observe`. The default observation has a
block function of its own, :func:`observe_block`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from jackbox_env.exact.geometry import ONE_REDUCTION, cos_sin, cos_sin_within, without_turns
from jackbox_env.exact.workspace import (
    APPLIED,
    HITS,
    IMPULSE_SUM,
    OVER,
    TIME,
    TORQUE,
    make_numbers,
    scene_at,
)
from jackbox_env.jit.compiler import called_at, numbers_in
from jackbox_env.model.observation import components
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    THETA_BOX,
    THETA_JACK,
    Array,
    Counts,
    Flags,
    Floats,
    State,
    add_numbers,
    copy_numbers,
    total,
)

# In place of those of the C library in the functions of built-in observations.
COSINES: dict[str, Any] = {"cosine_and_sine": cos_sin, "less_turns": without_turns}
block_observer = called_at(lambda t: t.i8(t.f8[:, ::1], t.f8[:, ::1], t.i8, t.f8[:, ::1], t.i8, t.f4[:, ::1]))
LOW, HIGH = np.zeros(1), np.zeros(1)  # placeholders for the bounds of a user's observation


def state_in(row: Array) -> State:
    """The state in the first 12 numbers of a row."""
    return State(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11])


def observe(scene: SceneNumbers, state: Array, time: float, observation: Floats) -> bool:
    """Write the numbers of a built-in observation; whether none of them is NaN. Replaced if it is a user's."""
    values = numbers_in(observation_values(scene, state_in(state), time))
    copy_numbers(len(values), values, observation)
    return True


def observation_values(scene: SceneNumbers, state: State, time: float) -> tuple[float, ...]:
    """Placeholder for the function of an observation, which replaces it when that is compiled."""
    raise NotImplementedError


def observe_values(scene: SceneNumbers, state: Array, time: float, observation: Floats) -> bool:
    """Write the numbers of a user's observation, clipped to its bounds."""
    values, usable = numbers_in(observation_values(scene, state_in(state), time)), True
    for k in range(len(values)):
        value = values[k]
        usable = usable and value == value
        observation[k] = HIGH[k] if value > HIGH[k] else LOW[k] if value < LOW[k] else value
    return usable


def observe_rows(values: Array, block: Array, count: int, scratch: Array, low: int, observations: Floats) -> int:
    """Write the observations of a block's first ``count`` rows; return the first with a NaN, or -1.

    ``values`` are the scenes' numbers, one row for all environments or one for each; ``low`` is the block's first one.
    """
    for k in range(count):
        if not observe(scene_at(values, low + k), block[:, k], block[TIME, k], observations[low + k]):
            return k
    return -1


def observe_block(values: Array, block: Array, count: int, scratch: Array, low: int, observations: Floats) -> int:
    """The observer of the ten numbers of :func:`observe`, many rows at a time; always returns -1."""
    angle, jack_angle = block[THETA_BOX], block[THETA_JACK]
    cosine, sine, cosine_4, sine_4 = scratch[0], scratch[1], scratch[2], scratch[3]
    beyond = 0
    copy_numbers(count, angle, cosine)
    for k in range(count):
        cosine_4[k] = 4.0 * (jack_angle[k] - angle[k])
    for k in range(count):
        beyond += 0 if max(abs(cosine[k]), abs(cosine_4[k])) < ONE_REDUCTION else 1
    if not beyond:
        for k in range(count):
            cosine[k], sine[k] = cos_sin_within(cosine[k])
        for k in range(count):
            cosine_4[k], sine_4[k] = cos_sin_within(cosine_4[k])
    else:
        for k in range(count):
            cosine[k], sine[k] = cos_sin(cosine[k])
            cosine_4[k], sine_4[k] = cos_sin(cosine_4[k])
    for k in range(count):
        scene = scene_at(values, low + k)
        write(scene, block[:, k], cosine[k], sine[k], cosine_4[k], sine_4[k], observations[low + k])
    return -1


def write(
    scene: SceneNumbers, state: Array, cosine: float, sine: float, cosine_4: float, sine_4: float, observation: Floats
) -> None:
    """Write the ten numbers."""
    a, b, c, d, e, f, g, h, i, j = components(scene, state, cosine, sine, cosine_4, sine_4)
    observation[0], observation[1], observation[2], observation[3], observation[4] = a, b, c, d, e
    observation[5], observation[6], observation[7], observation[8], observation[9] = f, g, h, i, j


def observe_chosen(values: Array, blocks: Array, numbers: Counts, observations: Floats) -> int:
    """Write the observations of some environments into their rows; return the first with a NaN, or -1.

    ``values`` has a row for each of ``numbers`` or one for all.
    """
    width = blocks.shape[2]
    for k in range(numbers.shape[0]):
        row = blocks[numbers[k] // width, :, numbers[k] % width]
        if not observe(scene_at(values, k), row, row[TIME], observations[numbers[k]]):
            return int(numbers[k])
    return -1


def observe_one(values: Array, state: Array, time: float, observation: Floats) -> bool:
    """Write the observation of one state; whether no number is NaN."""
    return observe(make_numbers(values), state, time, observation)


block_actor = called_at(lambda t: t.i8(t.f8[:, ::1], t.f8[:, ::1], t.f8[:, ::1], t.f8[:, ::1], t.i8, t.i8, t.f8))


def action_torque(scene: SceneNumbers, state: State, action: Any, time: float, dt: float) -> float:
    """Placeholder for the function of an action, which replaces it when that is compiled."""
    raise NotImplementedError


def action_in(controls: Array, number: int) -> Any:
    """Placeholder for the reader of one environment's action, as :func:`pair_in`."""
    raise NotImplementedError


def pair_in(controls: Array, number: int) -> tuple[float, float]:
    """The two numbers of an action."""
    return controls[0, number], controls[1, number]


def choice_in(controls: Array, number: int) -> int:
    """The whole number of an action."""
    return int(controls[0, number])


@cache
def tuple_in(size: int, first: int = 0) -> Callable[[Array, int], tuple[float, ...]]:
    """A reader of ``size`` numbers of an action, from ``first`` on."""
    if size == 1:
        return lambda controls, number: (controls[first, number],)
    low, high = tuple_in(size // 2, first), tuple_in(size - size // 2, first + size // 2)
    return lambda controls, number: low(controls, number) + high(controls, number)


def act_block(values: Array, before: Array, scratch: Array, controls: Array, first: int, size: int, dt: float) -> int:
    """Fill in the torques of a step of a block; return the first row whose torque is NaN, or -1.

    Args:
        values: the scenes' numbers, one row for all environments or one for each.
        before: the block before the step.
        scratch: whose row ``APPLIED`` is filled in [N m]; 0 for episodes that are over.
        controls: actions of all environments, shape (n, N).
        first: number of the block's first environment.
        size: rows of the block.
        dt: control step [s].
    """
    for k in range(size):
        scratch[APPLIED, k] = 0.0
        if before[OVER, k] == 0.0:
            number = first + k
            scene, state = scene_at(values, number), state_in(before[:, k])
            share = 1.0 * action_torque(scene, state, action_in(controls, number), before[TIME, k], dt)  # of a bool too
            if share != share:
                return k
            scratch[APPLIED, k] = max(-1.0, min(1.0, share)) * scene.torque_limit
    return -1


def act_one(values: Array, state: Array, controls: Array, time: float, dt: float) -> float:
    """The torque over its limit of one environment's action, shape (n, 1), not clipped."""
    return 1.0 * action_torque(make_numbers(values), state_in(state), action_in(controls, 0), time, dt)


block_scorer = called_at(
    lambda t: t.i8(
        t.f8[:, ::1], t.f8[:, ::1], t.f8[:, ::1], t.f8[::1], t.i8, t.i8, t.i8, t.f8[::1], t.b1[::1], t.f8[:, ::1]
    )
)  # fmt: skip
# Columns of a report: torque and reward's terms, impacts and their impulse, summed over the steps of a decision.
REPORTED_TORQUE, REPORTED_HITS, REPORTED_IMPULSE, TERMS = range(4)


def task_terms(scene: SceneNumbers, state: State, torque: float, impulse: float) -> tuple[float, ...]:
    """Placeholder for the task's function of reward terms, which replaces it when a task is compiled."""
    raise NotImplementedError


def task_over(scene: SceneNumbers, state: State, torque: float, impulse: float) -> bool:
    """Placeholder for the task's function that ends episodes, which replaces it when a task is compiled."""
    return False


def score_one(values: Array, state: Array, torque: float, impulse: float, terms: Array) -> None:
    """Fill in the values of the reward's terms after a step to a state, for the page of ``jackbox play``."""
    earned = numbers_in(task_terms(make_numbers(values), state_in(state), torque, impulse))
    copy_numbers(len(earned), earned, terms)


def score_block(
    values: Array, after: Array, scratch: Array, over: Array, waiting: int, first: int, made: int, rewards: Array,
    terminations: Flags, reports: Array,
) -> int:  # fmt: skip
    """Reward a step of a block, and report it if wanted. The task is not evaluated for episodes that are over.

    Return the number of episodes that the task ends, or -1 if a reward is NaN or infinite.

    Args:
        values: the scenes' numbers, one row for all environments or one for each.
        after: the block after the step.
        scratch: torques, impacts and impulses of the step, shape (SCRATCH, width).
        over: not 0 where an episode was over before the step, shape (width,).
        waiting: number of those.
        first: number of the block's first environment.
        made: steps of the call before this one, whose reports are added to.
        rewards: of all environments, shape (N,).
        terminations: set where the task ends an episode, shape (N,).
        reports: of all environments, shape (N, TERMS + number of terms), or (0, ...) if not wanted.
    """
    torque, hits, impulses, unusable = scratch[TORQUE], scratch[HITS], scratch[IMPULSE_SUM], 0
    ends, count = 0, min(after.shape[1], rewards.shape[0] - first)
    rewards, terminations = rewards[first : first + count], terminations[first : first + count]  # of the block
    if not (values.shape[0] > 1 or waiting):
        scene = make_numbers(values[0])
        for k in range(count):
            rewards[k] = total(numbers_in(task_terms(scene, state_in(after[:, k]), torque[k], impulses[k])))
        for k in range(count):
            if task_over(scene, state_in(after[:, k]), torque[k], impulses[k]):
                terminations[k] = True
                ends += 1
    else:
        for k in range(count):
            rewards[k] = 0.0
            if over[k] == 0.0:
                row_scene = scene_at(values, first + k)
                rewards[k] = total(numbers_in(task_terms(row_scene, state_in(after[:, k]), torque[k], impulses[k])))
                if task_over(row_scene, state_in(after[:, k]), torque[k], impulses[k]):
                    terminations[k] = True
                    ends += 1
    for k in range(count):
        unusable += 0 if abs(rewards[k]) < math.inf else 1
    for k in range(count if reports.shape[0] else 0):
        if over[k] == 0.0:
            report = reports[first + k]
            earned = numbers_in(task_terms(scene_at(values, first + k), state_in(after[:, k]), torque[k], impulses[k]))
            if made == 0:  # -0.0 stays -0.0
                report[:] = -0.0
            report[REPORTED_TORQUE] += torque[k]
            report[REPORTED_HITS] += hits[k]
            report[REPORTED_IMPULSE] += impulses[k]
            add_numbers(len(earned), report[TERMS:], 1.0, earned)
    return -1 if unusable else ends
