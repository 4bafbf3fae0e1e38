"""Controls, which change how agents act and observe; their adapters to environments; and look-ahead observations.

``features.py`` computes the numbers that look-ahead appends. ``landing_control.py`` is the other control, and
``sb3_wrappers.py`` the adapter for Stable-Baselines3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorActionWrapper, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from jackbox_env import checks as check
from jackbox_env.landing import Landings, aiming, always, play
from jackbox_env.observation import BOUNDS
from jackbox_env.planning.features import Features, LookaheadOptions
from jackbox_env.planning.icem import Plans
from jackbox_env.scene import Scene
from jackbox_env.states import Array, Flags, Floats
from jackbox_env.vector_env import JackInBoxVectorEnv

_TORQUES = gym.spaces.Box(-1.0, 1.0, (1,))


class Control:
    """How the agents of N environments act and observe. This one repeats actions; derived ones change more.

    Args:
        repeat: control steps that an action is repeated for.
    """

    action_space: gym.Space[Any] | None = None  # of one agent; None: the environment's
    observation_space: gym.Space[Any] | None = None

    def __init__(self, repeat: int) -> None:
        self.repeat = repeat
        self.stored: dict[str, Any] = {"repeat": repeat}  # how a saved model acts: jackbox_env.sb3.save_model

    def act(self, actions: Any) -> Any:
        """The environments' actions for those of the agents."""
        return actions

    def observe(self, observations: Any, begun: Flags | bool, chosen: Flags | None = None) -> Any:
        """The agents' observations for those of the environments.

        Args:
            observations: of N environments.
            begun: whether an episode has begun, one for all or shape (N,).
            chosen: environments whose observations are new, shape (N,); None: all.
        """
        return observations


class LookingAhead(Control):
    """Appends look-ahead features to the observations of N environments, with warm-started plans.

    After :meth:`act` the next call must be :meth:`observe`. If a step fails in between, a reset must follow.

    Args:
        env: single, or several of Gymnasium or Stable-Baselines3.
        options: of the rollouts.

    Raises:
        TypeError, ValueError: the environments are not of ``JackInBox-v0``, differ, or do not suit ``options.follow``.
    """

    def __init__(self, env: Any, options: LookaheadOptions) -> None:
        super().__init__(options.repeat)
        try:
            tasks, control_dts = of_each(env, "task"), of_each(env, "control_dt")
        except AttributeError as error:
            raise TypeError(f"looking ahead needs JackInBox-v0, got {check.shown(env)}") from error
        for name, values in (("task", tasks), ("control_dt", control_dts)):
            if any(value is not values[0] and value != values[0] for value in values):
                raise ValueError(f"all environments must have one {name}, got {check.shown(values)}")
        if options.follow:
            refuse_other_torques("follow", env)
        self._features = Features(tasks[0], control_dts[0], options)
        space = getattr(env, "single_observation_space", env.observation_space)
        if not isinstance(space, gym.spaces.Box) or space != gym.spaces.Box(-BOUNDS, BOUNDS):
            raise TypeError(f"looking ahead needs the ten numbers of JackInBox-v0, got observations in {space}")
        low, high = np.append(space.low, self._features.low), np.append(space.high, self._features.high)
        self.observation_space = gym.spaces.Box(low, high, dtype=np.float32)
        self._env, self._alone = env, isinstance(env, gym.Env)
        count = 1 if self._alone else env.num_envs
        self._plans, self._begun = self._features.begin(count), np.zeros(count, dtype=np.bool_)
        self._scenes: list[Scene] = []  # of the last observations
        self.stored = {"repeat": options.repeat, "lookahead": asdict(options)}
        self._last: Floats | None = None  # the last observations, (N, 10 + F)

    def act(self, actions: Any) -> Any:
        """Torques for actions, shape (N, 1), or (1,) of one alone.

        Raises:
            RuntimeError: there was no reset yet, or none since a step failed.
            TypeError, ValueError: unusable actions.
        """
        if self._last is None:
            raise RuntimeError("step must come after a reset, got none yet or none since a step failed")
        torques = self._features.torques(actions, self._last[0] if self._alone else self._last)
        self._last = None
        return torques

    def observe(self, observations: Any, begun: Flags | bool, chosen: Flags | None = None) -> Floats:
        """Observations, shape (N, 10), with the features; those that are not ``chosen`` stay unchanged."""
        count, self._begun = len(self._begun), self._begun | begun
        if chosen is None or self._last is None:
            chosen = np.ones(count, dtype=np.bool_)
            self._last = np.zeros((count, len(BOUNDS) + len(self._features.high)), dtype=np.float32)
        shown, self._last = self._last, None
        new, numbers = np.flatnonzero(self._begun), np.flatnonzero(chosen)
        self._plans = self._plans.replaced(new, self._features.begin(len(new)))
        self._scenes = of_each(self._env, "scene")
        shown[numbers], next_plans = self.appended(np.asarray(observations)[numbers], numbers)
        self._plans, self._begun = self._plans.replaced(numbers, next_plans), np.zeros(count, dtype=np.bool_)
        self._last = shown
        return shown.copy()

    def appended(self, observations: Floats, numbers: NDArray[np.int64]) -> tuple[Floats, Plans]:
        """Observations of some environments, shape (k, 10), with the features, and their next plans."""
        scenes = [self._scenes[number] for number in numbers.tolist()] if len(self._scenes) > 1 else self._scenes
        appended, next_plans = self._features.compute(scenes, observations, self._plans.of(numbers))
        return np.concatenate([observations, appended], axis=1), next_plans


class ControlledEnv(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A single environment under a control; ``recorded`` are the keyword arguments for Gymnasium's spec."""

    def __init__(self, env: gym.Env[Any, Any], control: Control, **recorded: Any) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, **recorded)
        gym.Wrapper.__init__(self, env)
        self._control = control
        self.action_space = control.action_space or env.action_space
        self.observation_space = control.observation_space or env.observation_space

    @property
    def stored(self) -> dict[str, Any]:
        """How a saved model acts, for JSON."""
        return self._control.stored

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._control.observe([observation], True)[0], info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Repeat an action until the episode ends, and sum the rewards; the info is that of the last control step.

        Raises:
            TypeError, ValueError: an unusable action.
            JackLostError: the jack, or one in a rollout, cannot be followed. Reset before the next step.
        """
        act, inner = self._control.act(action), cast(Any, self.env.unwrapped)
        choose, resting = always(act), 0
        if isinstance(act, Landings):
            choose, resting = aiming(inner, act.targets[0]), act.resting
        played = play(self.env.step, choose, self._control.repeat, resting)
        if isinstance(act, Landings):
            played.info["duration"] = played.steps * inner.control_dt
        return self._control.observe([played.observation], False)[0], *played[1:5]


class ControlledVectorEnv(VectorWrapper):
    """A vector environment under a control."""

    def __init__(self, env: VectorEnv[Any, Any, Any], control: Control) -> None:
        super().__init__(env)
        self._control, self._over = control, np.zeros(env.num_envs, dtype=np.bool_)  # whose episodes begin in a step
        for name in ("action_space", "observation_space"):
            space = getattr(control, name)
            if space is not None:
                setattr(self, f"single_{name}", space)
                setattr(self, name, batch_space(space, env.num_envs))

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Start an episode in each environment, or in those of ``options["reset_mask"]``."""
        mask = options.get("reset_mask") if isinstance(options, Mapping) else None  # SyncVectorEnv removes it
        observations, infos = self.env.reset(seed=seed, options=options)
        chosen = np.ones(self.num_envs, dtype=np.bool_) if mask is None else np.asarray(mask, dtype=np.bool_)
        self._over = self._over & ~chosen
        return self._control.observe(observations, chosen, chosen), infos

    def step(self, actions: Any) -> tuple[Floats, Array, Flags, Flags, dict[str, Any]]:
        """Repeat actions, less where an episode ends, and sum the rewards; see ``JackInBoxVectorEnv.step``.

        Raises:
            TypeError, ValueError: unusable actions.
            RuntimeError: an episode of single environments ended before the last of these control steps.
            JackLostError: a jack, or one in a rollout, cannot be followed. After either, reset before the next step.
        """
        act, repeat = self._control.act(actions), self._control.repeat
        native = isinstance(self.env, JackInBoxVectorEnv)
        repeat = 1 if isinstance(act, Landings) else repeat
        outcome = self.env.step(act, repeat) if native else repeated(self.env.step, act, repeat)  # type: ignore[call-arg]
        observations, rewards, terminations, truncations, infos = outcome
        over = terminations | truncations
        same_step = self.env.metadata.get("autoreset_mode") is AutoresetMode.SAME_STEP
        if same_step and isinstance(self._control, LookingAhead) and over.any():
            numbers, final = np.flatnonzero(over), infos["final_obs"].copy()
            rows, _ = self._control.appended(np.stack(list(final[numbers])), numbers)
            for number, row in zip(numbers, rows, strict=True):
                final[number] = row
            infos = {**infos, "final_obs": final}
        begun, self._over = (over, self._over) if same_step else (self._over, over)
        return self._control.observe(observations, begun), rewards, terminations, truncations, infos


class Lookahead(ControlledEnv):
    """Observe ``JackInBox-v0`` together with the returns of rollouts from its present state.

    A step repeats one action for ``hold`` control steps and returns the sum of their rewards. With the ten numbers an
    observation has (float32)

    ======  ==============================================================================  ==============
    count   quantity                                                                        bound
    ======  ==============================================================================  ==============
    1       time of the next impact if no torque acts, in shares of a rollout; 1 for none    0 to 1
    10      observation at the end of the control step of that impact                       as observed
    2       mean reward of a step over all ``turns``, and the deviation of these means      10
    turns   mean reward of each turn of the box, less that mean, over that deviation        5
    1       mean reward of a step under the plan                                            10
    3       the plan's next torques over their limit                                        1
    ======  ==============================================================================  ==============

    Scripted turns speed the box up for two pieces of ``hold`` control steps and stop it in two more. The furthest are
    those that the torque's limit allows. The plan is warm-started from the last step's and improved by
    ``samples`` variations (:mod:`jackbox_env.planning.icem`); an episode starts with none. An agent need not follow it.

    >>> env = Lookahead(gym.make("JackInBox-v0"), hold=5, samples=0)
    >>> env.reset(seed=0)[0].shape  # ten numbers, and 22 of these
    (32,)

    Args:
        env: the environment, of either contact model.
        hold: control steps of a step here, 1 or more.
        turns: scripted rollouts, an odd number, or 0 for none.
        samples: variations of the plan that are tried in each step, 8 or more, or 0 for no plan.
        pieces: torques of a rollout, each held for ``hold`` control steps; 8 or more. 32 times 5 steps are 3.2 s.
        follow: True: an action is added to the plan's next torque, so a zero action follows the plan. It needs an
            environment whose actions are torques: no action wrapper inside, and ``torque="agent"``.
        seed: of the variations.
        num_threads: for the rollouts; None: as many as the machine has. Results do not depend on it.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(
        self, env: gym.Env[Any, Any], *, hold: int = 5, turns: int = 9, samples: int = 32, pieces: int = 32,
        follow: bool = False, seed: int = 0, num_threads: int | None = 1,
    ) -> None:  # fmt: skip
        options = LookaheadOptions(hold, turns, samples, pieces, follow, seed, num_threads)
        super().__init__(
            env, LookingAhead(env, options), hold=hold, turns=turns, samples=samples, pieces=pieces, follow=follow,
            seed=seed, num_threads=num_threads,
        )  # fmt: skip


class LookaheadVector(ControlledVectorEnv):
    """:class:`Lookahead` of a vector environment: the same numbers for each of its environments.

    All rollouts of a step are one compiled loop. If ``hold`` is above 1, an episode must restart in the step that ends
    it (``autoreset_mode="SAME_STEP"``). In vector environments of single ones it must last a multiple of ``hold``
    steps.

    >>> envs = LookaheadVector(JackInBoxVectorEnv(4, contact="exact", autoreset_mode="SAME_STEP"), samples=0)
    >>> envs.reset(seed=0)[0].shape
    (4, 32)

    Args:
        env: the vector environment of ``JackInBox-v0``, native or of single ones. The others are those of
            :class:`Lookahead`.

    Raises:
        TypeError, ValueError: an argument out of its range, or ``env`` is no ``JackInBox-v0``.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], *, hold: int = 5, turns: int = 9, samples: int = 32, pieces: int = 32,
        follow: bool = False, seed: int = 0, num_threads: int | None = None,
    ) -> None:  # fmt: skip
        control = LookingAhead(env, LookaheadOptions(hold, turns, samples, pieces, follow, seed, num_threads))
        if control.repeat > 1 and env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ValueError(f"hold must be 1 if autoreset_mode is not SAME_STEP, got {check.shown(hold)}")
        super().__init__(env, control)


def repeated(step: Callable[[Any], tuple[Any, ...]], actions: Any, repeat: int) -> tuple[Any, ...]:
    """Step several environments ``repeat`` times; return the results of the last step, with the sums of rewards.

    Raises:
        RuntimeError: an episode ended before the last of these steps.
    """
    total: Any = 0.0
    for made in range(1, repeat + 1):
        observations, rewards, *ends, infos = step(actions)
        total = total + np.asarray(rewards, dtype=np.float64)
        if made < repeat and np.any(ends):
            raise RuntimeError(
                f"episodes must last a multiple of hold = {repeat} steps, got one that ended {made} steps after an "
                "action was chosen"
            )
    return observations, total, *ends, infos


def of_each(env: Any, name: str) -> list[Any]:
    """An attribute of each environment in ``env``, single or several, or of all of them."""
    inner = env.unwrapped
    if hasattr(inner, "get_attr"):
        return list(inner.get_attr(name))
    return inner.scenes if name == "scene" and hasattr(inner, "scenes") else [getattr(inner, name)]


def refuse_other_torques(who: str, env: Any) -> None:
    """Raise for environments, single or several, whose actions are not torques, which ``who`` needs.

    Raises:
        ValueError: one is driven by the chirp, or there is a wrapper that changes or repeats actions.
    """
    if "chirp" in of_each(env, "torque_source"):
        raise ValueError(f'{who} needs an environment with torque="agent", for it steers, got torque="chirp"')
    wrapper = _action_wrapper(env)
    if wrapper:
        raise ValueError(f"{who} needs actions that are torques, without an action wrapper inside, got {wrapper}")


def _action_wrapper(env: Any) -> str:
    """The first wrapper that changes or repeats actions, of an environment or of several; "" if there is none."""
    inner = env.unwrapped
    if hasattr(inner, "env_is_wrapped"):  # of Stable-Baselines3
        return "an action wrapper" * any(env.env_is_wrapped(gym.ActionWrapper))
    for one in (env, *getattr(inner, "envs", ())):
        while isinstance(one, gym.Wrapper | VectorWrapper):
            if isinstance(one, gym.ActionWrapper | VectorActionWrapper | ControlledEnv | ControlledVectorEnv):
                return type(one).__name__
            one = one.env
    space = getattr(inner, "single_action_space", _TORQUES)
    return "" if space == _TORQUES else f"one that acts in {space}"  # in other processes
