"""A row of a rollout from its first to its last step, as one thread of a GPU plays it.

The physics is :func:`jackbox_env.exact.step.step`, compiled as it stands. Feet that come to rest, and angles that
float64 does not resolve, are left to the CPU: they need code that is large, or the C library.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.exact.contact import bounce_together
from jackbox_env.exact.geometry import FARTHEST
from jackbox_env.exact.score import state_in, task_over, task_terms
from jackbox_env.exact.step import CONSTANT, Pieces, make_parameters, step
from jackbox_env.exact.workspace import Status, Workspace, Workspaces, new_log, new_workspaces, scene_at
from jackbox_env.jit.compiler import numbers_in, unpacked_as
from jackbox_env.model.mechanics import energy_of, twice_kinetic
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    Array,
    Counts,
    copy_numbers,
    total,
)


class CardCall(NamedTuple):
    """What :func:`play` reads and writes, any strides; results of length 0 are not wanted."""

    ended: Counts  # (N,) a Status; rows that are not DONE before are not played; the first field, see ptx.py
    dt: float  # [s]
    repeat: int  # steps that each torque lasts for
    values: Array  # (1 or N, numbers of a scene)
    states: Array  # (N, 12), the first
    torques: Array  # (N, H / repeat) [N m]
    last: Array  # (N, 12)
    trajectories: Array  # (N, H + 1, 12)
    energies: Array  # (N, H + 1) [J]
    hits: Counts  # (N, H)
    impulses: Array  # (N, H) [N s]
    rewards: Array  # (N, H)
    lengths: Counts  # (N,) H before


def example() -> CardCall:
    """Arguments of the types that :func:`play` is compiled for."""
    table, counts = np.zeros((4, 4))[::2, ::2], np.zeros((4, 4), np.int64)[::2, ::2]
    cube = np.zeros((4, 4, 4))[::2, ::2, ::2]
    return CardCall(
        counts[0], 0.0, 1, table, table, table, table, cube, table, counts, table, table, counts[0],
    )  # fmt: skip


call_at = unpacked_as(example)


def arguments() -> tuple[Any, ...]:
    """Arguments of :func:`play`."""
    return 0, new_workspaces(), np.zeros(24), new_log(), 0


def play(address: Any, workspaces: Workspaces, scratch: Array, log: Array, row: int) -> None:
    """Play a row of a :class:`CardCall` at this address, until its last step or one that is left to the CPU.

    Args:
        address: of the call.
        workspaces: of this thread, whatever is in it.
        scratch: likewise, shape (24,).
        log: of no impacts.
        row: its number, >= 0.
    """
    call, memory = call_at(address), workspaces[0]
    if call.ended[row] != Status.DONE.value:
        return
    scene = scene_at(call.values, row)
    here, there, over = scratch[:12], scratch[12:24], False
    memory.held.holding = memory.held.released = 0
    copy_numbers(12, call.states[row], here)
    record(call, scene, here, row, 0)
    for k in range(call.torques.shape[1] * call.repeat):
        ended, torque = advanced(scene, memory, scratch, log, call.torques[row, k // call.repeat], call.dt)
        if ended == Status.DONE and call.rewards.shape[0] and not over:
            named = state_in(there)
            reward = total(numbers_in(task_terms(scene, named, torque, memory.impulse)))
            over = task_over(scene, named, torque, memory.impulse)
            call.rewards[row, k] = reward
            if over:
                call.lengths[row] = k + 1
            if not abs(reward) < math.inf:
                ended = Status.BAD_REWARD
        if ended != Status.DONE:
            call.ended[row] = ended.value
            return
        if call.hits.shape[0]:
            call.hits[row, k], call.impulses[row, k] = memory.hits, memory.impulse
        copy_numbers(12, there, here)
        record(call, scene, here, row, k + 1)
    copy_numbers(12, here, call.last[row])


def advanced(
    scene: SceneNumbers, memory: Workspace, scratch: Array, log: Array, torque: float, dt: float
) -> tuple[Status, float]:
    """Step the first 12 numbers of ``scratch`` to the next 12; return how it ended, and the mean torque [N m]."""
    if not farthest_angle(scene, scratch, torque, dt) < 0.125 * FARTHEST:
        return Status.UNCOMPILED, 0.0
    params = make_parameters(scene, dt, CONSTANT)
    return step(scene, params, scratch[:12], scratch[12:], 0.0, torque, Pieces(log, 0, 0), memory, log)


def farthest_angle(scene: SceneNumbers, state: Array, torque: float, dt: float) -> float:
    """A bound of the angles in a step [rad]: sqrt(2 E), E the kinetic energy, grows by at most |M^-1/2 F| a second."""
    box = twice_kinetic(scene.box_mass, scene.box_inertia, state[VX_BOX], state[VY_BOX], state[OMEGA_BOX])
    jack = twice_kinetic(scene.jack_mass, scene.jack_inertia, state[VX_JACK], state[VY_JACK], state[OMEGA_JACK])
    push = abs(torque) / math.sqrt(scene.box_inertia) + math.sqrt(scene.jack_mass) * scene.gravity
    rate = (math.sqrt(box + jack) + push * dt) / math.sqrt(min(scene.box_inertia, scene.jack_inertia))
    return float(max(abs(state[THETA_BOX]), abs(state[THETA_JACK])) + rate * dt)


def record(call: CardCall, scene: SceneNumbers, state: Array, row: int, index: int) -> None:
    """Record a state and its energy, if they are wanted."""
    if call.trajectories.shape[0]:
        copy_numbers(12, state, call.trajectories[row, index])
    if call.energies.shape[0]:
        call.energies[row, index] = energy_of(scene, state)


# -- in place of functions of exact/ -----------------------------------------------------------------------------------


def left_to_cpu(*_arguments: Any) -> tuple[Status, float]:
    """For feet at rest, and drives that are not a constant torque."""
    return Status.UNCOMPILED, 0.0


def bounce_several(scene: SceneNumbers, memory: Workspace, count: int) -> bool:
    """For the call by an address."""
    bounce_together(scene, memory, count)
    return True


def never_reached(_angle: float) -> tuple[float, float]:
    """For the C library's cosine and sine, see :func:`farthest_angle`."""
    return math.nan, math.nan


SUBSTITUTES: dict[str, Any] = {
    "advance_resting": left_to_cpu, "advance_pieces": left_to_cpu,
    "bounce_several": bounce_several, "c_library_cos_sin": never_reached,
}  # fmt: skip
