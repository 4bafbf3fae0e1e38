"""The model cards of agents/trained hold the numbers of docs/results.json, in a form that the hub can read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from agents.policies.network import SHIPPED
from scripts.cards import card

RECORD = json.loads((Path(__file__).parents[2] / "docs" / "results.json").read_text())
FOLDERS = sorted(path for path in SHIPPED.iterdir() if path.is_dir())


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_card_holds_what_was_measured(folder: Path) -> None:
    yaml: Any = pytest.importorskip("yaml")
    page = (folder / "README.md").read_text()
    assert page == card(folder, RECORD), "python scripts/cards.py"
    head = yaml.safe_load(page.split("---\n")[1])
    assert head["library_name"] == "jackbox"
    assert folder.name.split("-")[0] in head["tags"]
    task, policy = folder.name.replace("value", "planner").split("-")
    rows = [row for row in RECORD["rows"] if (row["task"], row["policy"]) == (task, policy)]
    (model,) = head["model-index"]
    values = [result["metrics"][0]["value"] for result in model["results"]]
    assert values == [round(row["mean"], 1) for row in rows]
    assert len(values) == 2  # exact and pymunk
    for row in rows:
        assert f"{row['mean']:.1f} ± {row['mean'] - row['interval_95'][0]:.1f} | {row['episodes']} |" in page
