"""A learnt value: a good planner's return over the next seconds from a state, and a search that adds it to plans.

A plan's rewards ignore what follows after its end. With the value of its last state a shorter plan does as well as a
longer one. ``agents/training/value.py`` fits the value.

A folder of a value has

value.json      the environment that it was made in
weights.npz     as in :mod:`.network`; the last layer's output is a sum of rewards in units of ``UNIT``
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.icem import PlanSearch
from agents.policies.network import Layer, check_layers, outputs, read_with_layers
from agents.settings import EnvSettings
from jackbox_env import JackInBoxEnv, Scene
from jackbox_env.model.observation import OBSERVATIONS
from jackbox_env.model.states import Array
from jackbox_env.simulators.agent_functions import observed

VALUE = "value.json"
INPUTS = len(OBSERVATIONS["landing"].names)
UNIT = 20.0  # rewards, so that the network's output is of order one


class Value:
    """The value of states, by a network.

    Args:
        settings: the environment that it was made in.
        layers: weight, shape (outputs, inputs), and bias, shape (outputs,), of each; from ``INPUTS`` numbers to 1.

    Raises:
        ValueError: layers of other shapes, or that are not finite.
    """

    def __init__(self, settings: EnvSettings, layers: list[Layer]) -> None:
        self.settings, self.layers, self._scene = settings, layers, Scene.of(settings.scene_fields)
        check_layers(layers, [INPUTS, *(bias.size for _, bias in layers[:-1]), 1])

    def inputs(self, states: Array) -> NDArray[np.float32]:
        """The network's inputs for states, shape (n, 12): (n, ``INPUTS``)."""
        return observed(self._scene, states, "landing")

    def of(self, states: Array) -> Array:
        """The sum of future rewards, shape (n,), for states, shape (n, 12)."""
        return UNIT * outputs(self.layers, self.inputs(states))[:, 0].astype(np.float64)


class ValuedSearch(PlanSearch):
    """A search that adds the value of each candidate's last state to its rewards.

    Each jack's candidates are evaluated separately, because a product of matrices may depend on its number of rows. So
    a plan does not depend on other jacks' plans.
    """

    def __init__(self, value: Value, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.value = value

    def evaluate(self, scene: Scene, states: Array, tried: Array) -> tuple[Array, Array]:
        """Evaluate as :meth:`PlanSearch.evaluate` does, and add the values of the ends to the sums of rewards."""
        returns, ends = super().evaluate(scene, states, tried)
        return returns + np.array([self.value.of(of_jack) for of_jack in ends]).reshape(returns.shape), ends


def read_value(folder: Path) -> Value:
    """Read a value from its folder; nothing is unpickled.

    Raises:
        FileNotFoundError: it has none.
        ValueError: its files are damaged, or do not fit each other.
    """
    return read_with_layers(folder, VALUE, "value", _value)


def _value(stored: Any, layers: list[Layer]) -> Value:
    settings = EnvSettings.of(stored)
    JackInBoxEnv(**settings.env_settings).close()  # raises for what EnvSettings does not check
    return Value(settings, layers)
