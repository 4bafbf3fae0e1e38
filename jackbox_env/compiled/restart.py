"""What happens to environments of the exact contact model between steps: scenes and starts are drawn, states looked at.

Everything here is compiled as it stands. Scenes come in rows of numbers, one for all environments or one for each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.generator import Words, uniform
from jackbox_env.compiled.glide import CLEAR, FALL, INERTIA, LIMIT, ORDINARY, ROOM, WIDTH, ordinary
from jackbox_env.compiled.score import look
from jackbox_env.compiled.step import CONSTANT, make_numbers, make_plan
from jackbox_env.scene import SceneNumbers, between, fall_speed, square_inertia
from jackbox_env.tasks import start_pose

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Counts = NDArray[np.int64]

(HALF_WIDTH, BOX_MASS, BOX_INERTIA, ARM, JACK_MASS, JACK_INERTIA, SPEED_SCALE) = (
    SceneNumbers._fields.index(name)
    for name in (
        "box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia", "speed_scale",
    )
)  # fmt: skip


def draw_scenes(values: Array, ranges: Array, derived: NDArray[np.bool_], words: Words) -> None:
    """Draw the numbers of some scenes, as :meth:`jackbox_env.randomization.Randomization.draw` does.

    Args:
        values: the scenes, one row each, to be changed.
        ranges: rows of place in a scene, least value, largest value, in the order in which they are drawn.
        derived: whether the inertia of box and jack follows mass and size, shape (scenes, 2).
        words: their generators.
    """
    for i in range(values.shape[0]):
        row = values[i]
        for k in range(ranges.shape[0]):
            row[int(ranges[k, 0])] = between(ranges[k, 1], ranges[k, 2], uniform(words[i]))
        if derived[i, 0]:
            row[BOX_INERTIA] = square_inertia(row[BOX_MASS], row[HALF_WIDTH])
        if derived[i, 1]:
            row[JACK_INERTIA] = square_inertia(row[JACK_MASS], row[ARM])
        row[SPEED_SCALE] = fall_speed(row[HALF_WIDTH])


def spread(values: Array, dt: float, lanes: Array, numbers: Counts) -> None:
    """Write what environments that are moved together need of their scenes, see ``glide.SCENE_LANES``.

    Args:
        values: the scenes' numbers, a row for each of ``numbers`` or one for all.
        dt: control step [s].
        lanes: shape (blocks, SCENE_LANES, width), to be written.
        numbers: of the environments.
    """
    for i in range(numbers.shape[0]):
        scene = make_numbers(values[i if values.shape[0] > 1 else 0])
        lane = lanes[numbers[i] // lanes.shape[2], :, numbers[i] % lanes.shape[2]]
        lane[LIMIT], lane[INERTIA], lane[FALL] = scene.torque_limit, scene.box_inertia, scene.gravity * dt
        lane[CLEAR] = make_plan(scene, dt, CONSTANT).clear
        lane[ROOM], lane[ORDINARY] = scene.box_half_width * (1.0 - 1e-12) - scene.jack_arm, ordinary(scene)


def restart_blocks(values: Array, blocks: Array, numbers: Counts, words: Words) -> None:
    """Draw a start for each environment of ``numbers``, at time 0.

    Args:
        values: the scenes' numbers, a row for each of ``numbers`` or one for all.
        blocks: shape (blocks, 16, width), to be changed.
        numbers: of the environments.
        words: their generators.
    """
    width = blocks.shape[2]
    for k in range(numbers.shape[0]):
        scene = make_numbers(values[k if values.shape[0] > 1 else 0])
        row = blocks[numbers[k] // width, :, numbers[k] % width]
        for place in range(WIDTH):
            row[place] = 0.0
        x = -1.0 + 2.0 * uniform(words[k])
        y = -1.0 + 2.0 * uniform(words[k])
        angle = -1.0 + 2.0 * uniform(words[k])
        row[3], row[4], row[5] = start_pose(scene, x, y, angle)


def look_blocks(values: Array, blocks: Array, numbers: Counts, observations: Floats) -> None:
    """Write the observations of some environments, with a row of ``values`` for each of ``numbers`` or one for all."""
    width = blocks.shape[2]
    for k in range(numbers.shape[0]):
        scene = make_numbers(values[k if values.shape[0] > 1 else 0])
        look(scene, blocks[numbers[k] // width, :, numbers[k] % width], observations[numbers[k]])
