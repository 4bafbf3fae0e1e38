"""Arguments that do not fit each other, states outside the box, and steps after the end are refused."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import jackbox_env
from jackbox_env import Chirp, Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, Task, make_simulator, rollout
from jackbox_env.model.states import as_restored, as_start
from jackbox_env.model.tasks import juggle
from jackbox_env.simulators import CONTACT_MODELS
from tests.refusals.sentences import (
    OUTSIDE,
    START,
    Refusal,
    Subject,
    assert_refused,
    at,
    begun,
    of_both,
    put,
    reset,
    rows,
    several,
    single,
    stepped,
    with_foot,
)

MODELS: Any = np.array(["pymunk", "exact"])

# -- names and values of arguments that do not fit each other ----------------------------------------------------------

ARGUMENTS = [
    Refusal(
        lambda _: JackInBoxEnv(contct="exact"),
        TypeError,
        "JackInBox-v0 has no argument 'contct' (did you mean 'contact'?): it accepts contact, "
        "substeps, scene, task, control_dt, torque, render_mode, fidelity, randomize, render_size, "
        "render_overlay, observation, action, action_repeat, episode_steps",
    ),
    Refusal(
        lambda _: gym.make("JackInBox-v0", contct="exact"),
        TypeError,
        "JackInBox-v0 has no argument 'contct' (did you mean 'contact'?): it accepts contact, "
        "substeps, scene, task, control_dt, torque, render_mode, fidelity, randomize, render_size, "
        "render_overlay, observation, action, action_repeat, episode_steps was raised from the "
        "environment creator for JackInBox-v0 with kwargs ({'contct': 'exact'})",
    ),
    Refusal(
        lambda _: JackInBoxEnv(device="cuda"),
        TypeError,
        "JackInBox-v0 has no argument 'device': it belongs to the native vector environment: "
        'gymnasium.make_vec with vectorization_mode="vector_entry_point"',
    ),
    Refusal(
        lambda _: JackInBoxEnv(num_threads=2),
        TypeError,
        "JackInBox-v0 has no argument 'num_threads': it belongs to the native vector environment: "
        'gymnasium.make_vec with vectorization_mode="vector_entry_point"',
    ),
    Refusal(
        lambda env: env.reset(options={"scen": {}}),
        ValueError,
        "options accepts only 'state', 'time', 'scene', got 'scen' (did you mean 'scene'?)",
        single(),
    ),
    Refusal(
        lambda _: make_simulator(None, "exact", something=1),
        ValueError,
        "contact='exact' accepts only 'substeps', 'iterations', got 'something'",
    ),
    Refusal(
        lambda _: make_simulator(None, "exact", substeps=4),
        ValueError,
        "contact='exact' has no substeps, got substeps=4",
    ),
    Refusal(
        lambda _: JackInBoxEnv(contact="exact", substeps=4),
        ValueError,
        "contact='exact' has no substeps, got substeps=4",
    ),
    Refusal(
        lambda _: make_simulator(fidelity="fine", substeps=4),
        ValueError,
        "fidelity='fine' stands for substeps=64, got substeps=4 beside it: leave one of them out",
    ),
    Refusal(
        lambda _: make_simulator(fidelity="exact", iterations=9),
        ValueError,
        "contact='exact' has no iterations, got iterations=9",
    ),
    Refusal(
        lambda _: JackInBoxEnv(fidelity="coarse", contact=MODELS),
        ValueError,
        "fidelity='coarse' stands for contact='pymunk', got contact=array(['pymunk', 'exact'], "
        "dtype='<U6') beside it: leave one of them out",
    ),
    *(
        Refusal(
            lambda _, make=make: make(fidelity="exact", contact="pymunk"),
            ValueError,
            "fidelity='exact' stands for contact='exact', got contact='pymunk' beside it: leave one of them out",
        )
        for make in (JackInBoxEnv, JackInBoxVectorEnv)
    ),
    *(
        Refusal(
            lambda _, make=make: make(fidelity="fine", contact="exact"),
            ValueError,
            "fidelity='fine' stands for contact='pymunk', got contact='exact' beside it: leave one of them out",
        )
        for make in (JackInBoxEnv, JackInBoxVectorEnv)
    ),
    *(
        Refusal(
            lambda _, make=make: make(fidelity="coarse", substeps=8),
            ValueError,
            "fidelity='coarse' stands for substeps=2, got substeps=8 beside it: leave one of them out",
        )
        for make in (JackInBoxEnv, JackInBoxVectorEnv)
    ),
    *(
        Refusal(
            lambda _, make=make: make(fidelity="exact", substeps=4),
            ValueError,
            "fidelity='exact' stands for substeps=None, got substeps=4 beside it: leave one of them out",
        )
        for make in (JackInBoxEnv, JackInBoxVectorEnv)
    ),
    Refusal(
        lambda _: Scene(**dict[str, Any](mass=2.0)),
        TypeError,
        "Scene has no argument 'mass' (did you mean 'box_mass'?): it accepts box_half_width, "
        "box_mass, box_inertia, jack_arm, jack_mass, jack_inertia, gravity, restitution, "
        "torque_limit, drive",
    ),
    Refusal(
        lambda _: Chirp(**{"amplitud": 2.0}),
        TypeError,
        "Chirp has no argument 'amplitud' (did you mean 'amplitude'?): it accepts amplitude, start_frequency, rate",
    ),
    Refusal(
        lambda _: Task(abs),
        TypeError,
        "a Task must have names of its terms and a function, got <built-in function abs>",
    ),
    Refusal(
        lambda _: Task(juggle),
        TypeError,
        "a Task must have names of its terms and a function, got <function juggle at "
        '0x...>: write Task(("reward",), juggle) for juggle(scene, state, torque, impulse)',
    ),
    Refusal(
        lambda _: JackInBoxVectorEnv(2).step(None),
        RuntimeError,
        "step must come after a reset of all environments, got none yet",
    ),
    Refusal(lambda _: JackInBoxEnv().step(0.0), gym.error.ResetNeeded, "step must come after a reset, got none yet"),
    Refusal(
        lambda _: JackInBoxEnv(randomize={"jack_inertia": (1e-6, 4.0)}),
        ValueError,
        "randomize could draw a scene with jack_inertia=1e-06, which is refused: jack_inertia = "
        "1e-06 kg m^2, box_inertia = 14400 kg m^2 and jack_arm = 0.1666667 box_half_width couple the "
        "feet so strongly that contact='pymunk' needs more than 100,000 iterations",
    ),
    Refusal(
        lambda _: rollout(None, START, np.zeros(5), 0.02, time=1e9),
        ValueError,
        "dt must move the time and end by 1e+09 s, got 0.02 at t = 1e+09 s",
    ),
    Refusal(
        lambda _: JackInBoxEnv(action_repeat="bounce", control_dt=1e-19),
        ValueError,
        'control_dt with action_repeat="bounce" must be a finite number at least 2e-06, got 1e-19',
    ),
    Refusal(
        lambda scene: setattr(scene, "gravity", 1.0),
        dataclasses.FrozenInstanceError,
        "cannot assign to field 'gravity'",
        Subject(Scene, shown=repr),
    ),
    Refusal(
        lambda _: Scene(drive=Drive(np.cos)).as_dict(), ValueError, "a Drive of functions has no JSON form, got one"
    ),
    Refusal(
        lambda batch: batch.scene,
        ValueError,
        "the environments have different scenes: read the list scenes",
        several(2, scene=[{"gravity": 3.0}, None], contact="exact"),
    ),
]

# -- states ------------------------------------------------------------------------------------------------------------

WIDE, OUT = {"box_half_width": 9.0}, at(x_jack=6.0)
STATES = [
    Refusal(lambda _: jackbox_env.nothing, AttributeError, "module 'jackbox_env' has no attribute 'nothing'"),
    *(
        Refusal(
            lambda env, outside=outside: env.reset(options={"state": with_foot(outside)}),
            ValueError,
            OUTSIDE.format(outside),
            begun(one, reset(state=with_foot(9e-10))),
        )
        for contact in CONTACT_MODELS
        for one, _ in of_both(contact)
        for outside in (2e-9, 1e-3, 45.0)
    ),
    *(
        Refusal(
            lambda env: put(env, with_foot(1.001)),
            ValueError,
            "state must have every foot at most 1 m outside, got 1.001 m",
            begun(one, reset(), lambda env: put(env, with_foot(0.999))),
        )
        for contact in CONTACT_MODELS
        for one, _ in of_both(contact)
    ),
    Refusal(
        lambda _: [rollout(None, with_foot(outside), np.zeros(1), 0.02) for outside in (0.999, 1.001)],
        ValueError,
        "states[0]: state must have every foot at most 1 m outside, got 1.001 m",
    ),
    Refusal(
        lambda _: as_start(Scene(), [1e9, -1e9, 0.0, 1e9 + 5.0 + 1e-3, -1e9, *[0.0] * 7]),
        ValueError,
        "a start must have every foot inside the box (at most 4.76837e-07 m outside), got a foot "
        "0.00100005 m outside; set_state restores states in contact",
    ),
    Refusal(
        lambda _: as_restored(Scene(box_half_width=0.9, jack_arm=0.5), with_foot(1.41, 0.9)),
        ValueError,
        "state must have every foot at most 0.9 m outside, got 0.91 m",
    ),
    *(
        Refusal(
            lambda env: env.reset(options={"state": OUT, "scene": {"box_half_width": 6.5}}),
            ValueError,
            "a start must have every foot inside the box (at most 1e-09 m outside), got a foot 0.5 m "
            "outside; set_state restores states in contact",
            begun(one, reset(state=OUT, scene=WIDE)),
        )
        for one, _ in of_both("exact")
    ),
    *(
        Refusal(
            lambda env: env.reset(options={"state": OUT}),
            ValueError,
            "a start must have every foot inside the box (at most 1e-09 m outside), got a foot 1 m "
            "outside; set_state restores states in contact",
            begun(one, reset()),
        )
        for one, _ in of_both("exact")
    ),
]

# -- the ends of episodes ----------------------------------------------------------------------------------------------


def infos_of(mode: AutoresetMode, steps: int) -> dict[str, Any]:
    """The infos of the reset or of a later step."""
    env = JackInBoxVectorEnv(2, contact="exact", max_episode_steps=2, autoreset_mode=mode)
    return [env.reset(seed=0)[1], *(env.step(None)[4] for _ in range(2))][steps]


ENDS = [
    *(
        Refusal(
            lambda env: env.step(0.0),
            gym.error.ResetNeeded,
            "step must come after a reset, as the episode has had its 10 steps",
            begun(single(contact=contact, action_repeat=4, episode_steps=10), reset(), stepped(0.0, 3)),
        )
        for contact in CONTACT_MODELS
    ),
    *(
        Refusal(
            lambda env: env.step(None),
            RuntimeError,
            "with autoreset_mode DISABLED, reset the episodes that are over before the next step, by "
            "options={'reset_mask': ...}; 1 of 2 are over",
            begun(
                several(2, contact=contact, max_episode_steps=1, autoreset_mode=AutoresetMode.DISABLED),
                reset(),
                stepped(None),
                reset(reset_mask=np.array([False, True])),
            ),
        )
        for contact in CONTACT_MODELS
    ),
    Refusal(
        lambda env: env.step(np.where(np.arange(300) < 290, 1.0, math.nan)),
        ValueError,
        "action must be a finite number (clipped to [-1, 1]), got nan for environment 290",
        begun(several(300, contact="exact"), reset(state=at(y_jack=-4.9, vy_jack=-10.0)), stepped(np.ones(300))),
    ),
    *(
        Refusal(
            lambda infos, name=name: infos.get(name) is None and infos[name],
            KeyError,
            f"\"infos have '{name}' only in environments made with with_infos=True\"",
            Subject(partial(infos_of, mode, steps)),
        )
        for mode in AutoresetMode
        for steps in range(3)
        for name in ("impacts", "_state", "reward_centre")
    ),
    *(
        Refusal(lambda infos: infos["steps"], KeyError, "'steps'", Subject(partial(infos_of, mode, steps)))
        for mode in AutoresetMode
        for steps in range(3)
    ),
]


@rows([*ARGUMENTS, *STATES, *ENDS])
def test_an_environment_refuses_in_one_sentence_and_is_as_before(row: Refusal) -> None:
    assert_refused(row)
