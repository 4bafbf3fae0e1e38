"""The fits of docs/fitting.md of synthetic recordings: in random scenes, and of small labs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jackbox_env import Fit, Recording, Scene, fit, make_simulator
from jackbox_env.fits.shooting import units
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    RATES,
    THETA_BOX,
    THETA_JACK,
    VX_JACK,
    VY_JACK,
    X_JACK,
    Y_JACK,
    Array,
)
from jackbox_env.model.tasks import sample_start

DT, SECONDS, IMPACT_NOISE = 0.02, 4.0, 1e-4  # control step [s], length of a recording [s], of impacts' times [s]
_JACK = X_JACK, Y_JACK, THETA_JACK
MEASURED: dict[str, Sequence[int]] = {
    "all 12 numbers": range(12),
    "positions and angles": range(RATES),
    "positions and angles in every second row": range(RATES),
    "the jack's position, angle and rates": (*_JACK, VX_JACK, VY_JACK, OMEGA_JACK),
    "the jack's position and angle": _JACK,
    "the jack's position and angle, and impacts heard": _JACK,
}
NOISE = (3e-4, 1e-3, 3e-3)  # in units of L, v0, v0 / L and v0 / l
FIELDS = (("jack_mass", "restitution"), ("restitution", "gravity"), ("jack_mass", "jack_arm", "restitution"))
# Fields that are fitted in a lab, and what is wrong there and by how much.
LAB_FIELDS: tuple[str, ...] = ("jack_mass", "jack_inertia", "restitution")
LABS: dict[str, dict[str, float]] = {
    "nothing is wrong": {},
    "jack_arm 1 % too large": {"jack_arm": 1.01},
    "gravity 1 % too large": {"gravity": 1.01},
    "box_half_width 1 % too large": {"box_half_width": 1.01},
}


def recorded(seed: int) -> tuple[Scene, Scene, tuple[str, ...], Recording, str, float]:
    """A scene, the fit's first guess, the fields to fit, a noisy recording, what was observed, and its noise."""
    rng = np.random.default_rng(seed)
    kind, noise = list(MEASURED)[seed % len(MEASURED)], NOISE[seed // len(MEASURED) % len(NOISE)]
    fields = FIELDS[int(rng.integers(len(FIELDS)))]
    scene = Scene(
        jack_mass=rng.uniform(4.0, 40.0), jack_arm=rng.uniform(0.8, 1.5), restitution=rng.uniform(0.75, 0.98),
        gravity=rng.uniform(7.0, 12.0), drive=None,
    )  # fmt: skip
    start = scene.changed(**{name: getattr(scene, name) * rng.uniform(0.75, 1.0) for name in fields})
    torques = np.repeat(rng.uniform(-3e4, 3e4, 20), 10)
    simulator = make_simulator(scene, contact="exact")
    simulator.reset(sample_start(scene, rng))
    states, heard = [simulator.state], list[float]()
    for torque in torques.tolist():
        simulator.step(DT, torque)
        states.append(simulator.state)
        heard += [hit.time for hit in simulator.impacts]
    rows = np.full((len(states), 12), np.nan)
    columns = list(MEASURED[kind])
    rows[:, columns] = (np.array(states) + noise * units(scene) * rng.standard_normal(rows.shape))[:, columns]
    if "second row" in kind:
        rows[1::2] = np.nan
    impacts = np.sort(heard + IMPACT_NOISE * rng.standard_normal(len(heard))) if "heard" in kind else None
    return scene, start, fields, Recording(rows, torques, DT, impacts=impacts), kind, noise


def followed(
    scene: Scene, start: Array, rate: float, steps: int, motor: Callable[[Array], float] | None
) -> tuple[Array, Array]:
    """The exact model's states, (steps + 1, 12), and a motor's torques, (steps,) [N m], at a rate [1/s].

    The motor's torque depends on the state, and stays for half a second. None: no torque. A drive goes before.
    """
    simulator, torques, torque = make_simulator(scene, contact="exact"), np.zeros(steps), 0.0
    simulator.reset(start)
    states = [simulator.state]
    for step in range(steps):
        if motor and step % round(0.5 * rate) == 0:
            torque = motor(simulator.state)
        simulator.step(1.0 / rate, None if scene.drive else torque)
        torques[step] = torque
        states.append(simulator.state)
    return np.array(states), torques


def filmed(seed: int) -> tuple[Scene, Scene, Recording]:
    """A lab, the fit's first guess, and what a camera sees of it.

    The box has a half width of 8 to 30 cm and stands on a table that is tilted by 3 to 12 degrees. The camera has 30 or
    60 frames a second and sees positions and angles, without rates. In half of the labs a motor turns the box.
    """
    rng, rate, pushed = np.random.default_rng((1, seed)), (30.0, 60.0)[seed % 2], bool(seed // 2 % 2)
    length = float(np.exp(rng.uniform(np.log(0.08), np.log(0.3))))
    mass, arm = 0.5 * (length / 0.15) ** 2 * np.exp(rng.uniform(-0.5, 0.5)), length * rng.uniform(0.2, 0.4)
    jack_mass = mass * rng.uniform(0.06, 0.3)
    scene = Scene(
        gravity=9.81 * np.sin(np.radians(rng.uniform(3.0, 12.0))), box_half_width=length, box_mass=mass,
        box_inertia=mass * length**2 * rng.uniform(0.5, 1.0), jack_mass=jack_mass, jack_arm=arm,
        jack_inertia=jack_mass * arm**2 * rng.uniform(0.3, 0.8), restitution=rng.uniform(0.7, 0.95), drive=None,
    )  # fmt: skip
    start = thrown(scene, rng)

    def motor(state: Array) -> float:
        push = rng.uniform(-2.0, 2.0) * scene.gravity / length  # [rad/s^2]
        back = state[OMEGA_BOX] + state[THETA_BOX]  # keeps the box from spinning
        return float(scene.box_inertia * (push - back))

    states, torques = followed(scene, start, rate, round(rng.uniform(3.0, 6.0) * rate), motor if pushed else None)
    noise = np.array([rng.uniform(2e-4, 5e-4)] * 2 + [rng.uniform(2e-3, 8e-3)])  # [m], [m], [rad]
    seen = states + np.tile(noise, 4) * rng.standard_normal(states.shape)
    seen[:, RATES:] = np.nan
    first_guess = scene.changed(
        restitution=min(1.0, scene.restitution + rng.uniform(-0.1, 0.1)),
        **{name: getattr(scene, name) * rng.uniform(0.75, 1.33) for name in LAB_FIELDS[:2]},
    )
    return scene, first_guess, Recording(seen, torques, 1.0 / rate)


def thrown(scene: Scene, rng: np.random.Generator) -> Array:
    """A start in a lab: the jack is thrown, and in half of the labs the box turns."""
    state, room = np.zeros(12), scene.box_half_width - scene.jack_arm
    speed = np.sqrt(scene.gravity * scene.box_half_width)
    state[[X_JACK, Y_JACK]], state[THETA_JACK] = rng.uniform((-0.4, -0.2), (0.4, 0.6)) * room, rng.uniform(-0.7, 0.7)
    state[[VX_JACK, VY_JACK]] = rng.uniform(-0.5, 0.5, 2) * speed
    state[OMEGA_JACK] = rng.uniform(-1.0, 1.0) * speed / scene.box_half_width
    state[OMEGA_BOX] = rng.integers(2) * rng.uniform(-0.3, 0.3) * speed / scene.box_half_width
    return state


def fitted(lab: str, seed: int) -> dict[str, Any]:
    """One fit: its time, and for each field its relative error and whether the interval contains the true value.

    ``lab``: one of ``LABS``; "": no lab.
    """
    if lab:
        (scene, start, recording), fields, kind, noise = filmed(seed), LAB_FIELDS, "positions and angles", None
        start = start.changed(**{name: getattr(start, name) * factor for name, factor in LABS[lab].items()})
    else:
        scene, start, fields, recording, kind, noise = recorded(seed)
    noise_of_impacts = None if recording.impacts is None else {"impacts": IMPACT_NOISE}
    began = time.process_time()
    try:
        estimate = fit(recording, fields, start, noise=noise_of_impacts)
    except ValueError:  # no motion could be followed
        estimate = Fit(start, {}, np.zeros(0), (), problems=("no motion could be followed",))
    seconds, outcomes = time.process_time() - began, dict[str, dict[str, Any]]()
    for name, (low, high) in estimate.intervals.items():
        true, value = getattr(scene, name), getattr(estimate.scene, name)
        identified = bool(np.isfinite(high) and (low, high) != (0.0, 1.0))
        outcomes[name] = {
            "contains": bool(low <= true <= high), "identified": identified, "error": abs(value - true) / true,
        }  # fmt: skip
    held_out = float(np.mean(estimate.residuals**2)) if len(estimate.residuals) else None
    return {
        "seed": seed, "lab": lab, "observed": kind, "noise": noise, "seconds": seconds,
        "converged": bool(estimate.converged), "fields": outcomes, "held_out": held_out,
    }  # fmt: skip
