"""numpy's PCG64 in 48 bytes per environment, and what environments draw by it when episodes begin: scenes and starts.

The random numbers are numpy's, bit for bit: O'Neill 2014, "PCG: A family of simple fast space-efficient statistically
good algorithms" (PCG XSL RR 128/64). A test compares draws with numpy's own generator. Scenes come in rows of numbers,
one for all environments or one for each.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.workspace import scene_at
from jackbox_env.model.randomization import between
from jackbox_env.model.scene import SceneNumbers, fall_speed, square_inertia
from jackbox_env.model.states import THETA_JACK, X_JACK, Y_JACK, Array, Counts
from jackbox_env.model.tasks import start_pose

(HALF_WIDTH, BOX_MASS, BOX_INERTIA, ARM, JACK_MASS, JACK_INERTIA, SPEED_SCALE) = (
    SceneNumbers._fields.index(name)
    for name in (
        "box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia", "speed_scale",
    )
)  # fmt: skip


def draw_scenes(values: Array, ranges: Array, derived: NDArray[np.bool_], words: Words) -> None:
    """Draw the numbers of some scenes, as :meth:`jackbox_env.model.randomization.Randomization.draw` does.

    Args:
        values: the scenes, one row each, to be changed.
        ranges: rows of index in a scene, least value, largest value, in the order in which they are drawn.
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
        scene = scene_at(values, k)
        row = blocks[numbers[k] // width, :, numbers[k] % width]
        row[:] = 0.0
        x = -1.0 + 2.0 * uniform(words[k])
        y = -1.0 + 2.0 * uniform(words[k])
        angle = -1.0 + 2.0 * uniform(words[k])
        row[X_JACK], row[Y_JACK], row[THETA_JACK] = start_pose(scene, x, y, angle)


Words = NDArray[np.uint64]

# Words of a generator: state and increment, each a high and a low word. Then whether numpy stores half of a word, of
# which a draw of 32 bits has used the other half, and that half. Compiled code draws whole words and needs neither.
STATE_HIGH, STATE_LOW, INCREMENT_HIGH, INCREMENT_LOW, HAS_HALF, HALF = range(6)
WHOLE = 4  # words of a generator without those of halves
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_MULTIPLIER_HIGH = np.uint64(2549297995355413924)
_MULTIPLIER_LOW = np.uint64(4865540595714422341)
_ONE = np.uint64(1)


def high_product(a: np.uint64, b: np.uint64) -> np.uint64:
    """Upper 64 bits of the product of two words."""
    a_low, a_high, b_low, b_high = a & _LOW, a >> _HALF, b & _LOW, b >> _HALF
    middle = a_high * b_low + (a_low * b_low >> _HALF)
    other = a_low * b_high + (middle & _LOW)
    return a_high * b_high + (middle >> _HALF) + (other >> _HALF)


def uniform(words: Words) -> float:
    """Draw a number in [0, 1), and advance the generator, shape (4,) or (6,)."""
    high, low = words[STATE_HIGH], words[STATE_LOW]
    next_low = low * _MULTIPLIER_LOW
    next_high = high_product(low, _MULTIPLIER_LOW) + high * _MULTIPLIER_LOW + low * _MULTIPLIER_HIGH
    low = next_low + words[INCREMENT_LOW]
    carry = _ONE if low < next_low else np.uint64(0)
    high = next_high + words[INCREMENT_HIGH] + carry
    words[STATE_HIGH], words[STATE_LOW] = high, low
    mixed = high ^ low
    turn = high >> np.uint64(58)
    word = (mixed >> turn) | (mixed << ((np.uint64(64) - turn) & np.uint64(63)))
    return float(word >> np.uint64(11)) * (1.0 / 9007199254740992.0)


def seeded(seed: int) -> Words:
    """The words of ``numpy.random.PCG64(seed)``, shape (6,)."""
    return words_of(np.random.Generator(np.random.PCG64(seed)))


def words_of(generator: np.random.Generator) -> Words:
    """The words of a PCG64 generator, shape (6,)."""
    numpy_state: Any = generator.bit_generator.state
    state, increment = int(numpy_state["state"]["state"]), int(numpy_state["state"]["inc"])
    low = (1 << 64) - 1
    half = numpy_state["has_uint32"], numpy_state["uinteger"]
    return np.array([state >> 64, state & low, increment >> 64, increment & low, *half], dtype=np.uint64)


def generator_of(words: Words) -> np.random.Generator:
    """numpy's generator of these words, shape (6,), or (4,) without a stored half word."""
    high, low, increment_high, increment_low, has_half, half = [*map(int, words), 0, 0][: HALF + 1]
    generator = np.random.PCG64(0)
    generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": high << 64 | low, "inc": increment_high << 64 | increment_low},
        "has_uint32": has_half,
        "uinteger": half,
    }
    return np.random.Generator(generator)


def fresh(count: int) -> Words:
    """Independent generators from the system's entropy, shape (count, 6)."""
    words: Words = np.zeros((count, HALF + 1), dtype=np.uint64)
    words[:, :HAS_HALF] = np.random.SeedSequence().generate_state(4 * count, np.uint64).reshape(count, 4)
    words[:, INCREMENT_LOW] |= _ONE  # increments are odd
    return words
