"""Checks the arguments of a batch of ``count`` environments, its resets among them, before anything changes.

Each function raises TypeError or ValueError in one sentence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike

from jackbox_env.envs.batch import Change
from jackbox_env.model.action import ACTIONS, Action
from jackbox_env.model.scene import Scene, scenes_of
from jackbox_env.model.states import LATEST_TIME, Array, Flags, as_start
from jackbox_env.tools import checks as check


def actions_of(count: int, action: Action, actions: ArrayLike, waiting: Flags | None) -> Array:
    """Actions of N environments as float64, shape (n, N); those of ``waiting`` ones are ignored.

    Shares of the torque limit are clipped and checked where they are used.
    """
    if action is not ACTIONS["torque"]:
        return action.checked(actions, count, waiting)
    numbers = check.array("actions", actions, "be numbers (clipped to [-1, 1])")
    if numbers.shape not in ((count, 1), (count,)):
        raise ValueError(f"actions must have shape ({count}, 1) or ({count},), got shape {numbers.shape}")
    return numbers.reshape(1, count).astype(np.float64)


def seeds_of(count: int, seed: int | Sequence[int | None] | None) -> list[int | None]:
    """A seed for each environment: s + i for a whole number s, or as listed; None: no seed."""
    if seed is None:
        return [None] * count
    several = isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str | bytes)
    if not several or getattr(seed, "ndim", 1) == 0:
        first = check.whole("seed", seed, at_least=0)
        return [first + number for number in range(count)]
    listed = list(seed)  # type: ignore[arg-type]
    if len(listed) != count:
        raise ValueError(f"seed must be a whole number or a list of {count}, got {len(listed)} of them")
    return [None if one is None else check.whole("seed", one, at_least=0) for one in listed]


def mask_of(count: int, name: str, flags: Any) -> Flags:
    """A checked choice of environments: a fresh array of bool, shape (N,)."""
    try:
        mask = np.asarray(flags)
    except ValueError as error:  # a ragged list
        raise TypeError(f"{name} must be an array of bool, got {check.shown(flags)}") from error
    if mask.dtype != np.bool_:
        raise TypeError(f"{name} must be an array of bool, got {check.shown(flags)}")
    if mask.shape != (count,):
        raise ValueError(f"{name} must have shape ({count},), got {mask.shape}")
    return mask.copy()


def times_of(count: int, name: str, numbers: ArrayLike, chosen: Flags) -> Array:
    """Times [s], a number or shape (N,), checked if ``chosen``, 0 otherwise."""
    times = check.array(name, numbers, "be numbers")
    if times.shape not in ((), (count,)):
        raise ValueError(f"{name} must be a number or have shape ({count},), got shape {times.shape}")
    all_times = np.broadcast_to(times.astype(np.float64), (count,))
    for time in np.unique(all_times[chosen]).tolist():
        check.real(name, time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
    return np.where(chosen, all_times, 0.0)


def states_of(
    count: int, name: str, numbers: ArrayLike, chosen: Flags, checked: Callable[[Scene, Any], Array]
) -> Callable[[Callable[[int], Scene]], Array]:
    """A function that checks the ``chosen`` rows of states, shape (N, 12), against the scenes and returns all.

    Raises:
        TypeError, ValueError: another shape. The function raises it for an unusable state.
    """
    states = check.array(name, numbers, "be numbers")
    if states.shape not in ((12,), (count, 12)):
        raise ValueError(f"{name} must have shape (12,) or ({count}, 12), got shape {states.shape}")

    def rows(scene_of: Callable[[int], Scene]) -> Array:
        restored = np.zeros((count, 12))
        by_scene = dict[Scene, Array]()
        for number in np.flatnonzero(chosen).tolist():
            scene = scene_of(number)
            if states.ndim == 1 and scene in by_scene:
                restored[number] = by_scene[scene]
                continue
            try:
                restored[number] = checked(scene, states if states.ndim == 1 else states[number])
            except (TypeError, ValueError) as error:
                if states.ndim == 1 and not by_scene:
                    raise
                where = f"{name}[{number}]" if states.ndim > 1 else f"{name} in environment {number}"
                raise type(error)(f"{where}: {error}") from error
            by_scene[scene] = restored[number]
        return restored

    return rows


def scenes_in(count: int, argument: Any) -> list[Scene]:
    """One scene for all environments, or one for each."""
    scenes, several = scenes_of(argument)
    if several and len(scenes) != count:
        raise ValueError(f"scene must be one scene or a list of {count}, got {len(scenes)} of them")
    return scenes if any(scene != scenes[0] for scene in scenes) else scenes[:1]


def changes_of(count: int, argument: Any, chosen: Flags) -> list[Change]:
    """Fields of the scene that change, for each of the ``chosen`` environments."""
    if isinstance(argument, Mapping):
        return [argument] * int(chosen.sum())
    several = isinstance(argument, Sequence) and not isinstance(argument, str)
    if not several or len(argument) != count or not all(isinstance(one, Mapping | None) for one in argument):
        raise TypeError(
            f"options['scene'] must be a dict of the scene's fields or a list of {count}, got {check.shown(argument)}"
        )
    return [argument[number] or {} for number in np.flatnonzero(chosen).tolist()]


class ResetPlan(NamedTuple):
    """The checked arguments of a reset."""

    chosen: Flags  # (N,) the environments to reset
    seeds: list[int | None]
    changes: list[Change] | None  # of the chosen environments' scenes; None: unchanged, or drawn
    states: Callable[[Callable[[int], Scene]], Array] | None  # the starts (N, 12), checked in the scenes; None: drawn
    times: Array  # (N,) [s]


def plan_of(count: int, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None) -> ResetPlan:
    """Check the seed and options of a reset of ``count`` environments. Scenes, and states in them, are checked later.

    Raises:
        TypeError, ValueError: an unusable seed or option.
    """
    options = options_of(options, ("state", "time", "scene", "reset_mask"))
    chosen = np.ones(count, dtype=np.bool_)
    if options.get("reset_mask") is not None:
        chosen = mask_of(count, "options['reset_mask']", options["reset_mask"])
        if not chosen.any():
            raise ValueError("options['reset_mask'] must choose at least one environment, got none")
    times = times_of(count, "options['time']", 0.0 if options.get("time") is None else options["time"], chosen)
    states = None
    if options.get("state") is not None:
        states = states_of(count, "options['state']", options["state"], chosen, as_start)
    changes = None if options.get("scene") is None else changes_of(count, options["scene"], chosen)
    return ResetPlan(chosen, seeds_of(count, seed), changes, states, times)


def options_of(options: Any, names: Sequence[str]) -> dict[str, Any]:
    """The options of a reset, which may have these names.

    Raises:
        TypeError, ValueError: no dict, or another name.
    """
    if not isinstance(options, Mapping | None):
        listed = f"{', '.join(map(repr, names[:-1]))} and {names[-1]!r}"
        raise TypeError(f"options must be a dict of {listed} or None, got {check.shown(options)}")
    check.known_keys("options", options or {}, names)
    return dict(options or {})


def as_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the enum, also from its name or its value.

    Raises:
        ValueError: it is neither.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    words = {word: one for one in AutoresetMode for word in (one.name, one.value)}
    return words[check.choice("autoreset_mode", mode, words)]
