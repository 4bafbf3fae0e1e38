"""Arguments of the vector environment's resets, checked before anything changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from jackbox_env.envs.arguments import Arguments
from jackbox_env.envs.batch import Change
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Flags, as_start
from jackbox_env.tools import checks as check


class ResetPlan(NamedTuple):
    """The checked arguments of a reset."""

    chosen: Flags  # (N,) the environments to reset
    seeds: list[int | None]
    changes: list[Change] | None  # of the chosen environments' scenes; None: unchanged, or drawn
    states: Callable[[Callable[[int], Scene]], Array] | None  # the starts (N, 12), checked in the scenes; None: drawn
    times: Array  # (N,) [s]


def plan_of(
    arguments: Arguments, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
) -> ResetPlan:
    """Check a reset's seed and options. Scenes, and states in them, are checked later.

    Raises:
        TypeError, ValueError: an unusable seed or option.
    """
    if not isinstance(options, Mapping | None):
        names = "'state', 'time', 'scene' and 'reset_mask'"
        raise TypeError(f"options must be a dict of {names} or None, got {check.shown(options)}")
    options = dict(options or {})
    check.known_keys("options", options, ("state", "time", "scene", "reset_mask"))
    chosen = np.ones(arguments.num_envs, dtype=np.bool_)
    if options.get("reset_mask") is not None:
        chosen = arguments.mask("options['reset_mask']", options["reset_mask"])
        if not chosen.any():
            raise ValueError("options['reset_mask'] must choose at least one environment, got none")
    times = arguments.times("options['time']", 0.0 if options.get("time") is None else options["time"], chosen)
    states = None
    if options.get("state") is not None:
        states = arguments.states("options['state']", options["state"], chosen, as_start)
    changes = None if options.get("scene") is None else arguments.changes(options["scene"], chosen)
    return ResetPlan(chosen, arguments.seeds(seed), changes, states, times)


def as_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the enum, also from its name or its value.

    Raises:
        ValueError: it is neither.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    words = {word: one for one in AutoresetMode for word in (one.name, one.value)}
    return words[check.choice("autoreset_mode", mode, words)]
