"""Measure the extremes with all the steps of their long runs, and write docs/extremes.md from what is found.

``python -m tests.extremes spins``: only cases with this word; the other rows stay as docs/extremes.jsonl has them.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ["JACKBOX_EXTREMES"] = "full"  # read when the cases are imported

from jackbox_env.recording.files import write_text
from jackbox_env.simulators import CONTACT_MODELS
from tests.extremes.cases import CASES
from tests.extremes.page import FAILS, Case, Finding, page, read, recorded

DOCS = Path(__file__).parents[2] / "docs"


def found(case: Case, contact: str) -> Finding:
    """What a case finds, or its error."""
    try:
        return case.measure(contact)
    except Exception as error:
        return Finding("no error", f"{type(error).__name__}: {error}"[:150], FAILS)


def main(words: str = "") -> None:
    """Measure; after each case add to the record and write the page; exit with 1 where a row fails."""
    findings = read(DOCS / "extremes.jsonl")
    for case in CASES:
        for contact in CONTACT_MODELS:
            if words in case.what:
                finding = findings[case.what, contact] = found(case, contact)
                print(f"{case.what}, {contact}\n    {finding.verdict}: {finding.seen}", flush=True)
                write_text(DOCS / "extremes.jsonl", recorded(findings))
                write_text(DOCS / "extremes.md", page(findings))
    sys.exit(any(finding.verdict == FAILS for finding in findings.values()))


if __name__ == "__main__":
    main(" ".join(sys.argv[1:]))
