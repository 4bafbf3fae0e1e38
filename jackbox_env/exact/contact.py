"""Resolve: the impact law. At which gap feet touch, how velocities jump, and the record of impacts.

``step.strike`` calls :func:`resolve`, which changes the velocities and records each impact in the log.
Law: all contacts whose gap is within the resolution obey Moreau's impact law (1988, "Unilateral contact and dry
friction in finite freedom dynamics") at the scene's restitution e,

    0 <= lambda  _|_  J qdot+ + e J qdot- >= 0,    M (qdot+ - qdot-) = J^T lambda,

also called the simultaneous Newton law. :func:`jackbox_env.mechanics.simultaneous_impact_map` computes it too; tests
compare the two. With w = J M^-1/2 and v = M^1/2 qdot it is v+ = (1 + e) P(v-) - e v-, where P(v) is the nearest point
to v in the cone w v >= 0. Contacts of a jack and a square have rank 3 at most, so ``complementarity.py`` tries all sets
of one, two and three contacts.

A foot touches within the tolerance of :class:`ContactTolerances`, and contacts within its resolution are simultaneous.
With loss the resolution grows with the impacts of a step, up to :func:`deepest`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from jackbox_env.exact.geometry import frame_of, gradient, rate_of
from jackbox_env.exact.workspace import AFTER, BEFORE, HELD_SO_FAR, JUMPS, Status, Workspace, new_workspaces
from jackbox_env.jit.compiler import called_later, inlined, is_compiled
from jackbox_env.model.complementarity import mass_scale, nearest
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import RATES, THETA_BOX, THETA_JACK, X_BOX, X_JACK, Y_BOX, Y_JACK, Array, copy_numbers

SLOW = 1e-6  # of v0: rounding hides the derivative of a slower impact
_DEEP = 2e-10  # [m] in boxes of 1 m and more: a foot that strikes from inside is less deep


@inlined
def list_touching(scene: SceneNumbers, memory: Workspace, resolution: float, wall: int, foot: int) -> int:
    """List the contacts within ``resolution`` [m], and that of ``wall`` and ``foot``; return how many there are."""
    contacts = memory.contacts
    frame = frame_of(memory.state)
    count = 0
    for k in range(4):
        for i in range(4):
            gap = gradient(scene, frame, k, i, contacts.gradients[count])
            if gap <= resolution or (k == wall and i == foot):
                contacts.pairs[count], contacts.gaps[count], contacts.impulses[count] = 4 * k + i, gap, 0.0
                count += 1
    return count


def resolve(scene: SceneNumbers, memory: Workspace, log: Array, resolution: float, wall: int, foot: int) -> Status:
    """Apply the law to every contact within ``resolution`` [m], and to that of ``wall`` and ``foot`` in any case.

    It changes the velocities in ``memory.state``, records the impacts, and returns DONE. UNCOMPILED: several contacts,
    and their law is not compiled yet.
    """
    contacts = memory.contacts
    state = memory.state
    first = memory.hits
    if log.shape[1] == JUMPS:
        copy_numbers(12, state, memory.before)
    count = list_touching(scene, memory, resolution, wall, foot)
    slow = rate_of(state, contacts.gradients[0]) > -SLOW * scene.speed_scale
    if count > 1 or slow or contacts.gaps[0] < -_DEEP * min(1.0, scene.box_half_width):
        memory.nonsmooth = 1
    if count == 1:
        contacts.impulses[0] = bounce(scene, state, contacts.gradients[0])
    elif not bounce_several(scene, memory, count):
        return Status.UNCOMPILED
    for number in range(count):
        if contacts.impulses[number] > 0.0:
            record_impact(memory, log, memory.elapsed, contacts.pairs[number], contacts.impulses[number])
    if log.shape[1] == JUMPS:
        for row in range(first, min(memory.hits, log.shape[0])):
            copy_numbers(12, memory.before, log[row, BEFORE:])
            copy_numbers(12, state, log[row, AFTER:])
            log[row, HELD_SO_FAR] = memory.held.holding
    return Status.DONE


def record_impact(memory: Workspace, log: Array, time: float, pair: int, impulse: float) -> None:
    """Count an impact, and write it to the log if there is room.

    Args:
        memory: with the counts.
        log: see ``workspace.new_log``.
        time: since the step's start [s].
        pair: 4 * wall + foot.
        impulse: [N s].
    """
    if memory.hits < log.shape[0]:
        log[memory.hits, 0], log[memory.hits, 1], log[memory.hits, 2] = time, pair // 4, pair % 4
        log[memory.hits, 3] = impulse
        if log.shape[1] == JUMPS:
            log[memory.hits, HELD_SO_FAR] = -1.0
    memory.hits += 1
    memory.impulse += impulse


def bounce(scene: SceneNumbers, state: Array, row: Array) -> float:
    """One contact, with the gap's gradient J in ``row``: lambda = -(1 + e) J qdot / (J M^-1 J^T) where J qdot < 0."""
    impulse = 0.0
    rate = rate_of(state, row)
    if rate < 0.0:
        impulse = -(1.0 + scene.restitution) * rate / inverse_mass(scene, row)
        kick(scene, state[RATES:], row, impulse)
    return impulse


def inverse_mass(scene: SceneNumbers, row: Array) -> float:
    """J M^-1 J^T [1/kg], with the gap's gradient J in ``row``."""
    box_arm, jack_arm = row[THETA_BOX], row[THETA_JACK]
    centres = 1.0 / scene.box_mass + 1.0 / scene.jack_mass
    return float(centres + (box_arm * box_arm / scene.box_inertia + jack_arm * jack_arm / scene.jack_inertia))


def kick(scene: SceneNumbers, rates: Array, row: Array, impulse: float) -> None:
    """Change the six velocities ``rates`` of box and jack by M^-1 J^T lambda."""
    rates[X_BOX] += row[X_BOX] * impulse / scene.box_mass
    rates[Y_BOX] += row[Y_BOX] * impulse / scene.box_mass
    rates[THETA_BOX] += row[THETA_BOX] * impulse / scene.box_inertia
    rates[X_JACK] += row[X_JACK] * impulse / scene.jack_mass
    rates[Y_JACK] += row[Y_JACK] * impulse / scene.jack_mass
    rates[THETA_JACK] += row[THETA_JACK] * impulse / scene.jack_inertia


def bounce_several(scene: SceneNumbers, memory: Workspace, count: int) -> bool:
    """Call :func:`bounce_together` by its address; return whether it is compiled."""
    compiled = is_compiled(memory.together)
    if compiled:
        together_at(memory.together)(scene, memory, count)
    return compiled


def bounce_together(scene: SceneNumbers, memory: Workspace, count: int) -> None:
    """Several contacts: v+ = (1 + e) P(v-) - e v-, which at e = 1 reflects v- at its projection on the cone."""
    contacts = memory.contacts
    mass_scale(scene, contacts, count, memory.state[RATES:])
    contacts.bias[:] = 0.0
    chosen = nearest(contacts, count)
    for index in range(3):
        number = chosen[index]
        if number >= 0:
            impulse = (1.0 + scene.restitution) * contacts.best[index] / contacts.lengths[number]
            contacts.impulses[number] = impulse
            kick(scene, memory.state[RATES:], contacts.gradients[number], impulse)


def example() -> tuple[Any, ...]:
    """A value that :func:`bounce_together` returns, and arguments of it."""
    return None, SceneNumbers(*[0.0] * len(SceneNumbers._fields)), new_workspaces()[0], 0


together_at = called_later(lambda: bounce_together, example)
_OFTEN, _OFTEN_WITH_LOSS = 32, 256  # impacts of a step, see widened()


class ContactTolerances(NamedTuple):
    """Gaps at which feet touch in a step."""

    tolerance: float  # gap at which a foot touches [m]
    resolution: float  # gap within which contacts are simultaneous [m], before :func:`contact_resolution` widens it


def deepest(scene: SceneNumbers) -> float:
    """Depth in a wall up to which a foot may go, and resolutions may grow [m]: 1e-10, less in boxes below 1 m."""
    return 1e-10 * min(1.0, scene.box_half_width)


def widened(scene: SceneNumbers, memory: Workspace, gap: float) -> float:
    """A ``gap`` [m] doubled with every 32 impacts of a step, with loss every 256, up to :func:`deepest`.

    With loss most series of bounces shrink to the resolution by themselves (Zeno), so it grows later.
    """
    often = _OFTEN if scene.restitution == 1.0 else _OFTEN_WITH_LOSS
    doublings = memory.hits // often
    part = memory.hits / often - doublings
    return float(min(deepest(scene), gap * (1 << min(doublings, 60)) * (1.0 + part)))


def contact_resolution(scene: SceneNumbers, memory: Workspace, tolerances: ContactTolerances) -> float:
    """Gap within which contacts are simultaneous and feet may rest [m]; with loss it grows with the step's impacts."""
    gap = tolerances.resolution
    return max(gap, widened(scene, memory, gap)) if scene.restitution < 1.0 else gap


def record_rest(memory: Workspace, log: Array, dt: float) -> None:
    """Record the impulse of each foot at rest over the step, as an impact at its end."""
    held = memory.held
    for pair in range(16 if held.holding > 0 else 0):
        if held.resting[pair] > 0.0:
            record_impact(memory, log, dt, pair, held.resting[pair])
