"""A trained policy as plain arrays: it plays with numpy alone, without torch and Stable-Baselines3.

A folder of such a policy holds

settings.json   what it was trained by
weights.npz     weight_0, bias_0 of the first layer, and so on; float32, weights of shape (outputs, inputs)
evaluations.npz, time.json   its learning curve and its times, if they are known

Between the layers stands tanh. The last layer's output is the mean of the actions, which is what the policy does.
"""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from agents.files import read_bounded
from agents.policies.landing_features import FEATURES, flight_of, preview
from agents.policies.playing import Playable, manner_of
from agents.policies.scripted import Actions
from agents.runs import SETTINGS
from agents.settings import FORESEEN, MOST_LAYERS, MOST_WEIGHTS, EnvSettings, TrainSettings
from agents.training.archives import unpacked_arrays
from jackbox_env import Scene
from jackbox_env.files import write_bytes, write_json
from jackbox_env.observation import BOUNDS

if TYPE_CHECKING:
    from stable_baselines3 import PPO

WEIGHTS = "weights.npz"
SHIPPED = Path(__file__).parents[1] / "trained"  # a folder <task>-<name> of each policy that comes with the repository
_Made = TypeVar("_Made")
Layer = tuple[NDArray[np.float32], NDArray[np.float32]]  # weight and bias
_MOST_SETTINGS = 100_000  # [bytes] of a JSON file
_SPARE = 65_536  # [bytes] of a file beside its numbers


class NetworkPolicy(Playable):
    """A trained policy with Stable-Baselines3's ``predict``: it does the mean of its actions.

    Args:
        settings: what it was trained by; they say what it sees and how long it holds its actions.
        layers: weight, shape (outputs, inputs), and bias, shape (outputs,), of each layer.

    Raises:
        ValueError: the layers do not fit the settings.
    """

    def __init__(self, settings: TrainSettings, layers: list[Layer]) -> None:
        self.settings, self._layers = settings, layers
        self._flight = flight_of(Scene.of(settings.scene_fields)) if settings.preview else None
        self.manner = manner_of(settings)
        seen = len(BOUNDS) + FORESEEN * bool(settings.lookahead) + len(FEATURES) * settings.preview
        check_layers(layers, [seen, *settings.hidden_units, 2 if settings.landing else 1])

    def act(self, seen: NDArray[Any]) -> Actions:
        """See :class:`.playing.Playable`."""
        values = np.asarray(seen, dtype=np.float32)
        if self._flight:
            values = np.concatenate([values, preview(self._flight, values[:, : len(BOUNDS)])], axis=1)
        return np.clip(outputs(self._layers, values), -1.0, 1.0)


def check_layers(layers: list[Layer], sizes: list[int]) -> None:
    """Raise ValueError for layers that do not lead from the first of these numbers of neurons to the last."""
    wanted = [((after, before), (after,)) for before, after in pairwise(sizes)]
    found = [(weight.shape, bias.shape) for weight, bias in layers]
    if found != wanted:
        raise ValueError(f"the layers must have shapes {wanted}, got {found}")
    if not all(np.isfinite(part).all() for layer in layers for part in layer):
        raise ValueError("weights must be finite")


def outputs(layers: list[Layer], values: NDArray[np.float32]) -> NDArray[np.float32]:
    """What a network with tanh between its layers makes of inputs, shape (n, inputs)."""
    for number, (weight, bias) in enumerate(layers):
        values = np.tanh(values) if number else values
        values = values @ weight.T + bias
    return values


def layers_of(model: PPO) -> list[Layer]:
    """The layers of a model's policy: copies."""
    numbers = model.policy.state_dict()
    inner = [name[: -len(".weight")] for name in numbers if name.startswith("mlp_extractor.policy_net.")]
    names = [*sorted({name for name in inner if f"{name}.weight" in numbers}, key=_place), "action_net"]
    return [(_copy(numbers[f"{name}.weight"]), _copy(numbers[f"{name}.bias"])) for name in names]


def _place(name: str) -> int:
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
        FileNotFoundError: the folder holds none.
        ValueError: the file, or what it inflates to, is far larger than any network here. Damage raises whatever numpy
            raises.
    """
    path = folder / WEIGHTS
    stored = unpacked_arrays(read_bounded(path, 4 * MOST_WEIGHTS + _SPARE), str(path))
    count = min(MOST_LAYERS + 1, len(stored) // 2)
    return [(stored[f"weight_{number}"], stored[f"bias_{number}"]) for number in range(count)]


def read_with_layers(folder: Path, name: str, kind: str, make: Callable[[Any, list[Layer]], _Made]) -> _Made:
    """What is made of a folder's JSON file ``name`` and its layers; nothing is unpickled.

    Args:
        folder: of the two files.
        name: of the JSON file.
        kind: of what it holds, for errors.
        make: it, from what the JSON holds and the layers.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: the files are damaged, or do not fit each other.
    """
    try:
        return make(json.loads(read_bounded(folder / name, _MOST_SETTINGS)), read_layers(folder))
    except FileNotFoundError:
        raise
    except Exception as error:
        raise ValueError(f"{folder} holds no {kind}: {error}") from error


def read_policy(folder: Path) -> NetworkPolicy:
    """Read a policy from its folder; nothing is unpickled.

    Raises:
        FileNotFoundError: it holds none.
        ValueError: its files are damaged, or do not fit each other.
    """
    return read_with_layers(
        folder, SETTINGS, "policy", lambda given, layers: NetworkPolicy(TrainSettings.of(given), layers)
    )
