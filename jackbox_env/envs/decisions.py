"""A decision: control steps of a simulator under one action, each scored, until it ends."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from operator import add

from jackbox_env.model.action import clipped_share
from jackbox_env.model.landing import is_over
from jackbox_env.model.states import Array
from jackbox_env.simulators import Impact, Simulator
from jackbox_env.simulators.agent_functions import Functions
from jackbox_env.simulators.plain_functions import ControlStep


def decide(
    simulator: Simulator, functions: Functions, dt: float, torque: float | None, controls: Array | None, most: float,
    max_contact_steps: int, stored_steps: int | None,
) -> tuple[ControlStep, int, Sequence[ControlStep]]:  # fmt: skip
    """Step a simulator until ``most`` control steps, an impact or the task's end ends a decision.

    Only the last control step is observed. Sums are from the first value on, as those of the exact model's loop.

    Args:
        simulator: which moves, also if an error is raised.
        functions: of its scene.
        dt: control step [s].
        torque: constant [N m]; None: the drive acts, unless there are controls.
        controls: the numbers of an action, shape (n,), whose torque is computed in each control step; None: none.
        most: control steps, at least 1.
        max_contact_steps: see :func:`jackbox_env.model.landing.is_over`.
        stored_steps: control steps that are returned, the last ones; None: all.

    Returns:
        The whole decision, with sums over its control steps, the mean torque and the state at the end; the number of
        its control steps; and the last of them.

    Raises:
        TaskError: a reward, a torque or an observation is NaN, or a reward infinite.
        JackLostError: the jack cannot be followed.
    """
    if most == 1:
        part = _control_step(simulator, functions, dt, torque, controls, True)
        return part, 1, [part]
    parts, impacts, sums = deque[ControlStep](maxlen=stored_steps), list[Impact](), list[float]()
    made, ended, separated = 0, False, False
    while made < most and not ended:
        part = _control_step(simulator, functions, dt, torque, controls, False)
        parts.append(part)
        impacts += part.impacts
        values = [part.torque, part.impulse, part.reward, *part.terms]
        sums = list(map(add, sums, values)) if made else values
        made, struck = made + 1, bool(part.impacts)
        ended = part.over or is_over(made, separated, struck, max_contact_steps)
        separated = separated or not struck
    mean, impulse, reward, *terms = sums
    whole = part._replace(
        torque=mean / made, impacts=impacts, impulse=impulse, terms=terms, reward=reward,
        seen=functions.observe(part.state, part.time),
    )  # fmt: skip
    return whole, made, parts


def _control_step(
    simulator: Simulator, functions: Functions, dt: float, torque: float | None, controls: Array | None, seen: bool
) -> ControlStep:
    """Make one control step under a torque [N m], or that of an action's numbers, or the drive."""
    if controls is not None:
        share = clipped_share(functions.share(simulator.state, controls, simulator.time, dt))
        torque = share * simulator.scene.torque_limit
    return functions.step_and_score(simulator, dt, torque, seen)
