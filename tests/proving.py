"""Prove what the exact model computes, step by step: ``make prove`` writes the table into docs/trust.md.

Each step starts at a float64 state. ``proof.prove`` encloses its impacts and its last state, and float64's are compared
with these. ``--quick`` does a twentieth, and only prints. One seed gives one table.

A step is refuted if float64 has other impacts, another order, a first impact whose foot is farther than twice
``CLOSE`` from its wall at that time, or a last state too far off. Balls of radius r at a precision of ``bits`` would
have about r 2^(bits - 52) at float64's precision; more than ``FAR`` times that is too far. Counted instead are grazes,
where a foot bounces that only comes nearer than ``CLOSE``, and ties, where a second foot is nearer than twice ``CLOSE``
at the first impact.
"""

from __future__ import annotations

import argparse
import math
import random
import statistics
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from flint import arb

from agents.evaluation.episodes import record_episode
from agents.policies.network import TRAINED
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from jackbox_env.mechanics import gap_jacobian, gaps
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators import Impact, JackLostError, make_simulator
from jackbox_env.tools.files import write_text
from scripts.studies.pages import fill, table
from tests.invariants.cases import draw_case
from tests.proof import EVERY_PAIR, FreeFlight, Proof, Turn, prove
from tests.proof import Impact as ProvenImpact
from tests.states import inside, several_contacts, started

PAGE = Path(__file__).parents[1] / "docs" / "trust.md"
EPS = sys.float_info.epsilon
CLOSE = 1e-13  # [m] the model's contact tolerance
FAR = 50.0
DT = 0.02  # [s]


class Case(NamedTuple):
    """A motion to prove."""

    scene: Scene
    state: Array  # (12,)
    time: float  # [s]
    dt: float  # [s]
    torques: list[float | None]  # one for each step [N m]; None: the drive


# -- regimes -----------------------------------------------------------------------------------------------------------


def played(scene: Scene, state: Array, time: float, dt: float, torques: list[float | None]) -> Iterator[Case]:
    """Each step of a float64 trajectory."""
    run = started(make_simulator(scene, contact="exact"), state, time)
    for torque in torques:
        yield Case(scene, run.state, run.time, dt, [torque])
        try:
            run.step(dt, torque)
        except JackLostError:
            return


def random_torques(rng: np.random.Generator) -> Iterator[Case]:
    """Default play under uniform torques."""
    scene = Scene()
    while True:
        torques = (scene.torque_limit * rng.uniform(-1.0, 1.0, 500)).tolist()
        yield from played(scene, sample_start(scene, rng), 0.0, DT, torques)


def chirped(rng: np.random.Generator) -> Iterator[Case]:
    """Default play under the chirp."""
    while True:
        yield from played(Scene(), sample_start(Scene(), rng), 0.0, DT, [None] * 500)


def trained(rng: np.random.Generator) -> Iterator[Case]:
    """Play of the trained networks on all tasks in turn."""
    while True:
        for task in TRAINED:
            settings = EnvSettings(task=task)
            seed = int(rng.integers(2**31))
            motion, _ = record_episode(find_policy("ppo", settings), settings.env_settings, seed)
            for state, time, torque in zip(motion.states[:-1], motion.t[:-1], motion.mean_torques, strict=True):
                yield Case(motion.scene, state, float(time), DT, [float(torque)])


def hostile(rng: np.random.Generator) -> Iterator[Case]:
    """Mass ratios from 1:100 to 100:1, boxes that turn by up to 100 rad/s, jacks of any size that fits."""
    while True:
        half, mass, ratio = (
            10.0 ** rng.uniform(-1.0, 1.0),
            10.0 ** rng.uniform(-1.0, 1.0),
            10.0 ** rng.uniform(-2.0, 2.0),
        )
        arm = half * (rng.uniform(0.05, 1.0) if rng.uniform() < 0.8 else rng.uniform(1.0, 1.4))
        gravity = rng.choice([9.81, 0.0, 1.62, 30.0])
        scene = Scene(
            box_half_width=half, box_mass=mass * ratio, jack_mass=mass, jack_arm=arm, gravity=gravity, drive=None
        )
        state = sample_start(scene, rng)
        state[6:] = rng.standard_normal(6) * scene.speed_scale * rng.uniform() * (0.2, 0.2, 0.0, 1.0, 1.0, 1.0 / half)
        state[8] = rng.choice([1.0, 10.0, 100.0]) * rng.uniform(-1.0, 1.0)
        limit = scene.box_inertia * 10.0 ** rng.uniform(-1.0, 1.5)
        yield from played(scene, state, 0.0, DT, (limit * rng.uniform(-1.0, 1.0, 20)).tolist())


def random_cases(rng: np.random.Generator, elastic: bool = True) -> Iterator[Case]:
    """The random cases of ``tests/invariants``, drives of functions left out."""
    draw = random.Random(int(rng.integers(2**31)))
    while True:
        case = draw_case(draw, "exact")
        scene = case.scene
        if not isinstance(scene.drive, Drive) and scene.elastic == elastic and scene.restitution > 0.0:
            torques = [None if action is None else action * scene.torque_limit for action in case.actions]
            yield from played(scene, np.array(case.state), case.time, case.control_dt, torques)


def random_losses(rng: np.random.Generator) -> Iterator[Case]:
    """The random cases with the restitution that they drew, unless it is 0."""
    return random_cases(rng, elastic=False)


def back(state: Array, scene: Scene, alpha: float, time: float) -> Array:
    """The state ``time`` [s] before a state, without impacts, under an acceleration of the box [rad/s^2]."""
    acceleration = np.array([0.0, 0.0, alpha, 0.0, -scene.gravity, 0.0])
    rates = state[6:] - acceleration * time
    return np.concatenate([state[:6] - (rates + 0.5 * acceleration * time) * time, rates])


def nearly_together(rng: np.random.Generator) -> Iterator[Case]:
    """Two feet that reach walls within 1e-16 to 1e-3 m of one another."""
    scene = Scene()
    while True:
        state, _ = several_contacts(scene, rng, str(rng.choice(["one wall", "two walls"])))
        state[5] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-16.0, -3.0)
        alpha, time = rng.uniform(-6.0, 6.0), rng.uniform(0.1, 0.9) * DT
        start = back(state, scene, alpha, time)
        if gaps(scene, start).min() > 0.0:
            yield Case(scene, start, 0.0, DT, [alpha * scene.box_inertia])


def grazes(rng: np.random.Generator) -> Iterator[Case]:
    """Feet that turn back 1e-16 to 1e-3 m before a wall."""
    scene = Scene()
    while True:
        state = inside(scene, rng)
        state[11] *= 3.0
        wall, foot = divmod(int(np.argmin(gaps(scene, state))), 4)
        normal = gap_jacobian(scene, state, wall, foot)[:2]
        state[3:5] += normal * (gaps(scene, state)[wall, foot] - 10.0 ** rng.uniform(-16.0, -3.0))
        state[9:11] += normal * (gap_jacobian(scene, state, wall, foot) @ state[6:])
        alpha, time = rng.uniform(-6.0, 6.0), rng.uniform(0.3, 0.7) * DT
        start = back(state, scene, alpha, time)
        lows = [gaps(scene, back(state, scene, alpha, time - since)) for since in np.linspace(0.0, DT, 21)]
        if int(np.argmin(lows)) % 16 == 4 * wall + foot and lows[0].min() > 1e-6 < lows[-1].min():
            yield Case(scene, start, 0.0, DT, [alpha * scene.box_inertia])


def whole_runs(rng: np.random.Generator) -> Iterator[Case]:
    """Runs of 10 s from exact starts: the default start under the chirp, then others under it or random torques."""
    scene = Scene()
    yield Case(scene, np.zeros(12), 0.0, DT, [None] * 500)
    while True:
        yield Case(scene, sample_start(scene, rng), 0.0, DT, [None] * 500)
        yield Case(
            scene, sample_start(scene, rng), 0.0, DT, (scene.torque_limit * rng.uniform(-1.0, 1.0, 500)).tolist()
        )


REGIMES: dict[str, tuple[Callable[[np.random.Generator], Iterator[Case]], int]] = {
    "random torques": (random_torques, 20_000),
    "chirp": (chirped, 20_000),
    "trained networks": (trained, 10_000),
    "hostile scenes": (hostile, 10_000),
    "random cases, elastic": (random_cases, 10_000),
    "random cases, with loss": (random_losses, 2_000),
    "two feet nearly together": (nearly_together, 3_000),
    "grazes": (grazes, 3_000),
    "whole runs of 10 s": (whole_runs, 21),
}


# -- comparison --------------------------------------------------------------------------------------------------------


class Computed(NamedTuple):
    """Impacts and last state in float64."""

    impacts: list[Impact]
    state: Array  # (12,) at the end


def simulated(case: Case) -> Computed:
    """A case by the exact model."""
    run, impacts = started(make_simulator(case.scene, contact="exact"), case.state, case.time), list[Impact]()
    for torque in case.torques:
        run.step(case.dt, torque)
        impacts += run.impacts
    return Computed(impacts, run.state)


class Distance(NamedTuple):
    """How far float64 is from the enclosures."""

    time: float  # of the first impact [units of rounding]
    position: float  # of its foot from where the wall is at that time [m]
    refuted: str  # the reason, or empty


def distance(case: Case, proof: Proof, computed: Computed) -> Distance:
    """Compare float64 with a proof; a unit of rounding of a number x is eps max(1, |x|)."""
    time = position = 0.0
    if not proof.decided:
        return Distance(time, position, proof.why)
    whole = len(case.torques) > 1
    few = 5 if whole else None  # chaos multiplies float64's errors with every impact
    struck, true = pairs(computed.impacts)[:few], pairs(proof.impacts)[:few]
    if struck != true:
        return Distance(time, position, f"impacts {struck} where {true} are proven")
    if struck:
        hit, first = computed.impacts[0], proof.impacts[0]
        unit, off = EPS * max(1.0, abs(hit.time)), abs(float(hit.time - first.time))
        time, position = off / unit, abs(float(first.rate)) * max(0.0, off - unit)
        if not position <= 2.0 * CLOSE * max(1.0, case.scene.box_half_width):
            return Distance(time, position, f"a first impact {off:.3g} s off")
    if not whole:
        ends = list(zip(proof.states[-1], computed.state.tolist(), strict=True))
        state = max(abs(float(ball - number)) / (EPS * max(1.0, abs(number))) for ball, number in ends)
        rounded = float(max(ball.rad() for ball, _ in ends) * arb(2) ** proof.bits)
        chirp = case.scene.drive if None in case.torques else None
        late = abs(case.time) * chirp.torque_bound / case.scene.box_inertia if chirp else 0.0
        growth = max(1.0, rounded, late)  # the last: a chirp's time is rounded too
        if not state <= FAR * growth:
            return Distance(time, position, f"a last state {state:.3g} units of rounding off")
    return Distance(time, position, "")


def change(proof: Proof, computed: Computed) -> float:
    """The largest difference of velocities at the end [m/s, rad/s]."""
    rates = zip(proof.states[-1][6:], computed.state.tolist()[6:], strict=True)
    return max(abs(float(ball - number)) for ball, number in rates)


def gaps_at(case: Case, time: float) -> dict[tuple[int, int], arb]:
    """The enclosed gaps at a time of a case's only step [s]."""
    there = proof_of(case._replace(dt=time - case.time)).states[-1]
    still = Turn(lambda s: (arb(0), arb(0)), lambda s: arb(0))
    return {pair: form.gap for pair, form in FreeFlight(case.scene, there, still).forms(arb(0), EVERY_PAIR).items()}


def is_tie(case: Case, proof: Proof) -> bool:
    """Whether a second foot is within 2 ``CLOSE`` of a wall at the first proven impact."""
    near = [gap for hit in proof.impacts[:1] for gap in gaps_at(case, float(hit.time)).values() if gap < 2.0 * CLOSE]
    return len(near) > 1


def grazed(case: Case, proof: Proof, computed: Computed) -> float:
    """The gap of the one foot that bounces without a proven impact [m]; infinite if the impacts differ otherwise."""
    struck, true = pairs(computed.impacts), pairs(proof.impacts)
    extra = next((n for n, pair in enumerate(struck) if true[n : n + 1] != [pair]), None)
    if extra is None or struck[:extra] + struck[extra + 1 :] != true:
        return math.inf
    gap = gaps_at(case, computed.impacts[extra].time)[struck[extra]]
    return float(gap) if gap > 0 else math.inf


@dataclass
class Tally:
    """The counts of a regime."""

    steps: int = 0
    impacts: int = 0
    proven: int = 0
    more_bits: int = 0  # motions that took more than 128
    undecided: Counter[str] = field(default_factory=Counter)
    refuted: list[str] = field(default_factory=list)
    grazes: list[tuple[float, float]] = field(default_factory=list)  # gap [m], change of velocities [m/s, rad/s]
    ties: list[float] = field(default_factory=list)  # change of velocities
    distances: list[Distance] = field(default_factory=list)

    def enter(self, case: Case, computed: Computed) -> None:
        """Prove a case and compare float64 with it."""
        proof = proof_of(case)
        self.steps += len(case.torques)
        if not proof.decided:
            self.undecided[proof.why] += len(case.torques)
            return
        self.proven += len(case.torques)
        self.impacts += len(proof.impacts)
        self.more_bits += proof.bits > 128
        apart = distance(case, proof, computed)
        if not apart.refuted:
            self.distances.append(apart)
        elif is_tie(case, proof):
            self.ties.append(change(proof, computed))
        elif (gap := grazed(case, proof, computed)) < CLOSE:
            self.grazes.append((gap, change(proof, computed)))
        else:
            self.refuted.append(f"{apart.refuted}: {case}")


def proof_of(case: Case) -> Proof:
    """Prove a case, with the model's tolerance for simultaneous contacts."""
    together = CLOSE * min(1.0, case.scene.box_half_width)
    most_bits = 4096 if len(case.torques) > 1 else 512
    start = case.scene, case.state.tolist(), case.torques, case.dt
    return prove(*start, time=case.time, most_bits=most_bits, together=together)


def pairs(impacts: Iterable[Impact | ProvenImpact]) -> list[tuple[int, int]]:
    """Walls and feet of impacts."""
    return [(hit.wall, hit.foot) for hit in impacts]


# -- the table ---------------------------------------------------------------------------------------------------------


def tally_of(name: str, seed: int, share: int) -> Tally:
    """Prove one part in ``share`` of a regime's motions."""
    cases, count = REGIMES[name]
    tally = Tally()
    for case in islice(cases(np.random.default_rng([seed, list(REGIMES).index(name)])), -(-count // share)):
        tally.enter(case, simulated(case))
    return tally


def page(tallies: dict[str, Tally], seed: int) -> str:
    """The table, and sentences on what it leaves out."""
    heads = ("regime", "steps", "impacts", "proven", "undecided", "refuted", "first impacts")
    rows = [
        (
            name, *(f"{n:,}" for n in (tally.steps, tally.impacts, tally.proven)), f"{tally.undecided.total():,}",
            f"{len(tally.refuted):,}", spread([apart.time for apart in tally.distances if apart.time]),
        )
        for name, tally in tallies.items()
    ]  # fmt: skip
    everyone = tallies.values()
    why = sum((tally.undecided for tally in everyone), Counter[str]())
    reasons = "; ".join(f"{reason} {n:,}" for reason, n in sorted(why.items())) or "none"
    more, ties = sum(tally.more_bits for tally in everyone), [tie for tally in everyone for tie in tally.ties]
    apart = [apart for tally in everyone for apart in tally.distances]
    times = [one.time for one in apart if one.time]
    grazes = [graze for tally in everyone for graze in tally.grazes]
    gap, changed = (max(part) for part in zip((0.0, 0.0), *grazes, strict=True))
    return f"""{table(heads, rows)}

Seed {seed}. Reasons for undecided steps: {reasons}. {more:,} motions needed more than 128 bits.

- At the time of a first impact its foot is at most {max(one.position for one in apart):.2g} m from its wall.
  {100.0 * sum(time > 4.0 for time in times) / len(times):.0f} % of these times are more than 4 units off.
- {len(grazes):,} feet bounce although their gap is proven positive, by at most {gap:.2g} m. Velocities then differ
  by at most {changed:.2g} m/s or rad/s.
- Steps with a tie, two feet that strike simultaneously or in another order than proven: {len(ties):,}.
  Velocities then differ by up to {max(ties, default=0.0):.2g} m/s or rad/s.
"""


def spread(values: list[float]) -> str:
    """Median and largest."""
    return f"{statistics.median(values):.2g}, {max(values):.2g}" if values else "-"


def main(words: list[str] | None = None) -> None:
    """Prove all regimes; exit with 1 if a step is refuted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of all that is drawn (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a twentieth of all, half a minute; the page stays")
    options = parser.parse_args(words)
    tallies = {name: tally_of(name, options.seed, 20 if options.quick else 1) for name in REGIMES}
    text = page(tallies, options.seed)
    print(text)
    if not options.quick:
        write_text(PAGE, fill(PAGE.read_text(), "proof", text.rstrip()))
    refuted = [f"{name}: {what}" for name, tally in tallies.items() for what in tally.refuted]
    if refuted:
        sys.exit("\n".join(["Refuted:", *refuted[:20]]))


if __name__ == "__main__":
    main()
