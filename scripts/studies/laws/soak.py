"""Measure every law on random scenes for hours, and report within bounds; Ctrl-C, then --resume, to the same total."""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from jackbox_env import _validation as check
from scripts.common import command_line
from scripts.studies.laws.laws import CONTACT_MODELS, LAWS, Examination, examine
from scripts.studies.laws.random_cases import Case, SeededDraw, draw_case

REPORT, TEXT = "report.json", "report.txt"
SEEDS = 10**12  # cases between those of one --seed and of the next
_EVERY = 30.0  # [s] between reports
_KEPT = 10  # failing cases kept in full
_SENTENCES = 20  # different refusals that are counted apart
_WARM = 200  # cases before memory is first looked at


@dataclass(frozen=True)
class Arguments:
    """Measure every law on random scenes."""

    hours: float = 0.0
    """How long [h], added to --minutes."""
    minutes: float = 0.0
    """How long [min]."""
    cases: int | None = None
    """How many cases of each contact model, instead of a time."""
    seed: int = 0
    """Of the cases: case k of seed s has the seed s 10^12 + k."""
    contact: Literal["both", "pymunk", "exact"] = "both"
    """Contact model."""
    out: Path | None = None
    """New folder for the report; None: runs/soak-<date>-<time>."""
    resume: Path | None = None
    """Folder of an interrupted soak to go on with, by its own settings."""
    replay: int | None = None
    """Seed of one case to show and to measure once more; writes nothing."""
    progress: bool = True
    """Show a progress bar."""


@dataclass
class Report:
    """What was found so far; its size does not grow with the time."""

    seed: int
    contacts: list[str]
    seconds: float | None  # wanted [s]; None: so many cases
    cases: int | None  # wanted
    done: int = 0  # cases of each contact model
    spent: float = 0.0  # [s]
    steps: int = 0
    impacts: dict[str, int] = field(default_factory=dict)
    cases_with_impacts: dict[str, int] = field(default_factory=dict)
    refused: dict[str, int] = field(default_factory=dict)  # cases that ended early, by the sentence's beginning
    worst: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)  # by contact model and law
    broken: dict[str, int] = field(default_factory=dict)  # cases by law
    failures: int = 0
    kept: list[dict[str, Any]] = field(default_factory=list)  # the first of them, in full
    memory_at_start: float | None = None  # [MiB] of the last sitting, once warm
    memory_at_end: float | None = None  # [MiB]
    sittings: int = 0

    @property
    def finished(self) -> bool:
        """Whether the wanted total is reached."""
        if self.cases is not None:
            return self.done >= self.cases
        return self.seconds is not None and self.spent >= self.seconds

    def enter(self, contact: str, seed: int, case: Case, found: Examination) -> None:
        """Add what was found in a case."""
        self.steps += found.steps
        self.impacts[contact] = self.impacts.get(contact, 0) + found.impacts
        self.cases_with_impacts[contact] = self.cases_with_impacts.get(contact, 0) + (found.impacts > 0)
        if found.refused:
            sentence = _beginning(found.refused)
            if sentence not in self.refused and len(self.refused) >= _SENTENCES:
                sentence = "others"
            self.refused[sentence] = self.refused.get(sentence, 0) + 1
        for law, worst in found.worst.items():
            known = self.worst.setdefault(contact, {}).get(law)
            if known is None or _as_json(worst.share) > known["share"]:
                entry = {name: _as_json(value) for name, value in asdict(worst).items()}
                self.worst[contact][law] = {**entry, "share": _as_json(worst.share), "seed": seed}
        for law in found.broken:
            self.broken[law] = self.broken.get(law, 0) + 1
        if found.broken:
            self.failures += 1
            if len(self.kept) < _KEPT:
                told = {"seed": seed, "contact": contact, "found": str(found), "replay": replay_command(seed, contact)}
                self.kept.append({**told, "case": case.as_json()})

    def text(self) -> str:
        """The report for people."""
        state = "finished" if self.finished else "interrupted"
        lines = [f"{state}: {self.done:,} cases of {', '.join(self.contacts)} in {self.spent:,.0f} s, seed {self.seed}"]
        for contact in self.contacts:
            lines.append(
                f"{contact}: impacts {self.impacts.get(contact, 0):,}, in {self.cases_with_impacts.get(contact, 0):,} "
                f"cases"
            )
            for law in LAWS:
                worst = self.worst.get(contact, {}).get(law)
                told = "never measured" if law != "refusal" else "nothing raised that is not documented"
                if worst is not None:
                    told = f"worst {worst['value']:.3g}, at most {worst['limit']:.3g} (seed {worst['seed']})"
                lines.append(f"  {law:12s} {told}")
        lines += [f"ended early, {count:,}: {sentence}" for sentence, count in self.refused.items()]
        if self.memory_at_start is not None and self.memory_at_end is not None:
            lines.append(f"memory {self.memory_at_start:.0f} MiB once warm, {self.memory_at_end:.0f} MiB at the end")
        lines.append(f"cases that broke a law: {self.failures:,} {self.broken or ''}".rstrip())
        lines += [f"  {kept['replay']}\n    {kept['found']}" for kept in self.kept]
        return "\n".join(lines) + "\n"


def replay_command(seed: int, contact: str) -> str:
    """What shows a case again."""
    return f"python scripts/studies/laws/soak.py --replay {seed} --contact {contact}"


def _beginning(sentence: str) -> str:
    """What a sentence says before its numbers."""
    return "".join(itertools.takewhile(lambda letter: not letter.isdigit(), sentence)).strip()[:80]


def _as_json(value: Any) -> Any:
    """A number that JSON can hold."""
    if isinstance(value, str | int):
        return value
    number = float(value)
    return number if math.isfinite(number) else 1e308


def memory() -> float | None:
    """What this process holds of the machine's memory [MiB]; None where the system does not say."""
    status = Path("/proc/self/status")
    if not status.exists():
        return None
    (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024.0


def read_report(folder: Path) -> Report:
    """Read what an interrupted soak has left.

    Raises:
        FileNotFoundError: it is no folder of a soak.
    """
    path = folder / REPORT
    if not path.is_file():
        raise FileNotFoundError(f"{folder} is no folder of a soak: it has no {REPORT}")
    from agents.storage import read_json

    return Report(**read_json(path))


def write_report(report: Report, folder: Path) -> None:
    """Write the report for machines and for people."""
    from agents.storage import write_json, write_text

    report.memory_at_end = memory()
    write_json(folder / REPORT, asdict(report))
    write_text(folder / TEXT, report.text())


def soak(report: Report, folder: Path, progress: bool = True) -> Report:
    """Go on with a report to its total, writing it now and then and at the end, interrupted or not; return it."""
    report = dataclasses.replace(report, sittings=report.sittings + 1, memory_at_start=None)
    write_report(report, folder)
    began = written = time.monotonic()
    spent, first = report.spent, report.done
    bar = _bar(report, progress)
    try:
        while not report.finished:
            after = one_seed(report)  # replaced as one: an interruption leaves no seed half entered
            now = time.monotonic()
            after.spent = spent + now - began
            if after.done == first + _WARM:
                after.memory_at_start = memory()
            report = after
            bar.n = report.done if report.cases is not None else min(round(report.spent), round(report.seconds or 0.0))
            bar.set_postfix_str(f"{report.done:,} cases, {report.failures} failed", refresh=False)
            bar.update(0)
            if now - written > _EVERY:
                write_report(report, folder)
                written = now
    finally:
        bar.close()
        write_report(report, folder)
    return report


def _bar(report: Report, progress: bool) -> tqdm:
    by_cases = report.cases is not None
    total = report.cases if by_cases else round(report.seconds or 0.0)
    return tqdm(total=total, unit=" cases" if by_cases else " s", disable=not progress, leave=False)


def one_seed(report: Report) -> Report:
    """The report with one more case of each contact model, of the same seed."""
    seed = report.seed * SEEDS + report.done
    after = copy.deepcopy(report)
    for contact in report.contacts:
        case = draw_case(SeededDraw(seed), contact)
        after.enter(contact, seed, case, examine(case))
    after.done += 1
    return after


def replay(seed: int, contacts: list[str]) -> bool:
    """Show the case of a seed and measure it once more; return whether all laws hold."""
    hold = True
    for contact in contacts:
        case = draw_case(SeededDraw(seed), contact)
        found = examine(case)
        print(case)
        print(f"{contact}: {found}; {found.impacts} impacts in {found.steps} steps {found.refused}".rstrip())
        hold = hold and not found.broken
    return hold


def _new_report(arguments: Arguments, contacts: list[str]) -> Report:
    hours = check.real("hours", arguments.hours, at_least=0.0, at_most=1e5)
    minutes = check.real("minutes", arguments.minutes, at_least=0.0, at_most=1e7)
    seed = check.whole("seed", arguments.seed, at_least=0, at_most=10**6)
    seconds = 3600.0 * hours + 60.0 * minutes
    if arguments.cases is not None:
        check.whole("cases", arguments.cases, at_least=1, at_most=SEEDS)
    if (seconds > 0.0) == (arguments.cases is not None):
        raise ValueError("say how long by --hours and --minutes, or how many by --cases: one of the two")
    return Report(seed, contacts, seconds if arguments.cases is None else None, arguments.cases)


@command_line
def main() -> None:
    """Parse, soak or replay, say what was found."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    contacts: list[str] = list(CONTACT_MODELS) if arguments.contact == "both" else [arguments.contact]
    if arguments.replay is not None:
        seed = check.whole("replay", arguments.replay, at_least=0)
        sys.exit(0 if replay(seed, contacts) else 1)
    from agents.runs import new_folder
    from agents.storage import held, remove_partials

    if arguments.resume is not None:
        if dataclasses.replace(arguments, resume=None, progress=True) != Arguments():
            raise ValueError("--resume goes on by the settings of its folder: give no other setting beside it")
        folder = arguments.resume
        read_report(folder)  # refused before it gets a lock
    else:
        new = _new_report(arguments, contacts)
        folder = new_folder(arguments.out, "soak", lambda made: write_report(new, made))
    with held(folder):
        remove_partials(folder)
        report = read_report(folder)
        if arguments.resume is not None:
            print(f"Going on after {report.done:,} cases of each contact model")
        try:
            report = soak(report, folder, arguments.progress)
        except KeyboardInterrupt:
            print(f"\nInterrupted. Go on with: python scripts/studies/laws/soak.py --resume {folder}", file=sys.stderr)
            raise
    print(report.text(), end="")
    print(f"Report: {folder}")
    sys.exit(1 if report.failures else 0)


if __name__ == "__main__":
    main()
