"""Trained policies as plain arrays, which need only numpy, without torch and Stable-Baselines3.

A folder of such a policy has

settings.json   its training's settings
weights.npz     weight_0, bias_0 of the first layer, and so on; float32, weights of shape (outputs, inputs)
evaluations.npz, time.json   its learning curve and its times, if they are known

tanh is applied between the layers. The last layer's output is the mean of the actions, and the policy's action; of
discrete actions it is one number each, and the action is that of the largest.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.policies.scripted import Actions, PolicyWithEnv, StatelessPolicy
from agents.runs import SETTINGS
from agents.settings import EnvSettings, TrainSettings
from jackbox_env.model.action import action_of
from jackbox_env.model.observation import observation_of
from jackbox_env.model.tasks import TASKS
from jackbox_env.tools.files import write_bytes, write_json
from jackbox_env.tools.model_files import MOST_LAYERS, MOST_WEIGHTS
from jackbox_env.tools.reading import read_bounded, unpacked_arrays

WEIGHTS = "weights.npz"
SHIPPED = Path(__file__).parents[1] / "trained"  # a folder <task>-<name> of each policy that comes with the repository
TRAINED = tuple(task for task in TASKS if (SHIPPED / f"{task}-ppo").is_dir())  # tasks with a network by PPO
_Policy = TypeVar("_Policy")  # or a value
Layer = tuple[NDArray[np.float32], NDArray[np.float32]]  # weight and bias
_MOST_JSON = 100_000  # [bytes]
_HEADERS = 65_536  # [bytes] of an npz file, at most


class NetworkPolicy(StatelessPolicy):
    """A trained policy with Stable-Baselines3's ``predict``: it acts by the mean of its distribution.

    Args:
        settings: of its training: what the network observes, and what an action is.
        layers: weight, shape (outputs, inputs), and bias, shape (outputs,), of each layer.

    Raises:
        ValueError: the layers do not fit the settings.
    """

    def __init__(self, settings: TrainSettings, layers: list[Layer]) -> None:
        interface = settings.interface
        inputs, action = len(observation_of(interface["observation"]).names), action_of(interface["action"])
        super().__init__(self.chosen, inputs)
        self.settings, self.layers = settings, layers
        self._space = action.space
        outputs = action.size or int(action.space.n)  # type: ignore[union-attr]
        check_layers(layers, [inputs, *settings.hidden_units, outputs])

    def chosen(self, observations: NDArray[Any]) -> Actions:
        """The actions, shape (n, size) or (n,), for observations as in training, shape (n, numbers)."""
        values = outputs(self.layers, np.asarray(observations, dtype=np.float32))
        space = self._space
        actions: Actions = (
            values.clip(space.low, space.high) if isinstance(space, gym.spaces.Box) else values.argmax(axis=1)
        )
        return actions

    @property
    def in_env(self) -> PolicyWithEnv:
        """The policy, with what its environment observes and does."""
        return PolicyWithEnv(self, self.settings.interface)


def check_layers(layers: list[Layer], sizes: list[int]) -> None:
    """Raise ValueError for layers that do not connect layers of these numbers of neurons, or are not finite."""
    required = [((after, before), (after,)) for before, after in pairwise(sizes)]
    shapes = [(weight.shape, bias.shape) for weight, bias in layers]
    if shapes != required:
        raise ValueError(f"the layers must have shapes {required}, got {shapes}")
    if not all(np.isfinite(part).all() for layer in layers for part in layer):
        raise ValueError("weights must be finite")


def outputs(layers: list[Layer], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Outputs, shape (n, outputs), of a network with tanh between its layers for inputs, shape (n, inputs)."""
    for number, (weight, bias) in enumerate(layers):
        values = np.tanh(values) if number else values
        values = values @ weight.T + bias
    return values


def layers_of(parameters: Mapping[str, Any]) -> list[Layer]:
    """Copies of the layers of a policy, from its parameters in Stable-Baselines3's names.

    Raises:
        KeyError: the parameters are not those of an MLP policy.
    """
    inner = [name[: -len(".weight")] for name in parameters if name.startswith("mlp_extractor.policy_net.")]
    names = [*sorted({name for name in inner if f"{name}.weight" in parameters}, key=_index_in), "action_net"]
    return [(_copy(parameters[f"{name}.weight"]), _copy(parameters[f"{name}.bias"])) for name in names]


def _index_in(name: str) -> int:
    return int(name.rsplit(".", 1)[1])


def _copy(tensor: Any) -> NDArray[np.float32]:
    values: NDArray[np.float32] = tensor.detach().cpu().numpy().astype(np.float32)
    return values


def write_with_layers(folder: Path, name: str, settings: EnvSettings, layers: list[Layer]) -> None:
    """Write the layers of a network into a folder, and as ``name`` the settings that they belong to."""
    file = io.BytesIO()
    named: dict[str, Any] = {}
    for number, (weight, bias) in enumerate(layers):
        named |= {f"weight_{number}": weight, f"bias_{number}": bias}
    np.savez(file, **named)
    write_bytes(folder / WEIGHTS, file.getvalue())
    write_json(folder / name, dataclasses.asdict(settings))


def read_layers(folder: Path) -> list[Layer]:
    """Read the layers of a network; nothing is unpickled.

    Raises:
        FileNotFoundError: the folder has none.
        ValueError: the file, or what it inflates to, is far larger than any network here. Damage raises whatever numpy
            raises.
    """
    path = folder / WEIGHTS
    stored = unpacked_arrays(read_bounded(path, 4 * MOST_WEIGHTS + _HEADERS), str(path))
    count = min(MOST_LAYERS + 1, len(stored) // 2)
    return [(stored[f"weight_{number}"], stored[f"bias_{number}"]) for number in range(count)]


def read_with_layers(folder: Path, name: str, kind: str, make: Callable[[Any, list[Layer]], _Policy]) -> _Policy:
    """Read a policy or a value from a folder's JSON file ``name`` and its layers; nothing is unpickled.

    Args:
        folder: of the two files.
        name: of the JSON file.
        kind: what it is, for errors.
        make: returns it, from the parsed JSON and the layers.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: the files are damaged, or do not fit each other.
    """
    try:
        return make(json.loads(read_bounded(folder / name, _MOST_JSON)), read_layers(folder))
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{folder} has no {kind}: {error}") from error


def read_policy(folder: Path) -> NetworkPolicy:
    """Read a policy from its folder; nothing is unpickled.

    Raises:
        FileNotFoundError: it has none.
        ValueError: its files are damaged, or do not fit each other.
    """
    return read_with_layers(
        folder, SETTINGS, "policy", lambda stored, layers: NetworkPolicy(TrainSettings.of(stored), layers)
    )
