"""Observations and rewards in compiled code, of one state or of a block of rows.

Single environments call :func:`score_one`; ``run.py`` calls :func:`score_block` after each step of a block, and
:func:`observe_block` after the last. ``score_one`` and ``score_block`` are compiled for each task, with its functions
in place of :func:`task_terms` and :func:`task_over`. ``run`` is compiled once and calls ``score_block`` by its address,
see :mod:`jackbox_env.exact.compiler`.
"""

from __future__ import annotations

import math

from jackbox_env.exact.step import make_numbers
from jackbox_env.exact.trigonometry import LARGEST, cos_sin, cos_sin_within
from jackbox_env.exact.workspace import HIT, IMPULSE_SUM, TORQUE
from jackbox_env.observation import components
from jackbox_env.scene import SceneNumbers, total
from jackbox_env.states import THETA_BOX, THETA_JACK, Array, Flags, Floats, State

# Columns of a report: the numbers of a step's info except state and time.
REPORTED_TORQUE, REPORTED_HITS, REPORTED_IMPULSE, TERMS = range(4)


def observe(scene: SceneNumbers, state: Array, observation: Floats) -> None:
    """Write the observation of a state, shape (10,)."""
    named = state_in(state)
    cosine, sine = cos_sin(named.theta_box)
    cosine_4, sine_4 = cos_sin(4.0 * (named.theta_jack - named.theta_box))
    write(scene, state, cosine, sine, cosine_4, sine_4, observation)


def observe_block(values: Array, block: Array, count: int, lanes: Array, low: int, observations: Floats) -> None:
    """Write the observations of a block's first ``count`` rows: the same as :func:`observe`, many at a time.

    ``values`` are the scenes' numbers, one row for all environments or one for each.
    """
    angle, jack_angle = block[THETA_BOX], block[THETA_JACK]
    cosine, sine, cosine_4, sine_4 = lanes[0], lanes[1], lanes[2], lanes[3]
    beyond = 0
    for k in range(count):
        cosine[k] = angle[k]
    for k in range(count):
        cosine_4[k] = 4.0 * (jack_angle[k] - angle[k])
    for k in range(count):
        beyond += 0 if max(abs(cosine[k]), abs(cosine_4[k])) < LARGEST else 1
    if not beyond:
        for k in range(count):
            cosine[k], sine[k] = cos_sin_within(cosine[k])
        for k in range(count):
            cosine_4[k], sine_4[k] = cos_sin_within(cosine_4[k])
    else:
        for k in range(count):
            cosine[k], sine[k] = cos_sin(cosine[k])
            cosine_4[k], sine_4[k] = cos_sin(cosine_4[k])
    if values.shape[0] == 1:
        scene = make_numbers(values[0])
        for k in range(count):
            write(scene, block[:, k], cosine[k], sine[k], cosine_4[k], sine_4[k], observations[low + k])
    else:
        for k in range(count):
            row_scene = make_numbers(values[low + k])
            write(row_scene, block[:, k], cosine[k], sine[k], cosine_4[k], sine_4[k], observations[low + k])


def write(
    scene: SceneNumbers, state: Array, cosine: float, sine: float, cosine_4: float, sine_4: float, observation: Floats
) -> None:
    """Write the ten numbers."""
    a, b, c, d, e, f, g, h, i, j = components(scene, state, cosine, sine, cosine_4, sine_4)
    observation[0], observation[1], observation[2], observation[3], observation[4] = a, b, c, d, e
    observation[5], observation[6], observation[7], observation[8], observation[9] = f, g, h, i, j


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


def state_in(row: Array) -> State:
    """The state in the first 12 numbers of a row."""
    return State(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11])


def score_one(values: Array, state: Array, torque: float, impulse: float, observation: Floats, terms: Array) -> bool:
    """Observe one state; fill in the values of its reward's terms. Return whether the episode is over."""
    scene = make_numbers(values)
    observe(scene, state, observation)
    earned = task_terms(scene, state_in(state), torque, impulse)
    for term in range(len(earned)):
        terms[term] = earned[term]
    return task_over(scene, state_in(state), torque, impulse)


def score_block(
    values: Array, after: Array, lanes: Array, over: Array, waiting: int, first: int, rewards: Array,
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
            report[REPORTED_TORQUE], report[REPORTED_HITS], report[REPORTED_IMPULSE] = torque[k], hits[k], impulses[k]
            row_scene = make_numbers(values[first + k if several else 0])
            earned = task_terms(row_scene, state_in(after[:, k]), torque[k], impulses[k])
            for term in range(len(earned)):
                report[TERMS + term] = earned[term]
    return -1 if unusable else ends
