"""Infos of the vector environment: arrays, each with a mask of the environments for which it is valid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jackbox_env.envs.batch import Outcome
from jackbox_env.model.states import Flags

Infos = dict[str, Any]


class NoInfos(dict[str, Any]):
    """Infos of environments made without ``with_infos``. The KeyError for a missing info names that argument."""

    __slots__ = ()

    def __missing__(self, name: str) -> Any:
        known = (*blank((), 0), "scene")
        if str(name).removeprefix("_") in known or str(name).startswith(("reward_", "_reward_")):
            raise KeyError(f"infos have {name!r} only in environments made with with_infos=True")
        raise KeyError(name)

    def copy(self) -> NoInfos:
        """A copy of the same kind."""
        return NoInfos(self)


def masked(infos: Infos, mask: Flags) -> Infos:
    """Add to each info ``name`` its mask ``_name``, as Gymnasium's vector environments do."""
    return infos | {f"_{name}": mask.copy() for name in infos}


def blank(terms: Sequence[str] | None, count: int) -> Infos:
    """Infos of ``count`` environments under the names of the single one, all 0.

    ``terms``: of the task's reward; None: only durations.
    """
    if terms is None:
        return {"duration": np.zeros(count)}
    names = ("time", "torque", "impacts", "impulse", "duration", *(f"reward_{term}" for term in terms))
    numbers: Infos = {name: np.zeros(count) for name in names}
    return {"state": np.zeros((count, 12)), **numbers, "impacts": np.zeros(count, dtype=np.int64)}


def infos_at_start(terms: Sequence[str] | None, batch: Any, chosen: Flags) -> Infos:
    """Infos, without masks, of the ``chosen`` environments of a batch at the start of an episode."""
    infos = blank(terms, len(chosen))
    if terms is not None:
        infos["state"][chosen], infos["time"][chosen] = batch.states[chosen], batch.times[chosen]
    return infos


def infos_at_end(outcome: Outcome, drawn: Infos) -> Infos:
    """Last observations and infos of the episodes that a step ended; ``drawn``: of their scenes, masked."""
    ended = outcome.ended
    last = np.full(len(ended), None, dtype=object)
    for number in np.flatnonzero(ended):
        last[number] = outcome.observations[number].copy()
    final = {
        name: np.where(ended if values.ndim == 1 else ended[:, None], values, np.zeros_like(values))
        for name, values in outcome.infos.items()
    }
    return masked({"final_obs": last, "final_info": masked(final | drawn, ended)}, ended)
