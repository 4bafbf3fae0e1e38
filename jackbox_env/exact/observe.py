"""Observations in compiled code, of one state or of a block of rows.

``run.py`` calls :func:`observe_block` or :func:`observe_rows` by its address after the last step of a block.
``observe_rows`` is compiled for each observation but the default, with its function in place of :func:`observe`; for a
user's that is :func:`observe_values`.
"""

from __future__ import annotations

import numpy as np

from jackbox_env.exact.compiler import called_at
from jackbox_env.exact.glide import TIME
from jackbox_env.exact.step import make_numbers
from jackbox_env.exact.trigonometry import LARGEST, cos_sin, cos_sin_within, without_turns
from jackbox_env.model.landing import at_landing, landing_features
from jackbox_env.model.observation import components
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import THETA_BOX, THETA_JACK, Array, Counts, Floats, State

block_observer = called_at("i8(f8[:, ::1], f8[:, ::1], i8, f8[:, ::1], i8, f4[:, ::1])")
LOW, HIGH = np.zeros(1), np.zeros(1)  # placeholders for the bounds of a user's observation


def state_in(row: Array) -> State:
    """The state in the first 12 numbers of a row."""
    return State(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11])


def observe(scene: SceneNumbers, state: Array, time: float, observation: Floats) -> bool:
    """Write the ten numbers of a state; whether none of them is NaN. Replaced if another observation is compiled."""
    named = state_in(state)
    cosine, sine = cos_sin(named.theta_box)
    cosine_4, sine_4 = cos_sin(4.0 * (named.theta_jack - named.theta_box))
    write(scene, state, cosine, sine, cosine_4, sine_4, observation)
    return True


def observe_landing(scene: SceneNumbers, state: Array, time: float, observation: Floats) -> bool:
    """Write the ten numbers and the landing features of a state."""
    named = state_in(state)
    cosine, sine = cos_sin(named.theta_box)
    cosine_4, sine_4 = cos_sin(4.0 * (named.theta_jack - named.theta_box))
    write(scene, state, cosine, sine, cosine_4, sine_4, observation)
    duration, relative, world = at_landing(scene, named)
    cosine_4, sine_4 = cos_sin(relative)
    cosine_8, sine_8 = cos_sin(2.0 * relative)
    cosine, sine = cos_sin(world)
    features = landing_features(
        scene, named, duration, without_turns(named.theta_box), cosine_4, sine_4, cosine_8, sine_8, cosine, sine
    )
    for k in range(len(features)):
        observation[10 + k] = features[k]
    return True


def observation_values(scene: SceneNumbers, state: State, time: float) -> tuple[float, ...]:
    """Placeholder for the function of a user's observation, which replaces it when that is compiled."""
    raise NotImplementedError


def observe_values(scene: SceneNumbers, state: Array, time: float, observation: Floats) -> bool:
    """Write the numbers of a user's observation, clipped to its bounds."""
    values, usable = observation_values(scene, state_in(state), time), True
    for k in range(len(values)):
        value = 1.0 * values[k]  # of a bool too
        usable = usable and value == value
        observation[k] = HIGH[k] if value > HIGH[k] else LOW[k] if value < LOW[k] else value
    return usable


def observe_rows(values: Array, block: Array, count: int, lanes: Array, low: int, observations: Floats) -> int:
    """Write the observations of a block's first ``count`` rows; return the first with a NaN, or -1.

    ``values`` are the scenes' numbers, one row for all environments or one for each; ``low`` is the block's first one.
    """
    several = values.shape[0] > 1
    for k in range(count):
        scene = make_numbers(values[low + k if several else 0])
        if not observe(scene, block[:, k], block[TIME, k], observations[low + k]):
            return k
    return -1


def observe_block(values: Array, block: Array, count: int, lanes: Array, low: int, observations: Floats) -> int:
    """The same for the ten numbers of :func:`observe`, many rows at a time; always -1."""
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
        scene = make_numbers(values[k if values.shape[0] > 1 else 0])
        row = blocks[numbers[k] // width, :, numbers[k] % width]
        if not observe(scene, row, row[TIME], observations[numbers[k]]):
            return int(numbers[k])
    return -1


def observe_one(values: Array, state: Array, time: float, observation: Floats) -> bool:
    """Write the observation of one state; whether no number is NaN."""
    return observe(make_numbers(values), state, time, observation)
