"""The answers of docs/accuracy.md to "Which one do I pick?", and the table of the engines' settings."""

from __future__ import annotations

import json
from collections.abc import Iterable
from textwrap import fill
from typing import Any

from scripts.studies.accuracy.engines import ENGINES
from scripts.studies.accuracy.measured import EXACT, REFERENCE, THRESHOLD, Results
from scripts.studies.pages import table, two_digits
from scripts.studies.study import Record


def words(record: Record) -> dict[str, Any]:
    """The numbers of the answers."""
    results, timed = Results.of_record(record), record.get("engine_costs", [])
    dearer = {one["setting"][0]: one["rows"][0]["median"] for one in timed}
    dearer = {name: cost / dearer[EXACT] for name, cost in dearer.items()}
    fixed = [name for name in dearer if name.endswith(", 64 substeps") and not name.startswith("mujoco")]
    located = [name for name in dearer if name.startswith(("Drake", "solve_ivp"))]
    lost = results.of(THRESHOLD, "escaped", REFERENCE)
    return {
        "fixed": _span(results.of(name, "prefix", REFERENCE).total for name in fixed),
        "fixed_cost": _span(map(dearer.__getitem__, fixed)),
        "fastest": min(fixed, key=dearer.__getitem__, default="").split(",")[0],
        "located": _span(results.of(name, "prefix", REFERENCE).total for name in located),
        "located_cost": _span(map(dearer.__getitem__, located)),
        "lost": f"{lost.total:g} of {lost.n}",
        "kept": "".join(
            f" {name} is not installed here: its results are of an earlier run."
            for name in dict.fromkeys(one["setting"][1] for one in timed if "kept" in one)
        ),
        "settings": settings_table(record),
        "machine": record["made"].get("engine_costs", "").split(";")[0],
        "matter": fill(json.dumps({"substeps": 4, **ENGINES["matter.js"].best}), 96, subsequent_indent="  "),
    }


def _span(values: Iterable[float]) -> str:
    ordered = sorted(values)
    return " to ".join(two_digits(value) for value in (*ordered[:1], *ordered[-1:]))


def settings_table(record: Record) -> str:
    """The settings that the search found for each engine, and the change of one of them that costs the most."""
    rows = []
    for one in record.get("search", []):
        (name, unit, points), worst = one["setting"], min(one["tried"], key=lambda row: row["correct"])
        change = {name: value for name, value in worst["settings"].items() if value != one["best"][name]}
        most = f"{max(row['correct'] for row in one['tried'])}, at {' and '.join(f'{n:g}' for n in points)} {unit}"
        columns = f"`{json.dumps(one['best'])}`", most, f"{worst['correct']}: `{json.dumps(change)}`"
        rows.append((name, one["version"], *columns))
    return table(("engine", "version", "settings", "correct impacts", "worst tried"), rows)
