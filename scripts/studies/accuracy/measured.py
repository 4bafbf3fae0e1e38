"""The measurements of docs/accuracy.md: cases, settings, and the errors and costs of each setting on each case.

The errors of a setting are a trial. The costs of all are one, measured in interleaved rounds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from jackbox_env import Scene, make_simulator, rollout
from jackbox_env.measure.accuracy import Case, between, follow
from jackbox_env.model.states import OMEGA_BOX, Array
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators import Simulator
from jackbox_env.simulators.fidelity import FIDELITIES
from scripts import referee
from scripts.studies import baselines
from scripts.studies.accuracy.comparing import Reference, compare, quantities, reference_of, restarts
from scripts.studies.study import Record as Stored
from scripts.studies.timing import Timed, measure, ratios, repeat

# -- cases -------------------------------------------------------------------------------------------------------------

KINDS = ("chirp", "held", "weightless")  # of seeded cases
REFERENCE = "reference"  # the kind of the proven cases, which the referee scores
DT = 0.02  # control step [s]
STEPS = 500  # control steps of a seeded case: 10 s


def seeded(kind: str, seed: int) -> Case:
    """A case of 10 s: under the chirp, under random torques, each held for a step, or weightless without torque.

    The first two start as the environment does. A weightless jack gets random rates, of standard deviation 5 m/s and
    5 rad/s, and its box 1 rad/s: nothing else would move them.
    """
    rng = np.random.default_rng([KINDS.index(kind), seed])
    scene = Scene(gravity=0.0, drive=None) if kind == "weightless" else Scene()
    state: Array = sample_start(scene, rng)
    torques = None
    if kind == "held":
        torques = rng.uniform(-scene.torque_limit, scene.torque_limit, STEPS).tolist()
    if kind == "weightless":
        state[OMEGA_BOX:] = np.array([1.0, 5.0, 5.0, 5.0]) * rng.standard_normal(4)
    return Case(f"{kind} {seed}", scene, state, STEPS, torques, DT)


# -- settings ----------------------------------------------------------------------------------------------------------

TOGETHER = 1024
EXACT, BATCH, PYMUNK, DETECTION = "exact", f"exact, {TOGETHER:,} at once", "pymunk", "threshold detection"  # lines
THRESHOLD = f"{DETECTION}, RK4 at 0.01 s"
SUBSTEPS = (1, 2, 4, 8, 16, 32, 64, 128, 256)  # per control step of 0.02 s
ITERATIONS = (1, 2, 5, 10, 20)


class Setting(NamedTuple):
    """One point of the sweep."""

    name: str
    family: str
    substeps: int | None = None
    make: Callable[[Scene], Simulator] | None = None  # None: a batch, which differs only in cost


def named(family: str, substeps: int, iterations: int | None = None) -> str:
    """Name of a setting."""
    note = f", {iterations} iteration{'s' * (iterations > 1)}" if iterations else ""
    return f"{family}, {substeps} substep{'s' * (substeps > 1)}{note}"


def pymunk(substeps: int, iterations: int | None = None) -> Setting:
    """pymunk with these substeps, and these iterations of its solver in place of the default's 64."""
    family = f"{named(PYMUNK, substeps)}, iterations {ITERATIONS[0]} to {ITERATIONS[-1]}" if iterations else PYMUNK
    make = partial(make_simulator, contact="pymunk", substeps=substeps, iterations=iterations)
    return Setting(named(PYMUNK, substeps, iterations), family, substeps, make)


def _of_others(counts: tuple[int, ...]) -> list[Setting]:
    detection = Setting(THRESHOLD, DETECTION, 2, partial(baselines.baseline("threshold"), substeps=2))
    engines = [name for name in ("box2d", "mujoco") if name not in baselines.missing()]
    settings = [(name, n, partial(baselines.baseline(name), substeps=n)) for name in engines for n in counts]
    return [detection, *(Setting(named(name, n), name, n, make) for name, n, make in settings)]


def settings(quick: bool) -> list[Setting]:
    """All settings of the sweep, or those of the quick one."""
    exact = [Setting(EXACT, EXACT, None, partial(make_simulator, contact="exact")), Setting(BATCH, BATCH)]
    if quick:
        few = sorted({16, *(fidelity.substeps for fidelity in FIDELITIES.values() if fidelity.substeps)})
        return [*exact, *map(pymunk, few), pymunk(4, 1), *_of_others((4, 64))]
    fewer = [pymunk(substeps, iterations) for substeps in (4, 64) for iterations in ITERATIONS]
    return [*exact, *map(pymunk, SUBSTEPS), *fewer, *_of_others((1, 4, 16, 64))]


def contenders(quick: bool) -> list[Setting]:
    """The settings that play the reference's cases; when quick without other packages."""
    names = [of_fidelity(name) for name in FIDELITIES] + [THRESHOLD]
    finest = [named(name, 64) for name in ("box2d", "mujoco")] * (not quick)
    solver = baselines.baseline("solve_ivp")
    solvers = [
        Setting(f"solve_ivp, tolerance {tolerance:g}", "solve_ivp", None, partial(solver, tolerance=tolerance))
        for tolerance in (() if quick else (1e-3, 1e-10))
    ]
    return [one for one in settings(quick) if one.name in (*names, *finest)] + solvers


def of_fidelity(fidelity: str) -> str:
    """Name of the setting that a fidelity stands for."""
    setting = FIDELITIES[fidelity]
    return EXACT if setting.contact == "exact" else pymunk(setting.substeps or 4).name


DEFAULT = of_fidelity("balanced")


# -- summaries ---------------------------------------------------------------------------------------------------------

COST = "time"  # of playing proven cases [us/s]
ALL = "all seeds"
PREDICTABLE = 11  # impacts of a case that float64 can predict
SPREAD, LEAST, MEAN, TOTAL = "median and worst", "median and least", "mean with interval", "total"

Record = dict[str, Any]  # of one setting on one case


class Quantity(NamedTuple):
    """A measured quantity; page.md explains each."""

    name: str
    unit: str
    summed: str = SPREAD
    of: Callable[[Record], list[float]] | None = None  # its values in a record; None: the entry of its name

    def values(self, records: Iterable[Record]) -> list[float]:
        """Its values over some cases."""
        of = self.of or (lambda record: [float(record[self.name])])
        return [value for record in records for value in of(record)]


def over_first(count: int) -> Quantity:
    """The largest time error of the first ``count`` impacts, in the cases with as many correct ones."""
    return Quantity(
        f"first_{count}", "s", SPREAD, lambda one: [max(one["errors"][:count])] if one["prefix"] >= count else []
    )


def impact(number: int) -> Quantity:
    """The time error of the impact of this number, from 1, in the cases in which it is correct."""
    return Quantity(f"impact_{number}", "s", SPREAD, lambda one: one["errors"][number - 1 : number])


QUANTITIES = (
    Quantity("flight", "m"),
    *map(over_first, (1, 3, 5, 10)),
    Quantity("prefix", "impacts", LEAST),
    Quantity("sure", "impacts"),
    Quantity("local", "m", SPREAD, lambda one: one["local"]),
    Quantity("imbalance", "1"),
    Quantity("depth", "m"),
    Quantity("wrong", "runs", TOTAL, lambda one: [float(one["prefix"] == 0)] if one["sure"] else []),
    Quantity("escaped", "runs", TOTAL),
    *(Quantity(name, "impacts", TOTAL) for name in ("expected", "missed", "extra")),
    *(Quantity(name, unit, MEAN) for name, unit in (("rate", "1/s"), ("speed", "m/s"), ("fast", "m/s"))),
    Quantity("impulse", "N s", MEAN),
)
# Of the reference's cases, by the referee.
REFEREED = (
    *map(over_first, (1, 3, 5, 10)),
    *map(impact, range(1, PREDICTABLE + 1)),
    *(Quantity(name, "impacts", TOTAL) for name in ("known", "prefix")),
    Quantity("lacking", "impacts", SPREAD, lambda one: [min(one["known"], PREDICTABLE) - one["prefix"]]),
    Quantity("depth", "m"),
    Quantity("imbalance", "1", SPREAD, lambda one: [] if one["imbalance"] is None else [one["imbalance"]]),
    *(Quantity(name, "cases", TOTAL) for name in ("complete", "escaped")),
)


class Row(NamedTuple):
    """A quantity of a setting over the cases of a kind; a summary of another sort is NaN."""

    setting: str
    family: str
    substeps: int | None
    kind: str
    quantity: str
    unit: str
    n: int
    median: float = math.nan
    worst: float = math.nan
    mean: float = math.nan
    half_width: float = math.nan  # of the mean's 95 % interval
    total: float = math.nan


def summed_up(values: Iterable[float], summed: str = SPREAD) -> dict[str, Any]:
    """The summary of some values as fields of a row; NaN is left out."""
    known = np.array([value for value in values if not math.isnan(value)], dtype=np.float64)
    n = len(known)
    if summed == TOTAL or n == 0:
        return {"n": n} | ({"total": float(known.sum())} if summed == TOTAL else {})
    if summed == MEAN:
        half_width = stats.t.ppf(0.975, n - 1) * stats.sem(known) if n > 1 else math.inf
        return {"n": n, "mean": known.mean(), "half_width": half_width}
    return {"n": n, "median": np.median(known), "worst": known.min() if summed == LEAST else known.max()}


def summaries(records: list[Record]) -> list[dict[str, Any]]:
    """Every quantity over each kind of cases and over all seeded ones, of what there is: rows without their setting."""
    parts: dict[str, list[Record]] = {}
    for record in records:
        for kind in (record["kind"], *([ALL] if record["kind"] in KINDS else [])):
            parts.setdefault(kind, []).append(record)
    return [
        {"kind": kind, "quantity": one.name, "unit": one.unit, **summed_up(one.values(part), one.summed)}
        for kind, part in parts.items()
        for one in (REFEREED if kind == REFERENCE else QUANTITIES)
    ]


def order_of(steps: list[float], errors: list[float]) -> tuple[float, float, float]:
    """Exponent p in error ~ step^p with its 95 % interval: least squares in logarithms."""
    fit = stats.linregress(np.log(steps), np.log(errors))
    half_width = stats.t.ppf(0.975, len(steps) - 2) * fit.stderr
    return fit.slope, fit.slope - half_width, fit.slope + half_width


class Results:
    """The summary of a sweep: rows, by setting, kind and quantity."""

    def __init__(self, rows: Iterable[Row]) -> None:
        """Index the rows."""
        self.rows = {(row.setting, row.kind, row.quantity): row for row in rows}
        self.settings = [name for name, kind, quantity in self.rows if (kind, quantity) == ("", "cost")]

    def of(self, setting: str, quantity: str, kind: str | None = None) -> Row:
        """A quantity of a setting over a kind of cases; None: over all seeds.

        The exact model is the reference over the seeds, so None means the proven cases for its own errors.
        """
        if quantity.startswith("cost"):
            return self.rows[setting, "", quantity]
        setting = EXACT if setting == BATCH else setting
        default = REFERENCE if setting == EXACT and quantity.startswith("first") else ALL
        return self.rows[setting, kind or default, quantity]

    def some(self, setting: str, *quantities: str) -> list[Row]:
        """Several quantities of a setting."""
        return [self.of(setting, quantity) for quantity in quantities]

    def order(self, quantity: str) -> tuple[float, float, float]:
        """Order of convergence of pymunk's medians, with its 95 % interval."""
        rows = [row for row in self.rows.values() if (row.family, row.kind, row.quantity) == (PYMUNK, ALL, quantity)]
        return order_of([DT / (row.substeps or 1) for row in rows], [row.median for row in rows])

    @classmethod
    def of_record(cls, record: Stored) -> Results:
        """The rows of a stored record."""
        groups = [*record["costs"]["settings"], *record["errors"], *record.get("engines", [])]
        groups += record.get("engine_costs", [])
        return cls(Row(*of["setting"], **row) for of in groups for row in of["rows"])


# -- measuring ---------------------------------------------------------------------------------------------------------


def errors_of(name: str, quick: bool, cases: int) -> dict[str, Any]:
    """All errors of a setting: on the seeded cases, and on the proven ones if it plays these."""
    (setting,) = {one.name: one for one in settings(quick) + contenders(quick) if one.name == name}.values()
    records, proven = list[Record](), list(referee.reference().values())
    if setting.make and name in [one.name for one in contenders(quick)]:
        elastic_only = setting.family == "mujoco"
        played = [known for known in proven if known[0].scene.elastic or not elastic_only]
        records += [as_record(name, score_of(setting.make, known)) for known in played]
    if name in [one.name for one in settings(quick)]:
        records += [measured(setting, kind, *case) for kind in KINDS for case in _references(kind, cases)]
    return {"setting": setting[:3], "rows": summaries(records)}


def costs_of(quick: bool, cases: int, rounds: int, seconds: float) -> dict[str, Any]:
    """The costs of all settings, and the settings of the study."""
    chosen = settings(quick)
    rates = measure({setting.name: cost_of(setting, seconds) for setting in chosen}, rounds)
    groups = []
    for setting in chosen:
        values = {
            ("cost", "us/s"): [1e6 / rate for rate in rates[setting.name]],
            ("cost_over_default", "1"): ratios(rates, DEFAULT, setting.name),
        }
        rows = [{"kind": "", "quantity": name, "unit": unit, **summed_up(of)} for (name, unit), of in values.items()]
        groups.append({"setting": setting[:3], "rows": rows})
    about = {"cases": cases, "rounds": rounds, "seconds": seconds, "missing": baselines.missing()}
    return {"settings": groups, "about": about}


@cache
def _references(kind: str, count: int) -> list[tuple[Case, Reference]]:
    """Seeded cases with the exact model's motion, once for each process."""
    cases = [seeded(kind, seed) for seed in range(count)]
    return [(case, reference_of(case)) for case in cases]


def score_of(make: Callable[[Scene], Simulator], known: referee.Known) -> referee.Score:
    """The referee's score of a simulator on one proven case."""
    case, _ = known
    course = follow(make(case.scene), case, inspect=None)
    times: Array = case.dt * np.arange(len(course.states), dtype=np.float64)
    return referee.score(known, times, course.states, course.impacts)


def as_record(name: str, score: referee.Score) -> Record:
    """The score of the setting of this name on one proven case, with the names of the quantities."""
    return score._asdict() | {
        "setting": name, "kind": REFERENCE, "prefix": score.correct, "depth": score.penetration
    }  # fmt: skip


def measured(setting: Setting, kind: str, case: Case, reference: Reference) -> Record:
    """All errors of one setting on one case."""
    assert setting.make is not None
    simulator: Any = setting.make(case.scene)
    course = follow(simulator, case, getattr(simulator, "inside_last_step", between))  # baselines have this method
    again = restarts(simulator, case, reference)
    record = {"setting": setting.name, "kind": kind, "case": case.name}
    return record | quantities(course, compare(case, course, reference), again, case.dt)


def cost_of(setting: Setting, seconds: float) -> Timed:
    """Simulated seconds per second of this thread's own time, which stops while others use the processor."""
    cases = [seeded(kind, seed) for kind in KINDS for seed in range(2)]
    block = stepped(setting.make, cases) if setting.make else _together()
    timed = repeat(block, seconds, clock=time.thread_time)
    return lambda: DT * timed()


def stepped(make: Callable[[Scene], Simulator], cases: Sequence[Case]) -> Callable[[], int]:
    """A block that steps a contact model through some cases."""
    simulators = [make(case.scene) for case in cases]

    def block() -> int:
        for simulator, case in zip(simulators, cases, strict=True):
            simulator.reset(case.state)
            try:
                for number in range(case.steps):
                    simulator.step(DT, None if case.torques is None else case.torques[number])
            except RuntimeError:  # the jack left: the steps until then count
                pass
        return sum(round(simulator.time / DT) for simulator in simulators)

    return block


def _together() -> Callable[[], int]:
    """A block of the exact model under held torques in one compiled loop on one thread."""
    chosen = [seeded("held", seed) for seed in range(TOGETHER)]
    states, torques = np.array([case.state for case in chosen]), np.array([case.torques for case in chosen])

    def block() -> int:
        rollout(chosen[0].scene, states, torques, DT, num_threads=1)
        return torques.size

    return block
