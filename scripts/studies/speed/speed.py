"""Write docs/speed.md: the speed of the environment and the exact model, and of others on the same core."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from scripts.studies import study, timing
from scripts.studies.pages import figure, rounded
from scripts.studies.speed import costs
from scripts.studies.speed import measured as these
from scripts.studies.timing import Rates

STARTS = 3  # cold starts of each kind at most: each compiles everything


RATIOS = {
    "alone": {
        "the default over LunarLander-v3": (these.PYMUNK, these.LANDER),
        "the default under the chirp over LunarLander-v3": (these.CHIRP, these.LANDER),
        "the default over CartPole-v1": (these.PYMUNK, these.POLE),
        "exact over CartPole-v1": (these.EXACT, these.POLE),
        "the default over the bare pymunk loop": (these.PYMUNK, these.BARE),
        "frames of the default over LunarLander-v3's": (these.FRAMES, these.LANDER_FRAMES),
    },
    "together": {
        "`rollout` over the bare pymunk loop": (these.ROLLOUT, these.BARE),
        "unguarded search over the certified one: the cost of certifying": (these.UNGUARDED, these.ROLLOUT),
        "`linearize` with all A and B over `rollout`": (these.MATRICES, these.ROLLOUT),
        "`linearize` and `vjp` over `rollout`": (these.PULLED, these.ROLLOUT),
        "batch over `rollout`: the cost of observation, reward and restarts": (these.BATCH, these.ROLLOUT),
        "batch under the chirp over the same under actions": (these.BATCH_CHIRP, these.BATCH),
        "batch with a scene for each environment over one scene for all": (these.BATCH_SCENES, these.BATCH),
        "batch with jacks drawn at each reset over one scene for all": (these.BATCH_DRAWN, these.BATCH),
        "batch with pictures of 84 x 84 over frames of one environment by pygame": (these.PICTURES, these.BY_PYGAME),
        "batch with a task of one's own over the built-in one": (these.BATCH_TASK, these.BATCH),
        "batch over Gymnasium's own CartPole-v1": (these.BATCH, these.POLES),
        "batch over EnvPool's CartPole-v1": (these.BATCH, these.POOL),
        "batch over a batch of the pymunk model": (these.BATCH, these.FEW),
        "`make_sb3_vec_env` over `DummyVecEnv`": (these.SB3, these.DUMMY),
        "`make_sb3_vec_env` over the batch, 256 environments": (these.SB3_256, these.BATCH_256),
    },
    "threads": {
        f"{name}, two threads over one": (these.by_two(name), name)
        for name in (*map(these.of_size, these.THREADED), these.LONG)
    },
}
PARTS = (*RATIOS, "costs", "start")
ONE = {"pymunk": these.PYMUNK, "exact": these.EXACT, "lander": these.LANDER, "pole": these.POLE}


def ratios_of(part: str, rates: Rates) -> Rates:
    """The ratios of a part in each round, except those to peers that are not installed."""
    return {what: timing.ratios(rates, *two) for what, two in RATIOS[part].items() if set(two) <= set(rates)}


def measured(part: str, rounds: int, seconds: float) -> dict[str, Any]:
    """Rates and ratios, or costs, of a part of the page in each round, on one core except for threads."""
    cores = os.sched_getaffinity(0) if timing.PINNED else {0}
    timing.on_cores(cores if part == "threads" else {max(cores)})
    makes: dict[str, Callable[[float], dict[str, timing.Timed]]] = {
        "alone": these.alone, "together": these.together, "threads": partial(these.threads, len(cores)),
        "costs": costs.costs,
    }  # fmt: skip
    if part == "start":
        results = these.start(min(rounds, STARTS))
    else:
        rates = timing.measure(makes[part](seconds), rounds)
        results = costs.figures(rates) if part == "costs" else {"rates": rates, "ratios": ratios_of(part, rates)}
    if part == "together":
        results["lost"] = these.lost()
    timing.on_cores(cores)
    return results


def with_earlier(new: study.Record, stored: study.Record) -> study.Record:
    """New results, with the stored ratios to peers that are not installed now, and what measured those."""
    for part in RATIOS.keys() & new.keys():
        before = stored.get(part, {"ratios": {}, "kept": {}})
        earlier = {what: {"values": values, "made": stored["made"][part]} for what, values in before["ratios"].items()}
        of = new[part]["ratios"]
        new[part]["kept"] = {what: one for what, one in (earlier | before["kept"]).items() if what not in of}
    return new


# -- the page ----------------------------------------------------------------------------------------------------------


def filled(results: study.Record) -> dict[str, Any]:
    """The numbers of docs/speed.md."""
    together = results["together"]
    rates = {
        part: {name: rounded(statistics.median(values)) for name, values in of["rates"].items()}
        for part, of in results.items()
        if part in RATIOS
    }
    kept = {what: one["values"] for part in rates for what, one in results[part]["kept"].items()}
    ratios = kept | {what: values for part in rates for what, values in results[part]["ratios"].items()}
    return {
        "one": {name: rates["alone"][of] for name, of in ONE.items()},
        "batch": rates["together"][these.BATCH],
        "start": {name: rounded(statistics.median(results["start"][name])) for name in ("cold", "warm")},
        "ratios": {what: figure(statistics.median(values)) for what, values in ratios.items()},
        "costs": costs.filled(results["costs"]),
        "lost": together["lost"],
        "memory": results["start"],
    }


def for_the_readme(results: study.Record) -> str:
    """The README's sentence on speed."""
    over = over_cart_pole(results["together"])
    return f"a batch of 1,024 makes [{over} times as many steps](docs/speed.md) as a batch of Gymnasium's CartPole"


def over_cart_pole(together: Mapping[str, Any]) -> str:
    """Steps of the batch over those of Gymnasium's own batch of CartPole-v1."""
    return rounded(statistics.median(together["ratios"]["batch over Gymnasium's own CartPole-v1"]))


STUDY = study.Study(
    "speed",
    {part: partial(measured, part) for part in PARTS},
    filled,
    study.TimedArguments,
    alone=frozenset(PARTS),
    packages=("jackbox", "gymnasium", "numpy", "pymunk", "numba", "stable-baselines3", "envpool"),
    joined=with_earlier,
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
