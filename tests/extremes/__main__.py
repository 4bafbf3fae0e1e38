"""Measure the extremes with all the steps of their long runs, and write their table in docs/trust.md.

``python -m tests.extremes spins``: only cases with this word; the other rows stay as docs/extremes.jsonl has them.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from jackbox_env.simulators import CONTACT_MODELS
from scripts.studies.pages import fill
from tests.extremes.cases import CASES
from tests.extremes.page import FAILS, page, read, recorded

DOCS = Path(__file__).parents[2] / "docs"
TRUST = DOCS / "trust.md"


def main(words: str) -> None:
    """Measure; after each case add to the record and write the page; exit with 1 if a row fails."""
    os.environ["JACKBOX_EXTREMES"] = "full"
    findings = read(DOCS / "extremes.jsonl")
    for case in CASES:
        for contact in CONTACT_MODELS if words in case.what else ():
            finding = findings[case.what, contact] = case.measure(contact)
            print(f"{case.what}, {contact}\n    {finding.verdict}: {finding.seen}", flush=True)
            (DOCS / "extremes.jsonl").write_text(recorded(findings))
            TRUST.write_text(fill(TRUST.read_text(), "extremes", page(findings)))
    sys.exit(any(finding.verdict == FAILS for finding in findings.values()))


main(" ".join(sys.argv[1:]))
