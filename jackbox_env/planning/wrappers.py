"""Looking ahead as an observation: the wrappers for single and vector environments.

:class:`jackbox_env.sb3_wrappers.LookaheadVecEnv` is that for Stable-Baselines3. All append the same numbers, those of
:mod:`jackbox_env.planning.features`.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorActionWrapper, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from jackbox_env import checks as check
from jackbox_env.planning.features import Features, Flags, Floats, WarmStart
from jackbox_env.states import Array
from jackbox_env.vector_env import JackInBoxVectorEnv


class Lookahead(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Observe ``JackInBox-v0`` together with what rollouts from its present state return.

    A step takes one action for ``hold`` control steps and returns the sum of their rewards. Beside the ten numbers an
    observation holds (float32)

    ======  ==============================================================================  ==============
    count   quantity                                                                        bound
    ======  ==============================================================================  ==============
    1       time of the next impact if no torque acts, in shares of a rollout; 1 for none    0 to 1
    10      what is observed at the end of the control step in which it comes               as observed
    2       mean reward of a step over all ``turns``, and the deviation of these means      10
    turns   what each turn of the box brings, less that mean, over that deviation           5
    1       mean reward of a step under the plan                                            10
    3       the plan's next torques over their limit                                        1
    ======  ==============================================================================  ==============

    Scripted turns speed the box up for two pieces of ``hold`` control steps and stop it in two more. The furthest are
    those that the torque's limit allows. The plan is warm-started from the last step's and improved by
    ``samples`` variations (:mod:`jackbox_env.planning.icem`); an episode starts with none. An agent need not follow it.

    Args:
        env: the environment, of either contact model.
        hold: control steps of a step here, 1 or more.
        turns: scripted rollouts, an odd number, or 0 for none.
        samples: variations of the plan that are tried in each step, 8 or more, or 0 for no plan.
        pieces: torques of a rollout, each held for ``hold`` control steps; 8 or more. 32 times 5 steps are 3.2 s.
        follow: True: an action is added to the plan's next torque, so an agent that says 0 follows the plan. It needs
            an environment that takes actions as torques: no action wrapper inside, and ``torque="agent"``.
        seed: of the variations.
        num_threads: that play the rollouts; None: as many as the machine has. Nothing else depends on it.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(
        self, env: gym.Env[Any, Any], *, hold: int = 5, turns: int = 9, samples: int = 32, pieces: int = 32,
        follow: bool = False, seed: int = 0, num_threads: int | None = 1,
    ) -> None:  # fmt: skip
        gym.utils.RecordConstructorArgs.__init__(
            self, hold=hold, turns=turns, samples=samples, pieces=pieces, follow=follow, seed=seed,
            num_threads=num_threads,
        )  # fmt: skip
        gym.Wrapper.__init__(self, env)
        inner: Any = env.unwrapped
        if not hasattr(inner, "scene"):
            raise TypeError(f"looking ahead needs JackInBox-v0, got {check.shown(env)}")
        if follow is True:
            refuse_other_torques([inner.torque_source], changed_actions(env))
        self.features = Features(
            inner.task, inner.control_dt, hold=hold, turns=turns, samples=samples, pieces=pieces, follow=follow,
            seed=seed, num_threads=num_threads,
        )  # fmt: skip
        self.observation_space = self.features.space(env.observation_space)
        self._warm = WarmStart(self.features, 1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Start an episode, with a plan of no torque that is then improved."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._warm.start(np.ones(1, dtype=np.bool_))
        return self._seen(observation), info

    def step(self, action: Any) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Take an action for ``hold`` control steps, fewer where the episode ends; the info is that of the last.

        Raises:
            JackLostError: the jack, or one in a rollout, cannot be followed. Reset before the next step.
        """
        total, torque = 0.0, self._warm.torques(action, alone=True)
        for _ in range(self.features.hold):
            observation, reward, terminated, truncated, info = self.env.step(torque)
            total += float(reward)
            if terminated or truncated:
                break
        return self._seen(observation), total, terminated, truncated, info

    def _seen(self, observation: Floats) -> Floats:
        inner: Any = self.env.unwrapped
        seen: Floats = self._warm.seen([inner.scene], observation[None])[0]
        return seen


class LookaheadVector(VectorWrapper):
    """:class:`Lookahead` of a vector environment: the same numbers for each of its environments.

    All rollouts of a step are one compiled loop. Where ``hold`` is above 1 an episode must restart in the step that
    ends it (``autoreset_mode="SAME_STEP"``). In vector environments of single ones it must last a multiple of ``hold``
    steps.

    Args:
        env: the vector environment of ``JackInBox-v0``, native or of single ones.
        hold: control steps of a step here, 1 or more; more on all of these under :class:`Lookahead`.
        turns: scripted rollouts, an odd number, or 0 for none.
        samples: variations of the plan that are tried in each step, 8 or more, or 0 for no plan.
        pieces: torques of a rollout, each held for ``hold`` control steps; 8 or more.
        follow: whether an action is added to the plan's next torque.
        seed: of the variations.
        num_threads: that play the rollouts; None: as many as the machine has. Nothing else depends on it.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], *, hold: int = 5, turns: int = 9, samples: int = 32, pieces: int = 32,
        follow: bool = False, seed: int = 0, num_threads: int | None = None,
    ) -> None:  # fmt: skip
        super().__init__(env)
        mode = env.metadata.get("autoreset_mode")
        self._same_step = mode is AutoresetMode.SAME_STEP
        if not self._same_step and hold != 1:
            raise ValueError(f"hold must be 1 where autoreset_mode is not SAME_STEP, got {check.shown(hold)}")
        task, control_dt = only_one("task", self._of_each("task")), only_one("control_dt", self._of_each("control_dt"))
        if follow is True:
            refuse_other_torques(self._of_each("torque_source"), _changed_actions_of_several(env))
        features = Features(
            task, control_dt, hold=hold, turns=turns, samples=samples,
            pieces=pieces, follow=follow, seed=seed, num_threads=num_threads,
        )  # fmt: skip
        self.single_observation_space = features.space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._warm = WarmStart(features, env.num_envs)

    def _of_each(self, name: str) -> list[Any]:
        """An attribute of each environment, or of all."""
        inner: Any = self.env.unwrapped
        if hasattr(inner, "scenes"):
            return inner.scenes if name == "scene" else [getattr(inner, name)]
        try:
            return list(inner.get_attr(name))
        except AttributeError as error:
            raise TypeError(f"looking ahead needs JackInBox-v0, got {check.shown(self.env)}") from error

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Start an episode in each environment, or in those of ``options["reset_mask"]``."""
        mask = (options or {}).get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)
        chosen = np.ones(self.num_envs, dtype=np.bool_) if mask is None else np.asarray(mask)
        self._warm.start(chosen)
        return self._warm.seen(self._of_each("scene"), observations, chosen), infos

    def step(self, actions: Any) -> tuple[Floats, Array, Flags, Flags, dict[str, Any]]:
        """Take actions, shape (N, 1), for ``hold`` control steps and sum up the rewards; infos are of the last one.

        Raises:
            RuntimeError: an episode of single environments ended before the last of these steps.
            JackLostError: a jack, or one in a rollout, cannot be followed. After either, reset before the next step.
        """
        scenes = self._of_each("scene")
        observations, total, terminations, truncations, infos = self._held(self._warm.torques(actions))
        over = terminations | truncations
        if self._same_step and over.any():
            numbers = np.flatnonzero(over)
            final = infos["final_obs"].copy()
            for number, row in zip(
                numbers, self._warm.last_seen(scenes, np.stack(list(final[numbers])), numbers), strict=True
            ):
                final[number] = row
            infos = {**infos, "final_obs": final}
            self._warm.start(over)
        seen = self._warm.seen(self._of_each("scene"), observations)
        if not self._same_step:
            self._warm.start(over)  # the next step shows the start
        return seen, total, terminations, truncations, infos

    def _held(self, torques: Any) -> tuple[Floats, Array, Flags, Flags, dict[str, Any]]:
        """Step ``hold`` times under the same torques."""
        hold = self._warm.features.hold
        if isinstance(self.env, JackInBoxVectorEnv):
            return self.env.step(torques, hold)
        total = np.zeros(self.num_envs)
        for taken in range(1, hold + 1):
            observations, rewards, terminations, truncations, infos = self.env.step(torques)
            total += rewards
            refuse_early_end(terminations | truncations, taken, hold)
        return observations, total, terminations, truncations, infos


def only_one(name: str, found: list[Any]) -> Any:
    """The value that all environments have.

    Raises:
        ValueError: they have several.
    """
    if any(value is not found[0] and value != found[0] for value in found):
        raise ValueError(f"all environments must have one {name}, got {check.shown(found)}")
    return found[0]


def changed_actions(env: Any) -> str:
    """The first wrapper around an environment, single or of several, that changes actions; "" if there is none."""
    while isinstance(env, gym.Wrapper | VectorWrapper):
        if isinstance(env, gym.ActionWrapper | VectorActionWrapper):
            return type(env).__name__
        env = env.env
    return ""


def _changed_actions_of_several(env: VectorEnv[Any, Any, Any]) -> str:
    inner: Any = env.unwrapped
    found = [changed_actions(one) for one in (env, *getattr(inner, "envs", ()))]
    if not any(found) and inner.single_action_space != gym.spaces.Box(-1.0, 1.0, (1,)):  # in other processes
        found.append(f"one that acts in {inner.single_action_space}")
    return next(filter(None, found), "")


def refuse_other_torques(sources: list[str], wrapper: str) -> None:
    """Refuse to follow plans in environments where an action is not the torque.

    Args:
        sources: of their torque.
        wrapper: that changes actions; "": none.

    Raises:
        ValueError: one is driven by the chirp, or there is a wrapper.
    """
    if "chirp" in sources:
        raise ValueError('follow needs an environment with torque="agent", for it steers, got torque="chirp"')
    if wrapper:
        raise ValueError(f"follow needs actions that are torques, without an action wrapper inside, got {wrapper}")


def refuse_early_end(over: Flags, taken: int, hold: int) -> None:
    """Refuse episodes that are ``over``, shape (N,), before the last of the steps that an action is held for.

    Raises:
        RuntimeError: one is.
    """
    if taken < hold and over.any():
        raise RuntimeError(
            f"episodes must last a multiple of hold = {hold} steps, got one that ended {taken} steps after an action "
            "was chosen"
        )
