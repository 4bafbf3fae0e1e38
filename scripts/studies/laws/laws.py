"""The laws that every simulation must obey, measured on one case. Property tests and ``soak.py`` share them.

containment  no foot outside: ``exact`` by 1e-9 m or 4 units in the last place, ``pymunk`` by min(1 m, L) [m]
momentum     total momentum = that at the start + impulse of the side forces - m_j g t [N s]
centre       the common centre of mass goes where that momentum takes it [m]
energy       gained in steps of held torque without side forces = torque times the box's turn; with losses, no more [J]
record       impacts are in time order and within their step, at existing walls and feet, with impulse > 0; violations
restore      a new or used simulator, reset to (state, time), continues bit for bit; numbers that differ
batch        the vector environment equals the single one bit for bit, across restarts; numbers that differ
scenes       so do environments in a batch with a scene each, where a case has neighbours; numbers that differ
refusal      only documented errors are raised; a refused step leaves the simulator as it was; violations
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jackbox_env.env import JackInBoxEnv
from jackbox_env.mechanics import energy_of
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators import Simulator, make_simulator
from jackbox_env.simulators.flight import reach
from jackbox_env.states import Array, clearance, deepest_held, start_tolerance
from jackbox_env.vector_env import JackInBoxVectorEnv
from scripts.studies.laws.random_cases import Case, Wave

LAWS = ("containment", "momentum", "centre", "energy", "record", "restore", "batch", "scenes", "refusal")
ROUNDING = 1e-11  # of the largest number in a balance, over a case
SIDE_BY_SIDE = 3  # environments of the batch law
KEPT = 10  # broken cases printed in full, and kinds of refusals counted

# What a contact model may say where it can not follow, and to a scene that it can not solve.
_CAN_NOT_FOLLOW = ("would leave the box", "moves too fast to be followed", "needs more than 1,000,000 gap evaluations")
_CAN_NOT_SOLVE = "couple the feet so strongly"


@dataclass(frozen=True)
class Worst:
    """The largest deviation from a law."""

    value: float
    limit: float
    step: int
    words: str = ""

    @property
    def share(self) -> float:
        """The value over its limit; above 1 the law is broken."""
        if math.isnan(self.value):
            return math.inf
        return self.value / self.limit if self.limit > 0.0 else math.inf if self.value > 0.0 else 0.0

    def __str__(self) -> str:
        return f"{self.value:.3g}, at most {self.limit:.3g}, by step {self.step} {self.words}".rstrip()


@dataclass
class Examination:
    """What was found in one case."""

    worst: dict[str, Worst] = field(default_factory=dict)
    steps: int = 0
    impacts: int = 0
    held: int = 0  # steps at whose end a wall held a foot; told of ``exact`` only
    refused: str = ""  # why the case ended early, or never began

    def measure(self, law: str, value: float, limit: float, words: str = "") -> None:
        """Keep ``value`` if it is the law's worst so far."""
        found = Worst(value, limit, self.steps, words)
        if law not in self.worst or found.share > self.worst[law].share:
            self.worst[law] = found

    @property
    def broken(self) -> list[str]:
        """The laws that do not hold."""
        return [law for law, worst in self.worst.items() if worst.share > 1.0]

    def __str__(self) -> str:
        return "; ".join(f"{law}: {self.worst[law]}" for law in self.broken) or "all laws hold"


@dataclass
class Tally:
    """Summary of all cases of one contact model. Its size does not grow with their number."""

    cases: int = 0
    impacts: int = 0
    resting: int = 0  # cases in which a foot came to rest
    held: int = 0  # steps, see Examination
    broken: int = 0
    refused: Counter[str] = field(default_factory=Counter)  # cases that ended early
    worst: dict[str, tuple[Worst, int]] = field(default_factory=dict)  # by law, with the case's number

    def enter(self, number: int, found: Examination) -> None:
        """Add what was found in a case."""
        self.cases += 1
        self.impacts += found.impacts
        self.resting += found.held > 0
        self.held += found.held
        self.broken += bool(found.broken)
        if found.refused:
            begun = re.split(r"\d", found.refused)[0][:80]
            self.refused[begun if begun in self.refused or len(self.refused) < KEPT else "other refusals"] += 1
        for law, worst in found.worst.items():
            if law not in self.worst or worst.share > self.worst[law][0].share:
                self.worst[law] = worst, number

    def __str__(self) -> str:
        rest = f", rest in {self.resting:,} cases, for {self.held:,} steps" if self.held else ""
        lines = [f"{self.cases:,} cases, {self.impacts:,} impacts{rest}"]
        lines += [f"{law:12s} worst {worst} of case {number}" for law, (worst, number) in self.worst.items()]
        lines += [f"{law:12s} nothing to measure" for law in LAWS if law not in self.worst]
        lines += [f"ended early, {count:,}: {sentence}" for sentence, count in self.refused.items()]
        return "\n  ".join([*lines, f"cases that broke a law: {self.broken:,}"])


def examine(case: Case) -> Examination:
    """Simulate a case and measure every law on it."""
    found = Examination()
    try:
        _examine_simulator(case, found)
        if not found.refused:
            _examine_batch(case, "batch", [case.scene] * SIDE_BY_SIDE, [True, True, False], found)
        if case.neighbours and not found.refused:
            alone = [False] * len(case.neighbours)
            _examine_batch(case, "scenes", [case.scene, *case.neighbours], [True, *alone], found)
    except Exception as error:
        found.measure("refusal", 1.0, 0.0, f"{type(error).__name__}: {error}"[:300])
    return found


def _make(case: Case) -> Simulator:
    return make_simulator(case.scene, contact=case.contact, substeps=case.substeps)


def _examine_simulator(case: Case, found: Examination) -> None:
    try:
        run = _make(case)
    except ValueError as error:
        if case.contact != "pymunk" or _CAN_NOT_SOLVE not in str(error):
            raise
        found.refused = str(error)
        return
    run.reset(case.state, case.time)
    books, elsewhere = Books(case), _make(case)
    fresh: Simulator | None = None
    for number, torque in enumerate(case.torques):
        found.steps = number
        before = run.state
        if number == case.restored_at:
            fresh = _make(case)
            fresh.reset(before, run.time)
        elsewhere.reset(before, run.time)
        if not _stepped(run, case.control_dt, torque, found):
            return
        _restored(run, [elsewhere, fresh], case.control_dt, torque, found)
        _contained(case, run, found)
        _recorded(case, run, found)
        books.enter(before, run, torque, found)
        found.impacts += len(run.impacts)
        found.held += case.contact == "exact" and _holds(run)
    found.steps = len(case.actions)


def _stepped(run: Simulator, dt: float, torque: float | None, found: Examination) -> bool:
    before, time = run.state, run.time
    try:
        run.step(dt, torque)
    except RuntimeError as error:
        if not any(words in str(error) for words in _CAN_NOT_FOLLOW):
            raise
        found.measure("refusal", float(np.sum(run.state != before) + (run.time != time)), 0.0, "moved by a refusal")
        found.refused = str(error)
        return False
    return True


def _restored(
    run: Simulator, twins: list[Simulator | None], dt: float, torque: float | None, found: Examination
) -> None:
    for twin in twins:
        if twin is not None:
            twin.step(dt, torque)
            apart = float(np.sum(twin.state != run.state))
            apart += (twin.time != run.time) + (twin.torque != run.torque) + (twin.impacts != run.impacts)
            found.measure("restore", apart, 0.0)


def _contained(case: Case, run: Simulator, found: Examination) -> None:
    state = run.state.tolist()
    allowed = start_tolerance(state) if case.contact == "exact" else deepest_held(case.scene)
    found.measure("containment", float(np.maximum(0.0, -clearance(case.scene, state))), allowed)  # NaN stays NaN


def _recorded(case: Case, run: Simulator, found: Examination) -> None:
    """Times are added up from the step's start, with one rounding more than the step's end."""
    impacts, slack = run.impacts, 4.0 * math.ulp(abs(run.time) + case.control_dt)
    times = [run.time - case.control_dt - slack, *(impact.time for impact in impacts), run.time + slack]
    wrong = sum(later < earlier for earlier, later in itertools.pairwise(times))
    wrong += sum(not (0 <= hit.wall < 4 and 0 <= hit.foot < 4 and 0.0 < hit.impulse < math.inf) for hit in impacts)
    found.measure("record", float(wrong), 0.0)


def _holds(run: Simulator) -> bool:
    """Whether a wall held a foot at the end of the last step of ``exact``, which enters that as an impact there."""
    return any(hit.time >= run.time - 4.0 * math.ulp(abs(run.time)) for hit in run.impacts)


class Books:
    """The balances of momentum, centre of mass and energy since the start."""

    def __init__(self, case: Case) -> None:
        scene, start = case.scene, np.array(case.state)
        self._case, self._masses = case, np.array([scene.box_mass, scene.jack_mass])
        self._momentum, self._centre = self._totals(start)
        self._largest_momentum, self._largest_place = np.zeros(2), 0.0
        self._gained = self._largest_energy = 0.0
        drive = scene.drive
        forces = (drive.force_x, drive.force_y) if isinstance(drive, Drive) else (None, None)
        self._forces: tuple[Wave | None, ...] = tuple(force if isinstance(force, Wave) else None for force in forces)
        self._idle = drive is None or (isinstance(drive, Drive) and drive.torque is None)
        self._pushed = any(self._forces)

    def _totals(self, state: Array) -> tuple[Array, Array]:
        """Total momentum [N s] and centre of mass [m], shape (2,) each."""
        places, rates = state[[0, 1, 3, 4]].reshape(2, 2), state[[6, 7, 9, 10]].reshape(2, 2)
        return self._masses @ rates, self._masses @ places / self._masses.sum()

    def enter(self, before: Array, run: Simulator, torque: float | None, found: Examination) -> None:
        """Measure the balances after a step."""
        state = run.state
        # What walls give and take in a step rounds too, also where a wedged jack hardly moves.
        exchanged = sum(hit.impulse for hit in run.impacts)
        self._enter_momentum(state, run.time - self._case.time, exchanged, found)
        if torque is None and self._idle:
            torque = 0.0
        lossy = self._case.scene.restitution < 1.0 and self._case.contact == "pymunk"
        wedged = lossy and _opposite_walls_at_once(run)
        if torque is not None and not self._pushed and not wedged:
            self._enter_energy(before, run, torque, found)

    def _enter_momentum(self, state: Array, since: float, exchanged: float, found: Examination) -> None:
        weight = self._case.scene.jack_mass * self._case.scene.gravity
        impulse, moment = np.array([0.0, -weight * since]), np.array([0.0, -0.5 * weight * since**2])
        for axis, force in enumerate(self._forces):
            if force is not None:
                once, twice = force.integrals(self._case.time, since)
                impulse[axis] += once
                moment[axis] += twice
        momentum, centre = self._totals(state)
        total = self._masses.sum()
        path = (self._momentum * since + moment) / total
        sizes = self._masses @ np.abs(state[[6, 7, 9, 10]]).reshape(2, 2) + np.abs(impulse) + np.abs(self._momentum)
        self._largest_momentum = np.maximum(self._largest_momentum, sizes + exchanged)
        reach = np.abs(state[[0, 1, 3, 4]]).max() + np.abs(path).max() + self._largest_momentum.max() / total * since
        self._largest_place = max(self._largest_place, float(reach))
        off = float(np.abs(momentum - self._momentum - impulse).max())
        found.measure("momentum", off, ROUNDING * float(self._largest_momentum.max()))
        found.measure("centre", float(np.abs(centre - self._centre - path).max()), ROUNDING * self._largest_place)

    def _enter_energy(self, before: Array, run: Simulator, torque: float, found: Examination) -> None:
        scene, state = self._case.scene, run.state
        turns = before[2], state[2]
        gained = _energy(scene, state) - _energy(scene, before) - torque * (turns[1] - turns[0])
        size = _energy(scene, np.abs(state)) + _energy(scene, np.abs(before)) + abs(torque) * max(map(abs, turns))
        self._largest_energy = max(self._largest_energy, size)
        limit = ROUNDING * self._largest_energy
        if scene.restitution < 1.0:
            granted = self._granted(before, run) if self._case.contact == "pymunk" else 0.0
            found.measure("energy", float(np.maximum(0.0, gained)), limit + granted)
            return
        self._gained += gained
        found.measure("energy", abs(self._gained), limit)

    def _granted(self, before: Array, run: Simulator) -> float:
        """Energy that ``pymunk`` may add in a step of a scene with losses [J], where feet overlap with walls.

        The engine moves them apart by at most the overlap, without changing velocities. That lifts the jack and turns
        the box against its torque. The overlap is that at the step's start plus, for each contact, the way of a foot
        in a substep. At a contact an impulse of 1 opens the gap by 1 / m_j + a^2 / J_b and turns the box by a / J_b:
        at most sqrt(m_j / J_b) / 2 of turn per gap.
        """
        scene, numbers = self._case.scene, before.tolist()
        h = self._case.control_dt / (self._case.substeps or 1)
        overlap = max(0.0, -clearance(scene, numbers))
        overlap += len(run.impacts) * reach(scene, numbers, h, abs(run.torque), 0.0)
        lever = 0.5 * math.sqrt(scene.jack_mass / scene.box_inertia)
        return (scene.jack_mass * scene.gravity + abs(run.torque) * lever) * overlap


def _opposite_walls_at_once(run: Simulator) -> bool:
    """Whether feet overlapped with opposite walls in one substep.

    Such contacts have almost no leverage on one another, and pymunk's solver stops far from rounding level. In a scene
    with losses pymunk accepts these steps (see the head of ``simulators/pymunk.py``), so the balance of energy leaves
    them out.
    """
    return any(
        one.time == other.time and one.wall + 2 == other.wall for one, other in itertools.permutations(run.impacts, 2)
    )


def _energy(scene: Scene, state: Array) -> float:
    return float(energy_of(scene, state.tolist()))


# -- the batch ---------------------------------------------------------------------------------------------------------


def _examine_batch(case: Case, law: str, scenes: list[Scene], at_start: list[bool], found: Examination) -> None:
    """Compare a batch with single environments, a scene for each.

    Some begin ``at_start``, the case's own, the others at random starts. Every other one is under opposite actions.
    """
    found.steps, limit = 0, max(2, 2 * len(case.actions) // 3)
    together = {"max_episode_steps": limit, "with_infos": True, **case.settings, "scene": scenes}
    batch = JackInBoxVectorEnv(len(scenes), **together)
    singles = [JackInBoxEnv(**{**case.settings, "scene": scene}) for scene in scenes]
    seen = [batch.reset(seed=case.seed)[0]]
    alone = [[single.reset(seed=case.seed + number)[0] for number, single in enumerate(singles)]]
    found.measure(law, _apart(seen, alone), 0.0, "reset")
    placed = np.array(at_start)
    batch.set_states(np.array(case.state), case.time, placed)
    for number in np.flatnonzero(placed):
        singles[number].set_state(case.state, case.time)
    signs = np.where(np.arange(len(scenes)) % 2, -1.0, 1.0)
    for step, action in enumerate(case.actions):
        found.steps = step
        actions = None if action is None else action * signs
        try:
            outcome = batch.step(actions)
        except RuntimeError as error:
            _refused_alike(law, singles, actions, found, error)
            return
        rows = [_alone(single, actions, number, step == limit) for number, single in enumerate(singles)]
        _compare(law, outcome, rows, found, truncated=step == limit - 1)
    found.steps = len(case.actions)


def _alone(single: JackInBoxEnv, actions: Array | None, number: int, restarts: bool) -> tuple[Any, float, Any]:
    """Observation, reward and info of one environment, which restarts in the step after its last."""
    if restarts:
        observation, info = single.reset()
        return observation, 0.0, info
    observation, reward, _, _, info = single.step(None if actions is None else float(actions[number]))
    return observation, reward, info


def _compare(law: str, outcome: Any, rows: list[tuple[Any, float, Any]], found: Examination, truncated: bool) -> None:
    observations, rewards, terminations, truncations, infos = outcome
    apart = _apart([observations, rewards], [[row[0] for row in rows], [row[1] for row in rows]])
    apart += float(np.sum(terminations) + np.sum(truncations != truncated))
    for name in rows[0][2]:
        apart += _apart([infos[name]], [[row[2][name] for row in rows]])
    found.measure(law, apart, 0.0)


def _apart(ones: list[Any], others: list[Any]) -> float:
    return float(sum(np.sum(np.asarray(one) != np.asarray(other)) for one, other in zip(ones, others, strict=True)))


def _refused_alike(
    law: str, singles: list[JackInBoxEnv], actions: Array | None, found: Examination, error: Exception
) -> None:
    """A batch raises the same error as its environment alone."""
    told = []
    for number, single in enumerate(singles):
        try:
            single.step(None if actions is None else float(actions[number]))
        except RuntimeError as own:
            told.append(str(own).replace("the jack", f"the jack of environment {number}", 1))
    same = any(str(error) in (one, one.replace(f" of environment {number}", "", 1)) for number, one in enumerate(told))
    known = any(words in str(error) for words in _CAN_NOT_FOLLOW)
    found.measure(law, 0.0 if told and known else 1.0, 0.0, f"refused, alone {told or 'not'}: {error}"[:300])
    found.refused = str(error) if same or told else found.refused
