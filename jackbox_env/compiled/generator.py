"""The start's random numbers in compiled code: numpy's PCG64, bit for bit, kept in 32 bytes per environment.

Reference: O'Neill 2014, "PCG: A family of simple fast space-efficient statistically good algorithms" (PCG XSL RR
128/64), as numpy.random.PCG64 implements it. A test compares draws with numpy's own generator.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint64]

# Of the generator's 32 bytes: state and increment, each a high and a low word.
STATE_HIGH, STATE_LOW, INCREMENT_HIGH, INCREMENT_LOW = range(4)
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
    """Draw a number in [0, 1) and move the generator, shape (4,), on."""
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
    """The 32 bytes of ``numpy.random.PCG64(seed)``, shape (4,)."""
    return packed(np.random.PCG64(seed))


def packed(generator: np.random.PCG64) -> Words:
    """The 32 bytes of a generator, shape (4,)."""
    numbers = generator.state["state"]
    state, increment = int(numbers["state"]), int(numbers["inc"])
    low = (1 << 64) - 1
    return np.array([state >> 64, state & low, increment >> 64, increment & low], dtype=np.uint64)


def fresh(count: int) -> Words:
    """Independent generators from the system's entropy, shape (count, 4)."""
    words: Words = np.random.SeedSequence().generate_state(4 * count, np.uint64).astype(np.uint64).reshape(count, 4)
    words[:, INCREMENT_LOW] |= _ONE  # increments are odd
    return words
