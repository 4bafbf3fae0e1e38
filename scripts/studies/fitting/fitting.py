"""Write docs/fitting.md: how often the intervals of fits contain the truth, and what fits cost.

300 synthetic recordings are fitted. Then come small labs, some with a wrong value of a field that is not fitted, and
the recordings of a camera.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from typing import Any

from scipy import stats

from scripts.studies import study
from scripts.studies.fitting import camera
from scripts.studies.fitting.measured import LABS, MEASURED, fitted
from scripts.studies.fitting.people import WRONG, WRONGS, fitted_by_people
from scripts.studies.pages import table

HEADS = "fits", "converged", "95 % intervals that contain the truth", "time of a fit", "error"
STARTS = "start", "fits", "converged", HEADS[2], "farthest [standard deviations]", "time for 4 s"
# Whether the start is the true one, what is wrong, and how many files.
PEOPLE = (False, "", 300), (True, "", 100), *((False, wrong, 60) for wrong in WRONGS)
LENGTHS = "recording", "processor time", "memory", "width of the mass's interval", "converged and right", "left out"


def trials(arguments: study.Arguments) -> study.Trials:
    """All fits of the page, each a trial; the files at a rate are one."""
    kinds = {"": 300} | {lab: 60 if wrong else 100 for lab, wrong in LABS.items()}
    fits: study.Trials = [
        {"part": "fits", "lab": lab, "seed": seed} for lab, count in kinds.items() for seed in range(count)
    ]
    files = [{"part": "files", "rate": rate, "count": 20} for rate in (60.0, 30.0)]
    people: study.Trials = [
        {"part": "people", "seed": seed, "verdict": True, "true_start": true_start, "wrong": wrong}
        for true_start, wrong, count in PEOPLE
        for seed in range(count)
    ]
    lengths = [{"part": "lengths", "seconds": seconds} for seconds in (4.0, 40.0, 400.0)]
    return [*fits, *files, *people, *lengths, {"part": "printed"}]


def spread(rows: Iterable[dict[str, Any]]) -> list[str]:
    """Fits, those that converged, how many intervals contain the truth (and the 95 % interval of that share), seconds,
    median error.
    """
    rows = list(rows)
    good = [row for row in rows if row["converged"]]
    fields = [of for row in good for of in row["fields"].values() if of["identified"]]
    right = sum(of["contains"] for of in fields)
    share, error = "", ""
    if fields:
        low, high = stats.binomtest(right, len(fields)).proportion_ci()
        share = f"{right / len(fields):.1%} ({low:.1%} to {high:.1%})"
        error = f"{statistics.median(of['error'] for of in fields):.1e}"
    seconds = f"{statistics.median(row['seconds'] for row in rows):.1f} s" if rows else ""
    return [str(len(rows)), f"{len(good) / max(1, len(rows)):.0%}", share, seconds, error]


def random_table(rows: list[dict[str, Any]]) -> str:
    """The page's table of random scenes, by what was observed."""
    rows = [row for row in rows if not row["lab"]]
    lines = [[kind, *spread(row for row in rows if row["observed"] == kind)] for kind in MEASURED]
    return table(("observed", *HEADS), [*lines, ["**all**", *spread(rows)]])


def labs_table(rows: list[dict[str, Any]]) -> str:
    """The page's table of labs."""
    lines = [[lab, *spread(row for row in rows if row["lab"] == lab)] for lab in LABS]
    return table(("in the fit", *HEADS), lines)


def people_table(rows: list[dict[str, Any] | None]) -> str:
    """The page's table of recordings as people make them; intervals are counted by file."""
    lines = []
    for true_start, wrong, _ in PEOPLE:
        fits = [row for row in rows if row and (row["true_start"], row["wrong"]) == (true_start, wrong)]
        good = [row for row in fits if row["converged"]]
        shares = [statistics.fmean(row["contain"]) for row in good if row["contain"]]
        cells, farthest = ["", ""], [abs(of) for row in good for of in row["deviations"].values()]
        if shares and not wrong:
            low, high = stats.binomtest(round(sum(shares)), len(shares)).proportion_ci()
            cells = [f"{statistics.fmean(shares):.1%} ({low:.1%} to {high:.1%})", f"{max(farthest):.1f}"]
        seconds = statistics.median(row["seconds"] / row["length"] for row in fits) if fits else 0.0
        start = wrong or ("the true one" if true_start else "far away")
        shown = [f"{start} {WRONG[wrong]:g}" if wrong in WRONG else start, str(len(fits)), str(len(good))]
        lines.append([*shown, *cells, f"{4.0 * seconds:.1f} s"])
    return table(STARTS, lines)


def lengths_table(rows: list[dict[str, Any]]) -> str:
    """The page's table of long recordings."""
    lines = []
    for row in rows:
        good = "yes" if row["converged"] and row["contains"] else "no"
        cells = f"{row['seconds']:.1f} s", f"{row['mib']:.0f} MiB", f"{row['width']:.1g} kg", good
        steps = f"{row['left_out']:g} of {60.0 * row['length']:g} steps"
        lines.append([f"{row['length']:g} s", *cells, steps])
    return table(LENGTHS, lines)


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/fitting.md."""
    files = [f"{of['right']} of {of['count']} at {of['rate']:g} frames a second" for of in record["files"]]
    passed = [row for row in record["people"] if row and row["wrong"] in WRONG and row["converged"]]
    return {
        "printed": record["printed"],
        "columns": camera.COLUMNS.replace(",x_jack", ",\\\nx_jack"),  # a line of the site has 100 characters
        "lengths": lengths_table(record["lengths"]),
        "files": " and ".join(files),
        "people": people_table(record["people"]),
        "passed": len(passed),
        "hidden": sum(row["hidden"] for row in passed),
        "fits": random_table(record["fits"]),
        "labs": labs_table(record["fits"]),
    }


STUDY = study.Study(
    "fitting",
    {
        "fits": fitted,
        "files": camera.fitted_files,
        "people": fitted_by_people,
        "lengths": camera.fitted_alone,
        "printed": camera.printed,
    },
    filled,
    trials=trials,
    single=frozenset({"printed"}),
    alone=frozenset({"lengths"}),
    packages=("jackbox", "numpy", "scipy", "numba"),
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
