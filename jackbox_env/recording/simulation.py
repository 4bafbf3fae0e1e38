"""``jackbox_env.simulate``: simulate a scene from a state, to a time or an event."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import LATEST_TIME, Array, State, as_restored, by_names
from jackbox_env.recording.events import Event, event_of
from jackbox_env.recording.motion import Motion
from jackbox_env.recording.recorder import Controller, exact_advance, run_record, stepping_advance, steps_of
from jackbox_env.simulators import make_simulator
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.fidelity import FIDELITIES, Setting
from jackbox_env.tools import checks as check

EXACT = "exact"


def simulate(
    scene: Scene | Mapping[str, Any] | None = None,
    state: ArrayLike | Mapping[str, float] | None = None,
    duration: float = 10.0,
    *,
    torque: float | ArrayLike | Callable[..., float] | None = None,
    time: float = 0.0,
    dt: float = 0.02,
    fidelity: str = "exact",
    until: str | int | Callable[[Any], float] | None = None,
) -> Motion:
    """Simulate a scene: its states, impacts and energies as one object.

    >>> import jackbox_env
    >>> motion = jackbox_env.simulate(duration=60.0, until=3)
    >>> len(motion.impacts), motion.t[-1].round(6).item()
    (3, 2.747021)
    >>> fallen = jackbox_env.simulate({"drive": None}, until=lambda state: state.y_jack + 2.0)
    >>> fallen.t[-1].round(6).item(), fallen.states[-1, 4].round(6).item()  # 2 m below the start
    (0.638551, -2.0)
    >>> def level(time, state):  # a controller: it turns the box back
    ...     return -2e5 * state.theta_box - 1e5 * state.omega_box
    >>> levelled = jackbox_env.simulate(None, {"theta_box": 0.1}, torque=level)
    >>> abs(levelled.states[-1, 2]).round(3).item()
    0.0

    Args:
        scene: a Scene, a dict of some of its fields, or None for the default scene.
        state: at the start, 12 numbers, SI units, or a dict of some by their names; a foot may be up to 1 m outside.
            Others are 0; None: all are, with the jack at rest in the middle.
        duration: simulated time [s], > 0. If it is no multiple of ``dt``, the last step is shorter. At most 10,000,000
            steps of ``dt``.
        torque: on the box. None: the scene's drive; a number [N m] (0.0: none); a function of the time [s] that
            returns N m; one number for each control step; or a controller, a function that needs the time [s] and the
            :class:`jackbox_env.State`, called at the start of each step, in which the N m that it returns are constant.
            The drive's side forces act in any case.
        time: at the start [s].
        dt: duration of a control step [s], > 0. It does not change the exact motion, except that each torque of an
            array or a controller is constant for one step.
        fidelity: a name of ``FIDELITIES``: "exact", or one of pymunk. With pymunk there are states at the ends of
            control steps only.
        until: what ends the motion before ``duration``; "exact" only. "impact"; a number of impacts, > 0; or a
            function of the :class:`jackbox_env.State` at its next change of sign, also by an impact. The function is
            sampled at 8 points on each flight within a control step, so ``dt`` sets the resolution: two changes between
            two points are missed. A foot at rest counts as no impact here. Feet that strike together count one each,
            so there may be more impacts than the number.

    Raises:
        TypeError, ValueError: unusable values.
        JackLostError: the jack would leave the box, or cannot be followed.
    """
    setting, scene = FIDELITIES[check.choice("fidelity", fidelity, FIDELITIES)], Scene.of(scene)
    dt = check.real("dt", dt, above=0.0)
    duration = check.real("duration", duration, above=0.0)
    event = event_of(until)
    if event is not None and setting.contact != EXACT:
        raise ValueError(f"until needs fidelity='exact', got {check.shown(until)} with fidelity={fidelity!r}")
    torques: Array | Controller | None = None
    if callable(torque) and _is_controller(torque):
        torques = _checked(torque)
    elif callable(torque):
        forces = (scene.drive.force_x, scene.drive.force_y) if isinstance(scene.drive, Drive) else ()
        scene = scene.changed(drive=Drive(torque, *forces))
    elif torque is not None:
        torques = _torques(torque, steps_of(duration, dt))
    motion = recorded(scene, setting, np.zeros(12) if state is None else state, time, duration, dt, torques, event)
    if motion.failure is not None:
        raise motion.failure
    return motion


def _is_controller(function: Callable[..., float]) -> bool:
    """Whether a function needs a state beside the time."""
    try:
        parameters = signature(function)
    except ValueError:  # numpy's functions have none
        return False
    for arguments in [0.0], [0.0, None]:
        with suppress(TypeError):
            parameters.bind(*arguments)
            return len(arguments) == 2
    raise TypeError(f"torque must be a function of the time, or of time and state, got {check.shown(function)}")


def _checked(function: Callable[[float, State], float]) -> Controller:
    """The controller, whose torques are checked."""
    return lambda time, state: check.real(f"torque({time:g} s, state)", function(time, State(*state.tolist())))


def _torques(torque: Any, steps: tuple[int, float]) -> Array:
    """The torque of each step [N m]."""
    count = steps[0] + (steps[1] > 0.0)
    requirement = f"be a number, a function of time or one number for each of {count} steps"
    torques = check.finite("torque", torque, requirement)
    if torques.ndim == 0:
        return np.broadcast_to(torques, count)
    if torques.shape != (count,):
        raise ValueError(f"torque must {requirement}, got shape {torques.shape}")
    return torques


def recorded(
    scene: Scene, setting: Setting, state: ArrayLike | Mapping[str, float], time: float, duration: float, dt: float,
    torques: Array | Controller | None, event: Event | None = None, progress: bool = False,
) -> Motion:  # fmt: skip
    """:func:`simulate` by any contact model; an error in a step ends the motion early.

    ``torques`` has one for each step at least [N m], or returns it; ``progress`` shows a bar.
    The other arguments of numbers but state and time have been checked.
    """
    state = as_restored(scene, by_names(state) if isinstance(state, Mapping) else state)
    time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
    for start in (time, time + max(duration - dt, 0.0)):
        end_of_step(start, min(dt, duration))
    if setting.contact == EXACT:
        advance = exact_advance(scene)
    else:
        simulator = make_simulator(scene, **setting._asdict())
        simulator.reset(state, time)
        advance = stepping_advance(simulator)
    record, end = run_record(advance, state, time, dt, steps_of(duration, dt), torques, event, progress)
    return Motion(record, end=end)
