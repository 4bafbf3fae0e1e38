"""What an agent sees and earns, in compiled code: the observation and the task's terms, of one state or of a block.

The arithmetic is that of :mod:`jackbox_env.observation` and :mod:`jackbox_env.tasks`, compiled as it stands there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.step import make_numbers
from jackbox_env.compiled.trigonometry import LARGEST, cos_sin, cos_sin_within
from jackbox_env.observation import seen
from jackbox_env.scene import SceneNumbers
from jackbox_env.states import Array
from jackbox_env.tasks import TASKS, juggle, rattle, spin

Floats = NDArray[np.float32]

SPIN, RATTLE = (list(TASKS).index(name) for name in ("spin", "rattle"))


def look(scene: SceneNumbers, state: Array, observation: Floats) -> None:
    """Write the observation of a state, shape (10,)."""
    cosine, sine = cos_sin(state[2])
    cosine_4, sine_4 = cos_sin(4.0 * (state[5] - state[2]))
    write(scene, state, cosine, sine, cosine_4, sine_4, observation)


def look_block(scene: SceneNumbers, block: Array, count: int, lanes: Array, low: int, observations: Floats) -> None:
    """Write the observations of a block's first ``count`` environments: the same as :func:`look`, many at a time."""
    angle, jack_angle = block[2], block[5]
    cosine, sine, cosine_4, sine_4 = lanes[0], lanes[1], lanes[2], lanes[3]
    largest = 0.0
    for k in range(count):
        cosine[k] = angle[k]
        cosine_4[k] = 4.0 * (jack_angle[k] - angle[k])
        largest = max(largest, max(abs(cosine[k]), abs(cosine_4[k])))
    if largest < LARGEST:
        for k in range(count):
            cosine[k], sine[k] = cos_sin_within(cosine[k])
        for k in range(count):
            cosine_4[k], sine_4[k] = cos_sin_within(cosine_4[k])
    else:
        for k in range(count):
            cosine[k], sine[k] = cos_sin(cosine[k])
            cosine_4[k], sine_4[k] = cos_sin(cosine_4[k])
    for k in range(count):
        write(scene, block[:, k], cosine[k], sine[k], cosine_4[k], sine_4[k], observations[low + k])


def write(
    scene: SceneNumbers, state: Array, cosine: float, sine: float, cosine_4: float, sine_4: float, observation: Floats
) -> None:
    """Write the ten numbers."""
    a, b, c, d, e, f, g, h, i, j = seen(scene, state, cosine, sine, cosine_4, sine_4)
    observation[0], observation[1], observation[2], observation[3], observation[4] = a, b, c, d, e
    observation[5], observation[6], observation[7], observation[8], observation[9] = f, g, h, i, j


def reward_terms(scene: SceneNumbers, task: int, state: Array, torque: float, impulse: float) -> tuple[float, float]:
    """The values of a task's terms, 0 for a second one it does not have."""
    if task == RATTLE:
        return rattle(scene, state, torque, impulse)
    if task == SPIN:
        return spin(scene, state, torque, impulse)[0], 0.0
    return juggle(scene, state, torque, impulse)[0], 0.0


def score_one(
    values: Array, task: int, state: Array, torque: float, impulse: float, observation: Floats
) -> tuple[float, float]:
    """Observe one state; return the values of its reward's terms."""
    scene = make_numbers(values)
    look(scene, state, observation)
    return reward_terms(scene, task, state, torque, impulse)
