"""Invariants of every simulation, asserted step by step on one case.

containment  no foot outside: ``exact`` by 1e-9 m or 4 units in the last place, ``pymunk`` by min(1 m, L)
record       impacts are in time order and within their step, at existing walls and feet, with impulse > 0
momentum     total momentum = that at the start + impulse of the side forces - m_j g t
centre       the common centre of mass goes where that momentum takes it
energy       gained in steps of held torque without side forces = torque times the box's turn; with losses, no more
restore      a new simulator, reset to (state, time), makes the same step bit for bit
refusal      a step is refused by JackLostError only, and leaves the simulator as it was
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from typing import cast

import numpy as np

from jackbox_env.mechanics import energy
from jackbox_env.model.states import Array, clearance, deepest_restored, start_tolerance
from jackbox_env.simulators import JackLostError, Simulator, make_simulator
from jackbox_env.simulators.flight import reach
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.invariants.cases import Case, Wave

ROUNDING = 1e-11  # of the largest number in a balance, over a case
SIMULTANEOUS = 1e-6  # of the energy, in a step of pymunk in which several feet strike at once: its solver iterates


def simulator_of(case: Case) -> Simulator | None:
    """A simulator at the case's start; None for a scene that pymunk refuses."""
    try:
        made = make_simulator(case.scene, contact=case.contact, substeps=case.substeps)
    except ValueError as error:
        if case.contact != "pymunk" or "couple the feet so strongly" not in str(error):
            raise
        return None
    made.reset(case.state, case.time)
    return made


def examine(case: Case) -> Counter[str]:
    """Simulate a case; return how many impacts it had, how many steps ended with a held foot, and if it was refused.

    Raises:
        AssertionError: an invariant does not hold; the message names it.
    """
    seen = Counter(cases=1)
    run = simulator_of(case)
    if run is None:
        return seen + Counter(refused=1)
    balance = Balance(case)
    for action in case.actions:
        torque = None if action is None else action * case.scene.torque_limit
        before, twin = run.state, make_simulator(case.scene, contact=case.contact, substeps=case.substeps)
        twin.reset(before, run.time)
        if not stepped(run, case.control_dt, torque):
            return seen + Counter(refused=1)
        assert_contained(case, run)
        _assert_recorded(case, run)
        balance.enter(before, run, torque)
        twin.step(case.control_dt, torque)
        np.testing.assert_array_equal(twin.state, run.state, "restore")
        assert (twin.time, twin.torque, twin.impacts) == (run.time, run.torque, run.impacts), "restore"
        seen["impacts"] += len(run.impacts)
        # A foot at rest on a wall at the end of a step of ``exact`` is recorded as an impact there.
        seen["held"] += any(hit.time >= run.time - 4.0 * math.ulp(abs(run.time)) for hit in run.impacts)
    return seen


def stepped(run: Simulator, dt: float, torque: float | None) -> bool:
    """Make a step; return whether it was not refused."""
    before, time = run.state, run.time
    try:
        run.step(dt, torque)
    except JackLostError:
        np.testing.assert_array_equal(run.state, before, "refusal")
        assert run.time == time, "refusal"
        return False
    return True


def assert_contained(case: Case, run: Simulator) -> None:
    """Containment, in the present state."""
    state = run.state.tolist()
    allowed = start_tolerance(state) if case.contact == "exact" else deepest_restored(case.scene)
    assert clearance(case.scene, state) >= -allowed, f"containment: {clearance(case.scene, state):.3g} m from the walls"


def _assert_recorded(case: Case, run: Simulator) -> None:
    """Times are added up from the step's start, with one rounding more than the step's end."""
    slack = 4.0 * math.ulp(abs(run.time) + case.control_dt)
    times = [run.time - case.control_dt - slack, *(impact.time for impact in run.impacts), run.time + slack]
    assert times == sorted(times), f"record: {times}"
    for hit in run.impacts:
        assert {hit.wall, hit.foot} <= {*range(4)}, f"record: {hit}"
        assert 0.0 < hit.impulse < math.inf, f"record: {hit}"


class Balance:
    """The balances of momentum, centre of mass and energy since the start."""

    def __init__(self, case: Case) -> None:
        self._case, self._masses = case, np.array([case.scene.box_mass, case.scene.jack_mass])
        self._momentum, self._centre = self._totals(np.array(case.state))
        self._largest = dict.fromkeys(("momentum", "centre", "energy"), 0.0)
        self._gained = self._granted = 0.0
        drive = case.scene.drive  # None, a chirp, or waves
        self._forces = [getattr(drive, name, None) for name in ("force_x", "force_y")]
        self._idle = getattr(drive, "torque", None) is None

    def _totals(self, state: Array) -> tuple[Array, Array]:
        """Total momentum [N s] and centre of mass [m], shape (2,) each."""
        positions, rates = state[[0, 1, 3, 4]].reshape(2, 2), state[[6, 7, 9, 10]].reshape(2, 2)
        return self._masses @ rates, self._masses @ positions / self._masses.sum()

    def _assert_small(self, name: str, off: float, size: float, granted: float = 0.0) -> None:
        """``off`` is rounding of the largest ``size`` so far, beside what is ``granted``."""
        self._largest[name] = max(self._largest[name], size)
        allowed = ROUNDING * self._largest[name] + granted
        assert off <= allowed, f"{name} is {off:.3g} off, at most {allowed:.3g} is rounding"

    def enter(self, before: Array, run: Simulator, torque: float | None) -> None:
        """Assert the balances after a step."""
        self._enter_momentum(run)
        held = 0.0 if torque is None and self._idle else torque
        lossy = self._case.scene.restitution < 1.0 and self._case.contact == "pymunk"
        if held is not None and not any(self._forces) and not (lossy and _opposite_walls_at_once(run)):
            self._enter_energy(before, run, held)

    def _enter_momentum(self, run: Simulator) -> None:
        state, since = run.state, run.time - self._case.time
        weight = self._case.scene.jack_mass * self._case.scene.gravity
        impulse, moment = np.array([0.0, -weight * since]), np.array([0.0, -0.5 * weight * since**2])
        for axis, force in enumerate(self._forces):
            if isinstance(force, Wave):
                once, twice = force.integrals(self._case.time, since)
                impulse[axis] += once
                moment[axis] += twice
        momentum, centre = self._totals(state)
        path = (self._momentum * since + moment) / self._masses.sum()
        # What walls give and take in a step rounds too, also where a wedged jack hardly moves.
        size = self._masses @ np.abs(state[[6, 7, 9, 10]]).reshape(2, 2) + np.abs(impulse) + np.abs(self._momentum)
        exchanged = sum(hit.impulse for hit in run.impacts)
        self._assert_small("momentum", float(np.abs(momentum - self._momentum - impulse).max()), size.max() + exchanged)
        way = self._largest["momentum"] / self._masses.sum() * since
        length = np.abs(state[[0, 1, 3, 4]]).max() + np.abs(path).max() + way
        self._assert_small("centre", float(np.abs(centre - self._centre - path).max()), length)

    def _enter_energy(self, before: Array, run: Simulator, torque: float) -> None:
        scene, state = self._case.scene, run.state
        gained = energy(scene, state) - energy(scene, before) - torque * (state[2] - before[2])
        size = (
            energy(scene, np.abs(state))
            + energy(scene, np.abs(before))
            + abs(torque) * np.abs([state[2], before[2]]).max()
        )
        times = [impact.time for impact in run.impacts]
        several = self._case.contact == "pymunk" and len({*times}) < len(times)
        slack = SIMULTANEOUS * size if several else 0.0
        if scene.elastic:
            self._gained, self._granted = self._gained + gained, self._granted + slack
            self._assert_small("energy", abs(self._gained), size, self._granted)
        else:
            self._assert_small("energy", gained, size, slack + _granted(self._case, before, run))


def _granted(case: Case, before: Array, run: Simulator) -> float:
    """Energy that ``pymunk`` may add in a step of a scene with losses [J], where feet overlap with walls.

    The engine moves them apart by at most the overlap, without changing velocities. That lifts the jack and turns
    the box against its torque. The overlap is that at the step's start plus, for each contact, the way of a foot
    in a substep. At a contact an impulse of 1 opens the gap by 1 / m_j + a^2 / J_b and turns the box by a / J_b:
    at most sqrt(m_j / J_b) / 2 of turn per gap.
    """
    if case.contact != "pymunk":
        return 0.0
    scene, numbers = case.scene, before.tolist()
    h = case.control_dt / (case.substeps or 1)
    overlap = max(0.0, -clearance(scene, numbers))
    # The engine moves feet out of walls that they leave by themselves too: a contact without an impulse is no impact.
    contacts = max(len(run.impacts), int(cast(PymunkSimulator, run)._recorder.last_contact >= 0))
    overlap += contacts * reach(scene, numbers, h, abs(run.torque), 0.0)
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
