"""The functions that the page calls, on memory that it passes: plain Python, compiled as it stands.

Each works in one buffer of float64, whose parts are named below; ``OFFSETS`` lists them for the page.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Any

from numba.np.arrayobj import get_cfarray_intrinsic

from jackbox_env.exact.contact import bounce_together
from jackbox_env.exact.flight import TABLE_WIDTH
from jackbox_env.exact.late import settle_and_advance
from jackbox_env.exact.pcg64 import ARM, BOX_INERTIA, BOX_MASS, HALF_WIDTH, JACK_INERTIA, JACK_MASS, restart_blocks
from jackbox_env.exact.score import COSINES, observe_one, score_one, state_in
from jackbox_env.exact.step import Pieces, make_parameters
from jackbox_env.exact.step import step as step_once
from jackbox_env.exact.workspace import AT_IMPACT, HEIGHT, Workspace, make_numbers
from jackbox_env.model.action import landing_share
from jackbox_env.model.landing import ends_decision
from jackbox_env.model.mechanics import energy_of, twice_kinetic
from jackbox_env.model.observation import OBSERVATIONS
from jackbox_env.model.scene import SceneNumbers, square_inertia
from jackbox_env.model.states import clearance

MOST_IMPACTS = 128  # recorded of a step
TERMS = 2  # of a task's reward, at most
SCENE, OBSERVED = len(SceneNumbers._fields), len(OBSERVATIONS["landing"].names)

# Parts of the buffer, and their lengths.
PARTS = {
    "SCENE": SCENE, "DT": 1, "KIND": 1, "TIME": 1, "TORQUE": 1, "BEFORE": 12, "AFTER": HEIGHT, "STATUS": 1, "HITS": 1,
    "MEAN_TORQUE": 1, "IMPULSE": 1, "REWARDS": TERMS, "ENERGY": 1, "JACK_ENERGY": 1, "MOMENTUM": 3,
    "SHARE": 1, "ACTION": 2, "STEPS": 1, "SEPARATED": 1,
    "GAP": 1, "RESTING": 1,
}  # fmt: skip

MEASURED = "jack_energy", "momentum_x", "momentum_y", "angular_momentum"  # from JACK_ENERGY on, columns of the page
OFFSETS = dict(zip(PARTS, accumulate(PARTS.values(), initial=0), strict=False))
IMPACTS_AT = -(-sum(PARTS.values()) // AT_IMPACT) * AT_IMPACT  # rows of the log follow
LENGTH = IMPACTS_AT + AT_IMPACT * MOST_IMPACTS
(
    SCENE_AT, DT, KIND, TIME, TORQUE, BEFORE, AFTER, STATUS, HITS, MEAN_TORQUE, IMPULSE, REWARDS, ENERGY,
    JACK_ENERGY, MOMENTUM, SHARE, ACTION, STEPS, SEPARATED, GAP, RESTING,
) = OFFSETS.values()  # fmt: skip
array: Any = get_cfarray_intrinsic("C", None)  # type: ignore[no-untyped-call]  # numba's carray, which would want its runtime


def step(buffer: Any, workspace: Any) -> None:
    """Step BEFORE to AFTER by DT [s], under TORQUE [N m] or, if KIND is ``step.CHIRP``, the scene's chirp.

    The last RESTING of its HITS are feet at rest.
    """
    d, memory = array(buffer, (LENGTH,)), array(workspace, (1,))[0]
    log = array(buffer, (LENGTH // AT_IMPACT, AT_IMPACT))[IMPACTS_AT // AT_IMPACT :]
    scene, none = make_numbers(d[SCENE_AT : SCENE_AT + SCENE]), Pieces(array(buffer, (0, TABLE_WIDTH)), 0, 0)
    params, before, after = (
        make_parameters(scene, d[DT], int(d[KIND])),
        d[BEFORE : BEFORE + 12],
        d[AFTER : AFTER + 12],
    )
    status, d[MEAN_TORQUE] = step_once(scene, params, before, after, d[TIME], d[TORQUE], none, memory, log)
    d[STATUS], d[HITS], d[IMPULSE] = status.value, memory.hits, memory.impulse
    d[RESTING] = 0.0
    for pair in range(16 if memory.held.holding > 0 else 0):
        d[RESTING] += memory.held.resting[pair] > 0.0


def bounce_several(scene: SceneNumbers, memory: Workspace, count: int) -> bool:
    """Replaces ``contact.bounce_several``, which calls by an address."""
    bounce_together(scene, memory, count)
    return True


# Compiled with the step, not later.
AT_ONCE: dict[str, Any] = {
    "advance_resting": settle_and_advance,
    "bounce_several": bounce_several,
}  # compiled with the step


def score(buffer: Any) -> None:
    """Fill in the REWARDS of the step to AFTER, and its energies [J] and momenta [kg m/s, kg m^2/s]."""
    d = array(buffer, (LENGTH,))
    values, after, rewards = d[SCENE_AT : SCENE_AT + SCENE], d[AFTER : AFTER + 12], d[REWARDS : REWARDS + TERMS]
    rewards[0] = rewards[1] = 0.0
    score_one(values, after, d[MEAN_TORQUE], d[IMPULSE], rewards)
    scene, state = make_numbers(values), state_in(after)
    d[ENERGY] = energy_of(scene, after)
    kinetic = twice_kinetic(scene.jack_mass, scene.jack_inertia, state.vx_jack, state.vy_jack, state.omega_jack)
    d[JACK_ENERGY] = 0.5 * kinetic + scene.jack_mass * scene.gravity * state.y_jack
    box_x, box_y = scene.box_mass * state.vx_box, scene.box_mass * state.vy_box
    jack_x, jack_y = scene.jack_mass * state.vx_jack, scene.jack_mass * state.vy_jack
    spins = scene.box_inertia * state.omega_box + scene.jack_inertia * state.omega_jack
    d[MOMENTUM], d[MOMENTUM + 1] = box_x + jack_x, box_y + jack_y
    d[MOMENTUM + 2] = spins + state.x_box * box_y - state.y_box * box_x + state.x_jack * jack_y - state.y_jack * jack_x


def observe(buffer: Any, observation: Any) -> None:
    """Write the numbers of ``observation="landing"`` of AFTER, which trained agents observe."""
    d = array(buffer, (LENGTH,))
    observe_one(d[SCENE_AT : SCENE_AT + SCENE], d[AFTER : AFTER + 12], d[TIME], array(observation, (OBSERVED,)))


# For which it is compiled.
LANDING: dict[str, Any] = {"observation_values": OBSERVATIONS["landing"].values, **COSINES}


def start(buffer: Any, numbers: Any, words: Any) -> None:
    """Draw a start into AFTER, from a generator's words; ``numbers`` is one 0."""
    values = array(buffer, (1, LENGTH))[:, SCENE_AT : SCENE_AT + SCENE]
    blocks = array(buffer, (1, LENGTH, 1))[:, AFTER : AFTER + HEIGHT]
    restart_blocks(values, blocks, array(numbers, (1,)), array(words, (1, 4)))


def derive(buffer: Any) -> None:
    """Set the inertias that follow from masses and sizes."""
    d = array(buffer, (LENGTH,))
    d[SCENE_AT + BOX_INERTIA] = square_inertia(d[SCENE_AT + BOX_MASS], d[SCENE_AT + HALF_WIDTH])
    d[SCENE_AT + JACK_INERTIA] = square_inertia(d[SCENE_AT + JACK_MASS], d[SCENE_AT + ARM])


def measure(buffer: Any) -> None:
    """Set the smallest GAP [m] of BEFORE, negative if a foot is outside the box."""
    d = array(buffer, (LENGTH,))
    d[GAP] = clearance(make_numbers(d[SCENE_AT : SCENE_AT + SCENE]), d[BEFORE : BEFORE + 12])


def act(
    buffer: Any,
    observation: Any,
    weights: Any,
    values: Any,
    hidden: int,
    outputs: int,
    longest: int,
    max_contact_steps: int,
) -> None:
    """The trained agent's SHARE of the torque limit in the step from AFTER.

    It decides after ``longest`` steps, or by :func:`jackbox_env.model.landing.ends_decision`.
    STEPS are those since its decision, -1 before the first.
    """
    d = array(buffer, (LENGTH,))
    if 0.0 <= d[STEPS] < longest:
        d[SEPARATED] = max(d[SEPARATED], 1.0 if d[HITS] == 0.0 else 0.0)
        if ends_decision(d[STEPS], d[SEPARATED] != 0.0, d[HITS] > 0.0, max_contact_steps):
            d[STEPS] = -1.0
    if not 0.0 <= d[STEPS] < longest:
        decide(d, array(observation, (OBSERVED,)), weights, values, hidden, outputs)
        d[STEPS] = d[SEPARATED] = 0.0
    d[STEPS] += 1.0
    d[SHARE] = d[ACTION]
    if outputs == 2:
        scene, state = make_numbers(d[SCENE_AT : SCENE_AT + SCENE]), state_in(d[AFTER : AFTER + 12])
        d[SHARE] = landing_share(scene, state, (d[ACTION], d[ACTION + 1]), d[TIME], d[DT])


def decide(d: Any, observation: Any, weights: Any, values: Any, hidden: int, outputs: int) -> None:
    """A network's ACTION from an observation: two layers of ``hidden`` neurons with tanh.

    ``weights`` has each layer's weights and biases; ``values`` is memory for inputs and neurons.
    """
    w = array(weights, (hidden * (hidden + OBSERVED + 2 + outputs) + outputs,))
    v = array(values, (OBSERVED + 2 * hidden + outputs,))
    for k in range(OBSERVED):
        v[k] = observation[k]
    first, low, width = 0, 0, OBSERVED
    for layer in range(3):
        height = outputs if layer == 2 else hidden
        for i in range(height):
            total = float(w[first + height * width + i])
            for j in range(width):
                total += w[first + i * width + j] * v[low + j]
            v[low + width + i] = total if layer == 2 else math.tanh(total)
        first, low, width = first + height * (width + 1), low + width, height
    for i in range(outputs):
        d[ACTION + i] = max(-1.0, min(1.0, v[low + i]))
