"""docs/speed.md and the README's table, from stored results.

Results are stored by part: ``rates`` and ``ratios`` in each round; ``made``, with what they were measured; ``kept``,
the ratios of an earlier run to peers that were not installed.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from typing import Any

from scripts.studies import timing
from scripts.studies.pages import cells, figure, joined, rough
from scripts.studies.speed import measured as names
from scripts.studies.timing import Rates

Results = Mapping[str, Mapping[str, Any]]


RATIOS = {
    "alone": {
        "the default over LunarLander-v3": (names.PYMUNK, names.LANDER),
        "the default under the chirp over LunarLander-v3": (names.CHIRP, names.LANDER),
        "the default over CartPole-v1": (names.PYMUNK, names.POLE),
        "exact over CartPole-v1": (names.EXACT, names.POLE),
        "the default over the bare pymunk loop": (names.PYMUNK, names.BARE),
        "frames of the default over LunarLander-v3's": (names.FRAMES, names.LANDER_FRAMES),
    },
    "together": {
        "`rollout` over the bare pymunk loop": (names.ROLLOUT, names.BARE),
        "unguarded search over the certified one: what certifying costs": (names.UNGUARDED, names.ROLLOUT),
        "batch over `rollout`: what observation, reward and restarts leave": (names.BATCH, names.ROLLOUT),
        "batch under the chirp over the same under actions": (names.BATCH_CHIRP, names.BATCH),
        "batch with a scene for each environment over one scene for all": (names.BATCH_SCENES, names.BATCH),
        "batch with jacks drawn at each reset over one scene for all": (names.BATCH_DRAWN, names.BATCH),
        "batch with a task of one's own over the built-in one": (names.BATCH_TASK, names.BATCH),
        "batch over Gymnasium's own CartPole-v1": (names.BATCH, names.POLES),
        "batch over EnvPool's CartPole-v1": (names.BATCH, names.POOL),
        "batch over a batch of the pymunk model": (names.BATCH, names.FEW),
        "`make_sb3_vec_env` over `DummyVecEnv`": (names.SB3, names.DUMMY),
        "`make_sb3_vec_env` over the batch, 256 environments": (names.SB3_256, names.BATCH_256),
        **{
            f"time of an impact at {rate} rad/s over one at {names.RATES[0]} rad/s": (
                names.at_rate(names.RATES[0]),
                names.at_rate(rate),
            )
            for rate in names.RATES[1:]
        },
    },
    "threads": {
        f"{name}, two threads over one": (names.by_two(name), name)
        for name in (*map(names.of_size, names.THREADED), names.LONG)
    },
}
VARIED = (  # batches that vary one thing, in tables of their own
    names.BATCH_CHIRP, names.BATCH_SCENES, names.BATCH_DRAWN, names.BATCH_TASK, names.BATCH_256, names.SB3_256,
    *map(names.at_rate, names.RATES),
)  # fmt: skip
PICTURE = {
    "exact, batch of 1,024": ("together", names.BATCH),
    "CartPole, Gymnasium's batch of 1,024": ("together", names.POLES),
    "exact, one": ("alone", names.EXACT),
    "CartPole, one": ("alone", names.POLE),
    "pymunk (the default), one": ("alone", names.PYMUNK),
    "LunarLander, one": ("alone", names.LANDER),
}


def ratios_of(part: str, rates: Rates) -> Rates:
    """The ratios of a part in each round. Ratios to peers that are not installed are left out."""
    return {what: timing.ratios(rates, *two) for what, two in RATIOS[part].items() if set(two) <= set(rates)}


def kept_of(stored: Mapping[str, Any], ratios: Rates) -> dict[str, Any]:
    """The ratios of a stored part that are not among those measured now."""
    known = {what: {"values": values, "made": stored["made"]} for what, values in stored.get("ratios", {}).items()}
    return {what: found for what, found in (known | stored.get("kept", {})).items() if what not in ratios}


def rate_table(rates: Rates) -> list[str]:
    """Rates with their extremes and the time of one."""
    lines = ["| what | per second | smallest to largest | ns each |", "|---|---:|---:|---:|"]
    return lines + [
        f"| {name} | {cells(values)} | {figure(1e9 / statistics.median(values))} |" for name, values in rates.items()
    ]


def before_of(stored: Mapping[str, Any]) -> dict[str, Any]:
    """The ratios that a part is held against: those it already was, or its own as stored."""
    if not stored or "before" in stored:
        return dict(stored.get("before", {}))
    return {"ratios": {what: statistics.median(values) for what, values in stored.get("ratios", {}).items()},
            "made": stored["made"]}  # fmt: skip


def ratio_table(found: Mapping[str, Any]) -> list[str]:
    """Ratios with their extremes, those of an earlier run last, beside what they were before."""
    earlier = found.get("before", {}).get("ratios", {})
    lines = ["| ratio | median | smallest to largest | before |", "|---|---:|---:|---:|"]
    for what, values in all_ratios(found).items():
        lines.append(f"| {what} | {cells(values)} | {figure(earlier[what]) if what in earlier else ''} |")
    for what, kept in found["kept"].items():
        lines += ["", f"Not installed here, and kept from an earlier run: {what}. {kept['made']}"]
    return lines


def all_ratios(found: Mapping[str, Any]) -> Rates:
    """The ratios measured, and those kept of an earlier run."""
    return {**found["ratios"], **{what: kept["values"] for what, kept in found["kept"].items()}}


def answer(results: Results) -> str:
    """The page in three sentences."""

    def shown(part: str, name: str) -> str:
        return rough(statistics.median((results[part]["rates"] | all_ratios(results[part]))[name]))

    cold, warm = (rough(statistics.median(results["start"][name])) for name in ("cold", "warm"))
    peers = {"Gymnasium's own": "Gymnasium's own batch of CartPole-v1", "EnvPool's": "EnvPool's"}
    known = all_ratios(results["together"])
    over = [
        f"{shown('together', what)} times as many as {words}"
        for whose, words in peers.items()
        if (what := f"batch over {whose} CartPole-v1") in known
    ]
    return (
        f"One environment makes {shown('alone', names.PYMUNK)} control steps per second by default (pymunk) and "
        f'{shown("alone", names.EXACT)} with `contact="exact"`; LunarLander-v3 makes {shown("alone", names.LANDER)}, '
        f"CartPole-v1 {shown('alone', names.POLE)}. A batch of 1,024 exact environments makes "
        f"{shown('together', names.BATCH)} per second on one core, {' and '.join(over)}. The exact model is compiled "
        f"once per machine, here in {cold} s; after that a process makes its first step within {warm} s."
    )


def guarantee(lost: Mapping[str, int]) -> str:
    """What the certified search is worth, beside its price in the table above."""
    return (
        f"What certifying buys: of {lost['of']:,} episodes, a search that looks only at a step's end misses an impact "
        f"in {lost['missed']} and puts a foot outside the box in {lost['escaped']}. The certified search puts one "
        f"outside in {lost['certified']}."
    )


def section(found: Mapping[str, Any]) -> list[str]:
    """The tables of a part."""
    return [*rate_table(found["rates"]), "", *ratio_table(found)]


def halves(part: str, found: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A part without and with what is ``VARIED`` in it."""
    rates = found["rates"]
    varied = {what for what, two in RATIOS[part].items() if set(two) & set(VARIED)}

    def half(chosen: bool) -> dict[str, Any]:
        return {
            **found,
            "rates": {name: values for name, values in rates.items() if (name in VARIED) is chosen},
            "ratios": {what: values for what, values in found["ratios"].items() if (what in varied) is chosen},
            "kept": {what: kept for what, kept in found["kept"].items() if (what in varied) is chosen},
        }

    return half(False), half(True)


def page(results: Results, picture: str) -> str:
    """docs/speed.md."""
    start, certifying = results["start"], ["", guarantee(results["together"]["lost"])]
    usual, varied = halves("together", results["together"])
    memory = f"A process grows by at most {start['bytes']:.0f} bytes for each of {start['of']:,} environments."
    return joined(
        {
            "# How fast it is": [answer(results), "", f"![Control steps per second on one core]({picture})"],
            "## One environment": section(results["alone"]),
            "## Batches on one core": [*section(usual), *certifying],
            "## Scenes, tasks and drives of one's own, and fast boxes": [VARYING, "", *section(varied)],
            "## Size of the batch, and threads": [*section(results["threads"]), "", memory],
            "## How it was measured": [
                HOW,
                "",
                *(f"- `{part}`: {found['made']}" for part, found in results.items()),
                *(
                    f"- `{part}`, before: {found['before']['made']}"
                    for part, found in results.items()
                    if found.get("before")
                ),
            ],
        }
    )


VARYING = "The batch of 1,024 above varied, batches of 256, and impacts of `rollout` in a heavy box that turns."
HOW = (
    "`make speed` measures in interleaved rounds after one to warm up. Ratios are taken within a round. A table "
    "shows the median over the rounds and the extremes. A step is a control step of 0.02 s under a random action, a "
    "new one in each step; episodes have 500 steps from the environment's own starts. Everything runs on one core "
    "and is timed by processor time, which leaves out other processes. Only batch size and threads are timed by the "
    "wall clock; their batches start from random moments of episodes. This page and [the costs](costs.md) were "
    "measured in different hours of a shared machine, so only the ratios within a page count. The parts of the page, "
    "as `make speed` last measured them:"
)


def for_the_readme(results: Results) -> str:
    """The README's table: what the picture shows."""
    lines = ["| control steps per second on one core | |", "|---|---:|"]
    for name, rate in pictured(results).items():
        lines.append(f"| {name} | {rough(rate)} |")
    machine = results["alone"]["made"].split(";")[0]
    return "\n".join([*lines, "", f"Measured by `make speed` on {machine}."])


def told(results: Results) -> str:
    """What `make throughput` prints: single environments, and ratios beneath."""
    found = results["alone"]
    lines = ["| what | per second | microseconds |", "|------|-----------:|-------------:|"]
    each = {name: statistics.median(values) for name, values in found["rates"].items()}
    lines += [f"| {name} | {rate:,.0f} | {1e6 / rate:.1f} |" for name, rate in each.items()]
    lines += ["", "Ratios, medians over interleaved rounds:", ""]
    lines += [f"- {what}: {figure(statistics.median(values))}" for what, values in found["ratios"].items()]
    return "\n".join([*lines, "", found["made"]])


def pictured(results: Results) -> dict[str, float]:
    """The bars of the picture: steps per second."""
    return {label: statistics.median(results[part]["rates"][name]) for label, (part, name) in PICTURE.items()}
