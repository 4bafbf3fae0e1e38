"""Resolve: the impact law at the moment of impact. Which feet touch, how velocities jump, and the record of impacts.

``search.strike`` calls :func:`resolve`, which changes the velocities and records each impact in the log.
Law: all contacts whose gap is within the resolution obey Moreau's impact law (1988, "Unilateral contact and dry
friction in finite freedom dynamics") at the scene's restitution e,

    0 <= lambda  _|_  J qdot+ + e J qdot- >= 0,    M (qdot+ - qdot-) = J^T lambda,

also called the simultaneous Newton law. :func:`jackbox_env.mechanics.simultaneous_impact_map` computes it too; tests
compare the two. With w = J M^-1/2 and v = M^1/2 qdot it is v+ = (1 + e) P(v-) - e v-, where P(v) is the nearest point
to v in the cone w v >= 0. Contacts of a jack and a square have rank 3 at most, so ``complementarity.py`` tries all sets
of one, two and three contacts.
"""

from __future__ import annotations

from typing import NamedTuple

from jackbox_env.exact.trigonometry import cos_sin
from jackbox_env.exact.workspace import Workspace
from jackbox_env.model.complementarity import nearest, weigh
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    RATES,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
)

SLOW = 1e-6  # of v0: rounding hides the derivative of a slower impact
_DEEP = 2e-10  # [m] in boxes of 1 m and more: a foot that strikes from inside is less deep


def quarter(cosine: float, sine: float, quarters: int) -> tuple[float, float]:
    """Cosine and sine of an angle plus a number of quarter turns."""
    quarters &= 3
    if quarters == 0:
        return cosine, sine
    if quarters == 1:
        return -sine, cosine
    if quarters == 2:
        return -cosine, -sine
    return sine, -cosine


def gap_and_lever(scene: SceneNumbers, ahead: float, cosine: float, sine: float, turn: int) -> tuple[float, float]:
    """Gap between a wall and a foot, and the foot's lever about the jack's centre along the wall [m].

    Args:
        scene: the scene.
        ahead: coordinate of the jack's centre along the wall's normal [m].
        cosine: of the jack's angle relative to the box.
        sine: likewise.
        turn: number of the foot minus that of the wall.
    """
    along, across = quarter(cosine, sine, turn)
    return scene.box_half_width - ahead - scene.jack_arm * along, scene.jack_arm * across


class Frame(NamedTuple):
    """Relative position of the jack, and both angles."""

    x: float  # from the box's centre [m]
    y: float
    cosine: float  # of the box's angle
    sine: float
    relative_cosine: float  # of the jack's angle relative to the box
    relative_sine: float


def gradient(scene: SceneNumbers, frame: Frame, wall: int, foot: int, row: Array) -> float:
    """Write the gradient J of a gap to ``row``; return the gap [m]."""
    nx, ny = quarter(frame.cosine, frame.sine, wall)
    depth, side = nx * frame.x + ny * frame.y, nx * frame.y - ny * frame.x  # n . r and n^perp . r
    gap, arm = gap_and_lever(scene, depth, frame.relative_cosine, frame.relative_sine, foot - wall)
    row[X_BOX], row[Y_BOX], row[THETA_BOX] = nx, ny, -side - arm
    row[X_JACK], row[Y_JACK], row[THETA_JACK] = -nx, -ny, arm
    return gap


def frame_of(state: Array) -> Frame:
    """Relative position and angles of a state."""
    c, s = cos_sin(state[THETA_BOX])
    cp, sp = cos_sin(state[THETA_JACK] - state[THETA_BOX])
    return Frame(state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX], c, s, cp, sp)


def list_touching(scene: SceneNumbers, memory: Workspace, resolution: float, wall: int, foot: int) -> int:
    """List the contacts within ``resolution`` [m], and that of ``wall`` and ``foot``; return how many there are."""
    frame = frame_of(memory.state)
    count = 0
    for k in range(4):
        for i in range(4):
            gap = gradient(scene, frame, k, i, memory.gradients[count])
            if gap <= resolution or (k == wall and i == foot):
                memory.pairs[count], memory.impulses[count], memory.gaps[count] = 4 * k + i, 0.0, gap
                count += 1
    return count


def resolve(scene: SceneNumbers, memory: Workspace, log: Array, resolution: float, wall: int, foot: int) -> None:
    """Apply the law to every contact within ``resolution`` [m], and to that of ``wall`` and ``foot`` in any case.

    It changes the velocities in ``memory.state`` and records the impacts.
    """
    state = memory.state
    count = list_touching(scene, memory, resolution, wall, foot)
    slow = rate_of(state, memory.gradients[0]) > -SLOW * scene.speed_scale
    if count > 1 or slow or memory.gaps[0] < -_DEEP * min(1.0, scene.box_half_width):
        memory.nonsmooth = 1
    if count == 1:
        memory.impulses[0] = bounce(scene, state, memory.gradients[0])
    else:
        bounce_together(scene, memory, count)
    for number in range(count):
        if memory.impulses[number] > 0.0:
            record_impact(memory, log, memory.elapsed, memory.pairs[number], memory.impulses[number])


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


def rate_of(state: Array, row: Array) -> float:
    """J qdot [m/s], with the gap's gradient J in ``row``."""
    return float(
        row[X_BOX] * (state[VX_BOX] - state[VX_JACK])
        + row[Y_BOX] * (state[VY_BOX] - state[VY_JACK])
        + row[THETA_BOX] * state[OMEGA_BOX]
        + row[THETA_JACK] * state[OMEGA_JACK]
    )


def kick(scene: SceneNumbers, rates: Array, row: Array, impulse: float) -> None:
    """Change the six velocities ``rates`` of box and jack by M^-1 J^T lambda."""
    rates[X_BOX] += row[X_BOX] * impulse / scene.box_mass
    rates[Y_BOX] += row[Y_BOX] * impulse / scene.box_mass
    rates[THETA_BOX] += row[THETA_BOX] * impulse / scene.box_inertia
    rates[X_JACK] += row[X_JACK] * impulse / scene.jack_mass
    rates[Y_JACK] += row[Y_JACK] * impulse / scene.jack_mass
    rates[THETA_JACK] += row[THETA_JACK] * impulse / scene.jack_inertia


def bounce_together(scene: SceneNumbers, memory: Workspace, count: int) -> None:
    """Several contacts: v+ = (1 + e) P(v-) - e v-, which at e = 1 reflects v- at its projection on the cone."""
    weigh(scene, memory, count, memory.state[RATES:])
    memory.bias[:] = 0.0
    chosen = nearest(memory, count)
    for index in range(3):
        number = chosen[index]
        if number >= 0:
            impulse = (1.0 + scene.restitution) * memory.best[index] / memory.lengths[number]
            memory.impulses[number] = impulse
            kick(scene, memory.state[RATES:], memory.gradients[number], impulse)
