"""Writes a sweep down: JSON, CSV and the Markdown page."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from agents.storage import replacing
from jackbox_env.simulators.fidelity import FIDELITIES
from scripts.studies.accuracy.cases import DIGITS, KINDS
from scripts.studies.accuracy.pictures import shown
from scripts.studies.accuracy.settings import BATCH, EXACT, NAIVE, SUBSTEPS, pymunk
from scripts.studies.accuracy.summary import ALL, MEANS, SPREADS

DEFAULT = pymunk(4).name


def figure(value: float) -> str:
    """A number for a table: two digits, as a power of ten where it is small; a dash for none."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "lost"
    if abs(value) >= 100.0:
        return f"{value:,.0f}"
    return f"{float(f'{value:.2g}'):g}" if value == 0.0 or abs(value) >= 1e-3 else f"{value:.1e}"


def spread(entry: dict[str, Any]) -> str:
    """Median and worst with the number of cases."""
    return f"{figure(entry['median'])} / {figure(entry['worst'])} ({entry['n']})" if entry["n"] else "-"


def setting_of(fidelity: str) -> str:
    """Name of the setting that a fidelity stands for."""
    contact, substeps = FIDELITIES[fidelity]
    return EXACT if contact == "exact" else pymunk(substeps or 4).name


def named(results: dict[str, Any], fidelity: str) -> dict[str, Any]:
    """The results of that setting."""
    found: dict[str, Any] = results["settings"][setting_of(fidelity)]
    return found


def fidelity_table(results: dict[str, Any]) -> list[str]:
    """What the environment's docstring holds, and a test compares with it."""
    lines = [
        "| `fidelity`   | stands for          | first impact late by | deepest in a wall | right impacts | speed |",
        "|--------------|---------------------|----------------------|-------------------|---------------|-------|",
    ]
    for name, (contact, substeps) in FIDELITIES.items():
        setting = setting_of(name)
        entry, first = results["settings"][setting], shown(results, setting, "first_1")["first_1"]
        stands = f"{contact}, {substeps} substeps" if substeps else contact
        late = f"{figure(first['median'])}, {figure(first['worst'])} s"
        deep = f"{figure(max(0.0, entry['kinds'][ALL]['depth']['worst']))} m"
        right = shown(results, setting, "prefix")["prefix"]["median"]
        quoted = f'`"{name}"`'
        lines.append(
            f"| {quoted:<12} | {stands:<19} | {late:<20} | {deep:<17} | {right:<13g} | "
            f"{figure(1.0 / entry['cost']['over_default']):<5} |"
        )
    return lines


def impacts_table(results: dict[str, Any]) -> list[str]:
    """Errors of flight and impact times of every setting, beside its cost."""
    timed = ("flight", "first_1", "first_3", "first_5", "first_10")
    lines = [
        "| setting | cost | flight [m] | 1st impact [s] | first 3 [s] | first 5 [s] | first 10 [s] | right impacts |",
        "|---|---:|---|---|---|---|---|---|",
    ]
    for name, entry in results["settings"].items():
        if name != BATCH:
            right = shown(results, name, "prefix")
            parts = [figure(entry["cost"]["over_default"])]
            parts += [spread(shown(results, name, part)[part]) for part in timed]
            parts.append(f"{right['prefix']['median']:g} / {right['prefix']['worst']:g} of {right['sure']['median']:g}")
            lines.append(f"| {name} | " + " | ".join(parts) + " |")
    return lines


def motion_table(results: dict[str, Any]) -> list[str]:
    """What else is wrong with every setting, and its cost in microseconds."""
    lines = [
        "| setting | local [m] | energy | depth [m] | lost | missed | extra | us per simulated s |",
        "|---|---|---|---|---|---:|---:|---:|",
    ]
    for name, entry in results["settings"].items():
        cost = "{median:,.0f} ({low:,.0f} to {high:,.0f})".format(**entry["cost"])
        if name == BATCH:
            lines.append(f"| {name} | as {EXACT} |" + " |" * 5 + f" {cost} |")
            continue
        alone, held = shown(results, name, "depth"), shown(results, name, "missed")
        parts = [spread(held["local"]), spread(alone["imbalance"]), spread(alone["depth"])]
        parts.append(f"{alone['escaped']} of {alone['cases']}")
        parts += [figure(1000.0 * held[part] / max(held["expected"], 1)) for part in ("missed", "extra")]
        lines.append(f"| {name} | " + " | ".join(parts) + f" | {cost} |")
    return lines


def statistics_table(results: dict[str, Any]) -> list[str]:
    """Long-run means over the seeded cases of 10 s."""
    lines = [
        "| setting | impacts per s | mean speed [m/s] | 90 % of the time below [m/s] | mean impulse [N s] |",
        "|---|---|---|---|---|",
    ]
    for name, entry in results["settings"].items():
        if name != BATCH:
            means = [entry["kinds"][ALL][part] for part, _ in MEANS]
            cells = [f"{mean['mean']:.3g} ± {mean['half_width']:.2g}" for mean in means]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def verdicts(results: dict[str, Any]) -> list[str]:
    """What to use, in sentences made from the numbers."""
    exact, default = results["settings"][EXACT], results["settings"][DEFAULT]
    many = exact["cost"]["median"] / results["settings"][BATCH]["cost"]["median"]
    coarse, fine = named(results, "coarse"), named(results, "fine")
    right = figure(exact["kinds"][DIGITS]["first_1"]["worst"])
    lines = [
        '- **Elastic scene** (`restitution` 1), training included: `fidelity="exact"`. The simulator takes '
        f"{_ratio(exact)} of the time of the default's (pymunk, 4 substeps), in a batch {many:.0f} times less still, "
        f"and its first impacts are right to {right} s. Its price is some 15 s of compiling, once per machine.",
        '- **Scene with loss** (`restitution` below 1), or no waiting for a compiler: `"balanced"`, the default. The '
        f"first impact is late by {_late(default)}, a foot is up to {_deep(default)} m deep in a wall (worst of "
        f"{default['kinds'][ALL]['cases']} cases). Measured on elastic scenes; up to the first impact loss plays no "
        "part.",
        f'- **The same, but the first impact matters**: `"fine"`: late by {_late(fine)}, up to '
        f"{_deep(fine)} m deep, in {_ratio(fine)} times the default's time. {_within(results, 0.001)}",
        f'- **As cheap as pymunk gets**: `"coarse"`: late by {_late(coarse)}, up to {_deep(coarse)} m deep, in '
        f"{_ratio(coarse)} of the default's time.",
        "- **A scene of your own**: `choice = jackbox_env.cheapest(scene, first_impact_error=0.001, penetration=0.01)` "
        "measures which setting keeps these bounds; `gym.make(..., **choice.setting._asdict())` takes it.",
    ]
    usual = next((entry for name, entry in results["settings"].items() if name.startswith(NAIVE)), None)
    if usual:
        kind = usual["kinds"][ALL]
        lines.append(
            "- **Do not trust energy alone**: the usual way (RK4 at 0.01 s, impacts by threshold) keeps it to "
            f"{figure(kind['imbalance']['median'])} of the kinetic energy in the median and loses the jack in "
            f"{kind['escaped']} of {kind['cases']} runs."
        )
    return lines


def _within(results: dict[str, Any], late: float) -> str:
    """The cheapest setting of pymunk whose first impact is never later than that."""
    for substeps in SUBSTEPS:
        entry = results["settings"].get(pymunk(substeps).name)
        if entry and entry["kinds"][ALL]["first_1"]["worst"] <= late:
            return f"For {1e3 * late:g} ms at worst: `substeps={substeps}`, {_ratio(entry)} times."
    return ""


def _ratio(entry: dict[str, Any]) -> str:
    return f"{entry['cost']['over_default']:.2g}"


def _late(entry: dict[str, Any]) -> str:
    first = entry["kinds"][ALL]["first_1"]
    return f"{1e3 * first['median']:.2g} ms (at worst {1e3 * first['worst']:.2g} ms)"


def _deep(entry: dict[str, Any]) -> str:
    return figure(entry["kinds"][ALL]["depth"]["worst"])


def legend() -> list[str]:
    """What the columns are."""
    return [
        *(f"- `{name}` [{unit}]: {what}" for name, unit, what, _ in SPREADS),
        "- right impacts: `prefix`, of as many as are sure; for `exact` all that are: those on which a twin agrees "
        "that started 1e-13 m aside.",
        "- cost: time over that of the default, taken within rounds.",
        "- us per simulated s: microseconds of the simulator alone, stepped in Python.",
        "- lost: the jack left the box, or the model gave up.",
        "- missed, extra: impacts within 0.1 s after restarts on the reference that did not happen, or should not "
        "have happened, per 1000.",
    ]


def for_the_readme(results: dict[str, Any]) -> str:
    """What the README shows of it."""
    return "\n".join([*fidelity_table(results), "", *verdicts(results)])


def _top(results: dict[str, Any], picture: str, interactive: str) -> list[str]:
    return [
        "# Speed against accuracy",
        "",
        "Which setting to use:",
        "",
        *verdicts(results),
        "",
        *fidelity_table(results),
        "",
        "First impact late by: median, worst. Deepest in a wall: worst. Right impacts: how many have the right wall "
        "and foot before the first wrong one, median; for `exact` as many as float64 can be sure of, chaos takes the "
        'rest. Speed: of the simulator, over that of `"balanced"`. `exact` is held against trajectories computed with '
        "60 digits, the others against `exact`.",
        "",
        f"![Error against cost of every setting]({picture})",
        "",
        f"[The same, interactive]({interactive}), to download and open: a tab per quantity, details under the mouse, "
        "families hidden by a click on the legend.",
        "",
    ]


def _borne_out(results: dict[str, Any]) -> list[str]:
    order, depth = (
        "{order:.2f} ({low:.2f} to {high:.2f})".format(**results["orders"][it]) for it in ("first_1", "depth")
    )
    return [
        "## What this sweep bears out",
        "",
        "| claim | seen | |",
        "|---|---|---|",
        *(f"| {what} | {seen} | {'holds' if holds else 'FAILS'} |" for what, seen, holds in results["claims"]),
        "",
        f"Measured order of convergence of pymunk, error ~ h^p, fitted to medians, with 95 % intervals: p = {order} "
        f"for the time of the first impact, {depth} for the depth.",
        "",
    ]


def _tables(results: dict[str, Any]) -> list[str]:
    seeds = results["settings"][DEFAULT]["kinds"][ALL]["cases"]
    known = results["settings"][EXACT]["kinds"][DIGITS]["cases"]
    return [
        "## Every setting",
        "",
        f"Median / worst (n) over {seeds} seeded cases of 10 s, {results['arguments']['cases']} each of: "
        f"{', '.join(KINDS)}. Reference is the exact model as far as it is sure of itself. Its own errors are over "
        f"{known} trajectories known to 60 digits.",
        "",
        *impacts_table(results),
        "",
        *motion_table(results),
        "",
        *(f"- {name}: {sentence}" for name, sentence in results["missing"].items()),
        "" * bool(results["missing"]),
        "`first_3` and the like are taken over the cases with so many right impacts only: a coarse setting has few, "
        "the easy ones, and looks better there than it is. Columns, and their names in the files:",
        "",
        *legend(),
        "",
        "## Long-run statistics",
        "",
        "Means over the same cases with 95 % intervals. Chaos parts the trajectories; these remain comparable.",
        "",
        *statistics_table(results),
        "",
    ]


def page(results: dict[str, Any], picture: str, interactive: str, files: Iterable[str]) -> str:
    """The whole page."""
    end = ["## How it was measured", "", *results["how"], "", "Files: " + ", ".join(files) + ".", ""]
    return "\n".join([*_top(results, picture, interactive), *_borne_out(results), *_tables(results), *end])


def write_csv(results: dict[str, Any], path: Path) -> None:
    """One row per setting, kind and quantity."""
    with replacing(path) as partial, partial.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["setting", "family", "substeps", "cost_us_per_s", "kind", "quantity", "unit", "median", "worst", "n"]
        )
        for name, entry in results["settings"].items():
            head = [name, entry["family"], entry["substeps"] or "", f"{entry['cost']['median']:.6g}"]
            for kind, found in entry.get("kinds", {}).items():
                for quantity, unit, _, _ in SPREADS:
                    values = found[quantity]
                    row = [kind, quantity, unit, f"{values['median']:.6g}", f"{values['worst']:.6g}", values["n"]]
                    writer.writerow([*head, *row])
                for quantity in ("escaped", "missed", "extra", "expected"):
                    writer.writerow([*head, kind, quantity, "count", found[quantity], found[quantity], found["cases"]])
                for quantity, unit in MEANS:
                    mean = found[quantity]
                    cells = [f"{mean['mean']:.6g}", f"{mean['half_width']:.6g}", mean["n"]]
                    writer.writerow([*head, kind, f"{quantity} (mean, half width of its 95 % interval)", unit, *cells])
