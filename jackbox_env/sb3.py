"""A native Stable-Baselines3 VecEnv on the batched environment."""

from __future__ import annotations

import inspect
import time
import warnings
from collections.abc import Iterable, Sequence
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import OrderEnforcing, TimeLimit
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from jackbox_env import _validation as check
from jackbox_env.scene import Scene
from jackbox_env.states import Array
from jackbox_env.vector_env import JackInBoxVectorEnv

_KNOWN = set(inspect.signature(JackInBoxVectorEnv).parameters) - {"num_envs", "autoreset_mode", "with_infos"}


def make_sb3_vec_env(num_envs: int, **env_kwargs: Any) -> JackInBoxVecEnv:
    """Make ``num_envs`` environments for Stable-Baselines3.

    Step by step they give what ``DummyVecEnv`` gives over ``Monitor(gymnasium.make("JackInBox-v0", **env_kwargs))``,
    with the same seeds: observations, rewards, dones and infos. With ``contact="exact"`` they are one compiled loop.
    Seed them by ``.seed(0)`` or by the model's ``seed``; single environments by ``get_attr("state")`` and
    ``env_method("set_state", state, time, indices=[i])``: see :class:`EnvView`.

    Args:
        num_envs: number of environments.
        **env_kwargs: of the single environment, ``max_episode_steps`` (500), and ``num_threads`` of the vector one.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """
    return JackInBoxVecEnv(num_envs, **env_kwargs)


class JackInBoxVecEnv(VecEnv):
    """Environments of one scene for Stable-Baselines3; see :func:`make_sb3_vec_env`."""

    def __init__(self, num_envs: int, **env_kwargs: Any) -> None:
        check.known_keys("make_sb3_vec_env", env_kwargs, _KNOWN)
        self.vector_env = JackInBoxVectorEnv(
            num_envs, autoreset_mode=AutoresetMode.SAME_STEP, with_infos=True, **env_kwargs
        )
        self._views = [EnvView(self.vector_env, number) for number in range(self.vector_env.num_envs)]
        self._returns = np.zeros(self.vector_env.num_envs)
        self._lengths = np.zeros(self.vector_env.num_envs, dtype=np.int64)
        self._began = time.time()
        self._actions: NDArray[Any] | None = None
        space, actions = self.vector_env.single_observation_space, self.vector_env.single_action_space
        super().__init__(self.vector_env.num_envs, space, actions)
        self.metadata = self.vector_env.metadata

    # -- stepping -----------------------------------------------------------------------------------------------------

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in each environment, with the seeds and options set before; both are used once."""
        plain = np.array([not options for options in self._options])
        if plain.all():
            _, infos = self.vector_env.reset(seed=self._seeds)
            self._keep_reset_infos(infos, range(self.num_envs))
        else:
            self._reset_with_options(plain)
        self._returns[:], self._lengths[:] = 0.0, 0
        self._reset_seeds()
        self._reset_options()
        return self.vector_env.observations

    def _reset_with_options(self, plain: NDArray[np.bool_]) -> None:
        groups: list[tuple[NDArray[np.bool_], dict[str, Any]]] = [(plain, {})] if plain.any() else []
        for number in np.flatnonzero(~plain):
            check.known_keys("options", self._options[number], ("state", "time"))
            groups.append((np.arange(self.num_envs) == number, self._options[number]))
        plans = [self.vector_env._plan_reset(self._seeds, {**options, "reset_mask": mask}) for mask, options in groups]
        for plan in plans:
            _, infos = self.vector_env._carry_out(plan)
            self._keep_reset_infos(infos, np.flatnonzero(plan.chosen).tolist())

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions, shape (N, 1), for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step; an episode that ends starts anew, and its info holds its last observation and its statistics."""
        observations, rewards, _, dones, infos = self.vector_env.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        ended = np.flatnonzero(dones).tolist()
        if ended:
            self._keep_reset_infos(infos, ended)
            for name, values in infos["final_info"].items():
                if not name.startswith("_"):
                    infos[name][ended] = values[ended]
        rows = _rows(infos)
        for number in ended:
            rows[number]["episode"] = {
                "r": round(float(self._returns[number]), 6),
                "l": int(self._lengths[number]),
                "t": round(time.time() - self._began, 6),
            }
        for row, truncated in zip(rows, dones.tolist(), strict=True):
            row["TimeLimit.truncated"] = truncated
        for number in ended:
            rows[number]["terminal_observation"] = infos["final_obs"][number]
        self._returns[ended], self._lengths[ended] = 0.0, 0
        return observations, rewards.astype(np.float32), dones, rows

    def _keep_reset_infos(self, infos: dict[str, Any], numbers: Iterable[int]) -> None:
        rows = _rows(infos)
        for number in numbers:
            self.reset_infos[number] = deepcopy(rows[number])

    def close(self) -> None:
        """Release what the renderers hold."""
        self.vector_env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A frame of each environment, uint8, shape (512, 512, 3); None each without ``render_mode="rgb_array"``."""
        if self.render_mode != "rgb_array":
            warnings.warn(f"render_mode must be 'rgb_array' for images, got {self.render_mode!r}", stacklevel=2)
            return [None] * self.num_envs
        return list(self.vector_env.render() or ())

    # -- attributes and methods of single environments ----------------------------------------------------------------

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each chosen environment, as :class:`EnvView` has it."""
        return [getattr(view, attr_name) for view in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute on the view of each chosen environment; what the simulation holds is read-only."""
        for view in self._chosen(indices):
            setattr(view, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of each chosen environment, as :class:`EnvView` has it."""
        return [getattr(view, method_name)(*args, **kwargs) for view in self._chosen(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """True for Monitor, TimeLimit and OrderEnforcing: their work is built in."""
        return [issubclass(wrapper_class, (Monitor, TimeLimit, OrderEnforcing)) for _ in self._chosen(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[EnvView]:
        return [self._views[number] for number in self._get_indices(indices)]


class EnvView:
    """One environment of a vector environment, with the attributes and methods of the single one."""

    def __init__(self, vector_env: JackInBoxVectorEnv, number: int) -> None:
        self._vector_env, self._number = vector_env, number
        self.observation_space, self.action_space = vector_env.single_observation_space, vector_env.single_action_space
        self.render_mode, self.metadata = vector_env.render_mode, vector_env.metadata
        self.task = vector_env.task

    @property
    def unwrapped(self) -> EnvView:
        """Itself."""
        return self

    @property
    def scene(self) -> Scene:
        """The scene, every field resolved."""
        return self._vector_env.scene

    @property
    def state(self) -> Array:
        """A copy of the 12 state numbers, float64, SI units."""
        state: Array = self._vector_env.states[self._number]
        return state.copy()

    @property
    def time(self) -> float:
        """Present time [s]."""
        return float(self._vector_env.times[self._number])

    @property
    def observation(self) -> NDArray[np.float32]:
        """What the agent sees of the present state, shape (10,)."""
        seen: NDArray[np.float32] = self._vector_env.observations[self._number]
        return seen.copy()

    @property
    def np_random_seed(self) -> int:
        """The seed, -1 where none was given."""
        return self._vector_env.np_random_seed[self._number]

    def set_state(self, state: ArrayLike, time: float = 0.0) -> None:
        """Put this environment into ``state``, shape (12,), at ``time`` [s]; its episode goes on.

        Raises:
            TypeError, ValueError: unusable values; nothing changes.
        """
        self._vector_env.set_states(state, time, np.arange(self._vector_env.num_envs) == self._number)

    def render(self) -> NDArray[np.uint8] | None:
        """A frame, uint8, shape (512, 512, 3); None without a render mode."""
        frames = self._vector_env.render()
        return frames[self._number] if frames else None

    def get_wrapper_attr(self, name: str) -> Any:
        """The attribute of that name."""
        return getattr(self, name)

    def has_wrapper_attr(self, name: str) -> bool:
        """Whether there is an attribute of that name."""
        return hasattr(self, name)


def _rows(infos: dict[str, Any]) -> list[dict[str, Any]]:
    """Infos of arrays as a list of each environment's own."""
    names = [name for name in infos if not name.startswith(("_", "final_"))]
    columns = [[row.copy() for row in infos[name]] if infos[name].ndim > 1 else infos[name].tolist() for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
