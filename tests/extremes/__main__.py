"""Run the extremes with all the steps of their long runs, and write docs/extremes.md from what they record.

Arguments go to pytest, such as ``-k spins``: rows that were not run stay as docs/extremes.jsonl has them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.extremes.page import RECORD, missing, page, read, recorded

HERE = Path(__file__).parent
DOCS = HERE.parents[1] / "docs"


def main(arguments: list[str], docs: Path = DOCS) -> int:
    """Run, add to the record, write the page; return pytest's exit status, or 1 where a row has never been run."""
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "findings.jsonl"
        environment = {**os.environ, "JACKBOX_EXTREMES": "full", RECORD: str(record)}
        command = [sys.executable, "-m", "pytest", "-q", str(HERE), *arguments]
        status = subprocess.run(command, env=environment, check=False).returncode
        findings = read(docs / "extremes.jsonl") | read(record)
    (docs / "extremes.jsonl").write_text(recorded(findings), encoding="utf-8")
    (docs / "extremes.md").write_text(page(findings), encoding="utf-8")
    for what in missing(findings):
        print(f"never run: {what}")
    return status or int(bool(missing(findings)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
