"""A native Stable-Baselines3 VecEnv on the vector environment."""

from __future__ import annotations

import copy
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import OrderEnforcing, TimeLimit
from numpy.typing import ArrayLike, NDArray

from jackbox_env.envs.infos import NoInfos
from jackbox_env.envs.settings import Settings
from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array
from jackbox_env.simulators import Impact
from jackbox_env.tools import checks as check

with check.extra("jackbox_env.sb3", "Stable-Baselines3", "train"):
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

_SHARED = {"num_threads", "with_infos", "max_episode_steps"}  # not arguments of the single environment


def make_sb3_vec_env(num_envs: int, **env_kwargs: Any) -> JackInBoxVecEnv:
    """Make ``num_envs`` environments for Stable-Baselines3.

    Observations, rewards and dones equal those of ``DummyVecEnv`` over
    ``Monitor(gymnasium.make("JackInBox-v0", **env_kwargs))`` with the same seeds. An info has the decision's
    ``duration``, and at the end of an episode ``episode``, ``terminal_observation`` and ``TimeLimit.truncated``, which
    Stable-Baselines3 reads. With ``with_infos=True`` infos equal those of ``DummyVecEnv`` too, which takes longer. With
    ``fidelity="exact"`` the environments are one compiled loop. Seed them by ``.seed(0)`` or by the model's ``seed``.
    Single environments are reached by ``get_attr("state")`` and
    ``env_method("set_state", state, time, indices=[i])``: see :class:`EnvView`.

    >>> make_sb3_vec_env(4, fidelity="exact", task="spin").reset().shape
    (4, 10)

    Args:
        num_envs: number of environments.
        **env_kwargs: of the single environment, and of the vector one ``max_episode_steps``, ``num_threads``,
            ``with_infos`` and a list of scenes.

    Raises:
        TypeError, ValueError: an argument out of its range.
    """
    return JackInBoxVecEnv(num_envs, **env_kwargs)


class JackInBoxVecEnv(VecEnv):
    """Environments of one scene for Stable-Baselines3; see :func:`make_sb3_vec_env`.

    An interruption of ``step_wait`` or ``reset`` leaves everything as before the call or as after it. If it strikes
    while the results are assigned, ``step_wait`` raises RuntimeError until the next ``reset``.
    """

    def __init__(self, num_envs: int, **env_kwargs: Any) -> None:
        if "autoreset_mode" in env_kwargs:
            raise TypeError(
                "make_sb3_vec_env has no argument 'autoreset_mode': an episode that ends starts anew in its step"
            )
        self.vector_env = JackInBoxVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **env_kwargs)
        self._with_infos = bool(env_kwargs.get("with_infos", False))
        self._views = [EnvView(self.vector_env, number, env_kwargs) for number in range(self.vector_env.num_envs)]
        self._began = time.time()
        self._actions: Any = None
        space, actions = self.vector_env.single_observation_space, self.vector_env.single_action_space
        super().__init__(self.vector_env.num_envs, space, actions)
        self.metadata = self.vector_env.metadata
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)
        self._changes = 0  # of the vector environment, at the time of returns and lengths
        self.discounted = env_kwargs.get("action_repeat") != "bounce"  # rightly: Durations sets it too

    # -- stepping -----------------------------------------------------------------------------------------------------

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in each environment, with the seeds and options set before; both are used once.

        Each environment with options starts alone, then the others together.

        Raises:
            TypeError, ValueError, TaskError: an unusable option, or an observation with a NaN. Nothing has changed,
                unless a state is outside its box or has the NaN: then environments of a lower number have started.
        """
        plain = np.array([not options for options in self._options])
        resets = []
        for number in np.flatnonzero(~plain).tolist():
            check.known_keys("options", self._options[number], ("state", "time", "scene"))
            resets.append({**self._options[number], "reset_mask": np.arange(self.num_envs) == number})
        if plain.any():
            resets.append({"reset_mask": plain})  # last, so that a refused state changes nothing
        for options in resets:
            self.vector_env.check_reset(self._seeds, options)
        for options in resets:
            observations, infos = self.vector_env.reset(seed=self._seeds, options=options)
            rows = self._rows(infos)
            for number in np.flatnonzero(options["reset_mask"]).tolist():
                self.reset_infos[number] = rows[number]
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)
        self._changes = self.vector_env.changes
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Any) -> None:
        """Store the actions, shape (N, n) or (N,), for ``step_wait``."""
        if not self.discounted:
            caller = sys._getframe(1)
            while caller.f_back and caller.f_code.co_name in ("step", "step_async"):  # of wrappers
                caller = caller.f_back
            # of a training whose discount depends on the duration
            if caller.f_code.co_name == "collect_rollouts" and caller.f_locals["self"].gamma != 1.0:
                self.discounted = True  # one warning is enough
                warnings.warn(
                    "decisions of 'bounce' last unequally, and gamma is per decision: learn(n, callback=Durations()) "
                    "of jackbox_env.sb3 discounts by elapsed time",
                    stacklevel=2,
                )
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step; an episode that ends starts anew, and its info has its last observation and its statistics.

        An episode's length is in decisions, as that of ``Monitor``.

        Raises:
            RuntimeError: an interruption, or a step of ``vector_env`` itself, changed the environments: reset first.
        """
        if self._changes != self.vector_env.changes:
            raise RuntimeError("the environments have changed beside step_wait, or in an interrupted one: reset them")
        observations, rewards, terminations, truncations, infos = self.vector_env.step(self._actions)
        dones, in_time = terminations | truncations, truncations & ~terminations
        returns, lengths = self._returns + rewards, self._lengths + 1
        ended = np.flatnonzero(dones).tolist()
        rows = self._full_rows(infos, ended)
        for number in ended:
            rows[number] = rows[number] if self._with_infos else NoInfos(rows[number])  # slower to make than a dict
            rows[number]["episode"] = {
                "r": round(float(returns[number]), 6),
                "l": int(lengths[number]),
                "t": round(time.time() - self._began, 6),
            }
        for number in range(self.num_envs) if self._with_infos else ended:
            rows[number]["TimeLimit.truncated"] = bool(in_time[number])
        for number in ended:
            rows[number]["terminal_observation"] = infos["final_obs"][number]
        returns[ended], lengths[ended] = 0.0, 0
        self._returns, self._lengths, self._changes = returns, lengths, self.vector_env.changes
        return observations, rewards.astype(np.float32), dones, rows

    def _full_rows(self, infos: dict[str, Any], ended: list[int]) -> list[dict[str, Any]]:
        """The info of each environment's step; those of new starts go to ``reset_infos``."""
        rows = self._rows(infos)
        last = self._rows(_some(infos["final_info"], ended)) if ended else []
        for number, row in zip(ended, last, strict=True):
            self.reset_infos[number], rows[number] = rows[number], row
        return rows

    def _rows(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        """Infos of arrays as a list with one info for each environment."""
        return _rows(infos) if self._with_infos else [{"duration": one} for one in infos["duration"].tolist()]

    def close(self) -> None:
        """Close the renderers."""
        self.vector_env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A frame of each environment, uint8, shape (height, width, 3); None without a render mode."""
        return list(self.vector_env.render() or [None] * self.num_envs)

    # -- attributes and methods of single environments ----------------------------------------------------------------

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each chosen environment's :class:`EnvView`."""
        return [getattr(view, attr_name) for view in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of each chosen environment's :class:`EnvView`.

        Raises:
            AttributeError: the attribute is a setting or part of the simulation; the message has the remedy.
        """
        for view in self._chosen(indices):
            setattr(view, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Call a method of each chosen environment's :class:`EnvView`."""
        return [getattr(view, method_name)(*args, **kwargs) for view in self._chosen(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """True for Monitor, TimeLimit and OrderEnforcing: their work is built in."""
        return [issubclass(wrapper_class, (Monitor, TimeLimit, OrderEnforcing)) for _ in self._chosen(indices)]

    def _chosen(self, indices: VecEnvIndices) -> list[EnvView]:
        return [self._views[number] for number in self._get_indices(indices)]


class EnvView(Settings):
    """One environment of a vector environment, with the attributes, settings and methods of the single one."""

    def __init__(self, vector_env: JackInBoxVectorEnv, number: int, keywords: Mapping[str, Any]) -> None:
        self._vector_env, self._number, self._keywords = vector_env, number, keywords
        self.observation_space, self.action_space = vector_env.single_observation_space, vector_env.single_action_space
        self.metadata, self._settings = vector_env.metadata, vector_env._settings

    @property
    def unwrapped(self) -> EnvView:
        """Itself."""
        return self

    @property  # type: ignore[misc]
    def spec(self) -> EnvSpec:
        """The spec from which ``gymnasium.make`` makes the same single environment."""
        spec = copy.deepcopy(gym.spec("JackInBox-v0"))
        spec.max_episode_steps = self.max_episode_steps
        spec.kwargs = {name: value for name, value in self._keywords.items() if name not in _SHARED}
        if isinstance(spec.kwargs.get("scene"), Sequence):
            spec.kwargs["scene"] = spec.kwargs["scene"][self._number]
        return spec

    @property
    def scene(self) -> Scene:
        """The scene, every field resolved."""
        return self._vector_env.scene_of(self._number)

    @property
    def state(self) -> Array:
        """A copy of the 12 state numbers, float64, SI units."""
        return np.array(self._vector_env.states[self._number])

    @property
    def time(self) -> float:
        """Present time [s]."""
        return float(self._vector_env.times[self._number])

    @property
    def observation(self) -> NDArray[np.float32]:
        """The observation of the present state."""
        return np.array(self._vector_env.observations[self._number])

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step, in time order; empty if an episode has begun since."""
        return self._vector_env.impacts(self._number)

    @property
    def np_random_seed(self) -> int:
        """The seed, -1 where none was given."""
        return self._vector_env.np_random_seed[self._number]

    def set_state(self, state: ArrayLike, time: float = 0.0) -> None:
        """Set this environment's state, shape (12,), and time [s]; its episode goes on.

        Raises:
            TypeError, ValueError: unusable values; nothing changes.
        """
        self._vector_env.set_states(state, time, np.arange(self._vector_env.num_envs) == self._number)

    def render(self) -> NDArray[np.uint8] | None:
        """A frame, uint8, shape (height, width, 3); None without a render mode."""
        frames = self._vector_env.render()
        return frames[self._number] if frames else None


def _some(infos: dict[str, Any], numbers: list[int]) -> dict[str, Any]:
    """Infos of some environments, nested ones too."""
    return {
        name: _some(values, numbers) if isinstance(values, dict) else values[numbers] for name, values in infos.items()
    }


def _rows(infos: dict[str, Any]) -> list[dict[str, Any]]:
    """Infos of arrays as a list with one info for each environment."""
    names = [name for name in infos if not name.startswith(("_", "final_"))]
    columns = [_column(infos[name]) for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _column(values: Any) -> list[Any]:
    if isinstance(values, dict):
        return _rows(values)
    return [row.copy() for row in values] if values.ndim > 1 else values.tolist()
