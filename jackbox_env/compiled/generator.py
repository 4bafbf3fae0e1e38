"""The start's random numbers in compiled code: numpy's PCG64, bit for bit, kept in 32 bytes per environment.

Reference: O'Neill 2014, "PCG: A family of simple fast space-efficient statistically good algorithms" (PCG XSL RR
128/64), as numpy.random.PCG64 implements it. A test compares draws with numpy's own generator.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]

# Of the generator's words: state and increment, each a high and a low word. Then what numpy keeps of a word of which a
# draw of 32 bits has used one half: whether there is one, and which. Compiled code draws whole words and needs neither.
STATE_HIGH, STATE_LOW, INCREMENT_HIGH, INCREMENT_LOW, HALF_KEPT, HALF = range(6)
WHOLE, WITH_HALVES = 4, 6  # words that are kept of a generator
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
    """Draw a number in [0, 1) and move the generator, shape (4,) or (6,), on."""
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
    return packed(np.random.Generator(np.random.PCG64(seed)))


def packed(generator: np.random.Generator) -> Words:
    """The words of a PCG64 generator, shape (6,)."""
    kept: Any = generator.bit_generator.state
    state, increment = int(kept["state"]["state"]), int(kept["state"]["inc"])
    low = (1 << 64) - 1
    words = [state >> 64, state & low, increment >> 64, increment & low, kept["has_uint32"], kept["uinteger"]]
    return np.array(words, dtype=np.uint64)


def unpacked(words: Words) -> np.random.Generator:
    """numpy's generator of these words, shape (6,), or (4,) where no half of a word is kept."""
    high, low, increment_high, increment_low, kept, half = [*map(int, words), 0, 0][:WITH_HALVES]
    generator = np.random.PCG64(0)
    generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": high << 64 | low, "inc": increment_high << 64 | increment_low},
        "has_uint32": kept,
        "uinteger": half,
    }
    return np.random.Generator(generator)


def fresh(count: int, width: int = WHOLE) -> Words:
    """Independent generators from the system's entropy, shape (count, width)."""
    words: Words = np.zeros((count, width), dtype=np.uint64)
    words[:, :HALF_KEPT] = np.random.SeedSequence().generate_state(4 * count, np.uint64).reshape(count, 4)
    words[:, INCREMENT_LOW] |= _ONE  # increments are odd
    return words
