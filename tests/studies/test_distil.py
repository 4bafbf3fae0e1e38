"""The script that makes the policy `distilled`, made small."""

from __future__ import annotations

from collections import deque

import numpy as np

from agents.policies.network import SHIPPED
from agents.policies.value import read_value
from scripts.studies import distil
from scripts.studies.fitting import layers_of, network


def test_fitting_comes_closer() -> None:
    value, rng = read_value(SHIPPED / "juggle-value"), np.random.default_rng(0)
    net = network(value.layers)
    for one, other in zip(layers_of(net), value.layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
    states = distil.starts(600, rng)
    batches = deque([(states, value.of(states) + 20.0)])
    first = distil.fit(net, value, batches, 1e-3)
    for _ in range(15):
        last = distil.fit(net, value, batches, 1e-3)
    assert first > 10.0
    assert last < 0.5 * first
