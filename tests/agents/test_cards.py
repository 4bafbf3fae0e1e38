"""The model cards of agents/trained show the numbers of docs/results.json, in a form that the hub can read."""

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
def test_a_card_has_the_measured_numbers(folder: Path) -> None:
    yaml: Any = pytest.importorskip("yaml")
    page = (folder / "README.md").read_text()
    assert page == card(folder, RECORD), "python scripts/cards.py"
    (model,) = yaml.safe_load(page.split("---\n")[1])["model-index"]
    assert len(model["results"]) == 2  # exact and pymunk
