"""Write docs/speed.md: the speed of the environment and the exact model, and of others on the same core."""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from jackbox_env.tools.command_line import command_line
from scripts.studies import timing
from scripts.studies.pages import figure, rounded, table
from scripts.studies.speed import measured as these
from scripts.studies.timing import Rates

Part = Literal["alone", "together", "threads", "start"]
PACKAGES = ("jackbox", "gymnasium", "numpy", "pymunk", "numba", "stable-baselines3", "envpool")
STARTS = 3  # cold starts of each kind at most: each compiles everything


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    parts: tuple[Part, ...] = ("alone", "together", "threads", "start")
    """Parts of the page to measure; the others stay as stored. None: only write the page from stored results."""
    rounds: int = 5
    """Rounds; each measures everything once, so that a slow moment of the machine falls on all."""
    seconds: float = 0.4
    """Time per measurement [s]."""
    out: Path = Path("docs")
    """Folder of the page speed.md and its results speed.json."""


# Results are stored by part: rates and ratios in each round; made: machine, versions and rounds; kept: ratios of an
# earlier run to peers that are not installed now.
Results = Mapping[str, Mapping[str, Any]]
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
ONE = {"pymunk": these.PYMUNK, "exact": these.EXACT, "lander": these.LANDER, "pole": these.POLE}


def ratios_of(part: str, rates: Rates) -> Rates:
    """The ratios of a part in each round, except those to peers that are not installed."""
    return {what: timing.ratios(rates, *two) for what, two in RATIOS[part].items() if set(two) <= set(rates)}


def earlier_ratios(stored: Mapping[str, Any], ratios: Rates) -> dict[str, Any]:
    """The ratios of a stored part that are not among those measured now."""
    known = {what: {"values": values, "made": stored["made"]} for what, values in stored.get("ratios", {}).items()}
    return {what: ratio for what, ratio in (known | stored.get("kept", {})).items() if what not in ratios}


def measured(part: Part, rounds: int, seconds: float, stored: dict[str, Any]) -> dict[str, Any]:
    """Measure a part of the page. The ``stored`` ratios to peers that are not installed now stay."""
    before, cores = timing.core_seconds(), os.sched_getaffinity(0) if timing.PINNED else {0}
    timing.on_cores(cores if part == "threads" else {max(cores)})
    results: dict[str, Any] = {}
    if part == "start":
        results = these.start(min(rounds, STARTS))
    else:
        makes: dict[str, Callable[[float], dict[str, timing.Timed]]] = {
            "alone": these.alone, "together": these.together, "threads": partial(these.threads, len(cores))
        }  # fmt: skip
        results["rates"] = timing.measure(makes[part](seconds), rounds)
        results["ratios"] = ratios_of(part, results["rates"])
        results["kept"] = earlier_ratios(stored, results["ratios"])
    if part == "together":
        results["lost"] = these.lost()
    timing.on_cores(cores)
    made = f"{timing.measured_with(PACKAGES)}; {rounds} rounds of {seconds:g} s. {timing.busy_since(before)}"
    return results | {"made": made}


# -- the page ----------------------------------------------------------------------------------------------------------


def _section(results: Mapping[str, Any]) -> str:
    """The tables of a part: rates and ratios; those of an earlier run last."""
    rates = [[name, *_cells(values)] for name, values in results["rates"].items()]
    ratios = [[what, *_cells(values)] for what, values in all_ratios(results).items()]
    earlier = [
        f"Not installed here, and kept from an earlier run: {what}. {one['made']}"
        for what, one in results["kept"].items()
    ]
    lines = [
        table(("what", "per second", "smallest to largest"), rates),
        table(("ratio", "median", "smallest to largest"), ratios),
        *earlier,
    ]
    return "\n\n".join(lines)


def _cells(values: list[float]) -> list[str]:
    """The median, and the extremes of two or more values."""
    extremes = f"{figure(min(values))} to {figure(max(values))}" if len(values) > 1 else ""
    return [figure(statistics.median(values)), extremes]


def all_ratios(results: Mapping[str, Any]) -> Rates:
    """The ratios of this run and of an earlier one."""
    return {**results["ratios"], **{what: earlier["values"] for what, earlier in results["kept"].items()}}


def page(results: Results) -> str:
    """docs/speed.md."""
    together = results["together"]
    rates = {
        part: {name: rounded(statistics.median(values)) for name, values in of["rates"].items()}
        for part, of in results.items()
        if "rates" in of
    }
    over = {what: rounded(statistics.median(values)) for what, values in all_ratios(together).items()}
    peers = {"Gymnasium's own": "Gymnasium's own batch of CartPole-v1", "EnvPool's": "EnvPool's"}
    known = {f"batch over {whose} CartPole-v1": words for whose, words in peers.items()}
    fields = {
        "one": {name: rates["alone"][of] for name, of in ONE.items()},
        "batch": rates["together"][these.BATCH],
        "over": " and ".join(f"{over[what]} times as many as {words}" for what, words in known.items() if what in over),
        "start": {name: rounded(statistics.median(results["start"][name])) for name in ("cold", "warm")},
        "tables": {part: _section(results[part]) for part in rates},
        "lost": together["lost"],
        "memory": results["start"],
        "made": _made(results),
    }
    return (Path(__file__).parent / "page.md").read_text().format(**fields)


def _made(results: Results) -> str:
    """Machine and versions, once for all parts that share them, and each part's commit and rounds."""
    parts = dict[str, list[str]]()
    for part, of in results.items():
        shared, _, rest = of["made"].partition(", commit ")
        parts.setdefault(shared, []).append(f"`{part}` at commit {rest}")
    return "\n".join(f"- {shared}: {' '.join(ones)}" for shared, ones in parts.items())


def for_the_readme(results: Results) -> str:
    """The README's sentence on speed."""
    rates = results["together"]["rates"]
    batch, cart_pole = (rounded(statistics.median(rates[name])) for name in (these.BATCH, these.POLES))
    return f"a batch of 1,024 makes [{batch} control steps a second](docs/speed.md), Gymnasium's CartPole {cart_pole}"


@command_line
def main() -> None:
    """Parse, measure, write, print."""
    import tyro

    from jackbox_env.tools import checks as check
    from jackbox_env.tools.files import check_writable, write_json, write_text

    arguments = tyro.cli(Arguments, description=__doc__)
    check.whole("rounds", arguments.rounds, at_least=1)
    check.real("seconds", arguments.seconds, above=0.0)
    check_writable(arguments.out)
    path = arguments.out / "speed.json"
    results: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    missing = [part for part in get_args(Part) if part not in {*arguments.parts, *results}]
    if missing:
        raise ValueError(f"parts must name {' and '.join(missing)} too: {path} has no such results yet")
    for part in arguments.parts:
        results[part] = measured(part, arguments.rounds, arguments.seconds, results.get(part, {}))
        write_json(path, results)
    write_text(arguments.out / "speed.md", page(results))
    print(_section(results["alone"]), results["alone"]["made"], sep="\n\n")


if __name__ == "__main__":
    main()
