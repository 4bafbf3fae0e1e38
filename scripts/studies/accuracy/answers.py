"""The answers of docs/accuracy.md to "Which one do I pick?"."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from scripts.studies.accuracy.measured import EXACT, REFERENCE, THRESHOLD, Results
from scripts.studies.pages import two_digits
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
        "machine": record["made"].get("engine_costs", "").split(";")[0],
    }


def _span(values: Iterable[float]) -> str:
    ordered = sorted(values)
    return " to ".join(two_digits(value) for value in (*ordered[:1], *ordered[-1:]))
