"""A planar jack bounces inside a square box that a torque turns.

## Description

A square box of half width L = 6 m and a jack, a cross with a point mass at each of its four feet, move in a
vertical plane. The feet bounce off the inside of the walls without friction, and without loss unless the scene's
`restitution` is below 1. A lift carries the box's weight; nothing carries the jack's. So the jack falls and
bounces, and each bounce pushes the box down a little. The agent applies a torque to the box.

The law is in `jackbox_env.mechanics`; how closely a contact model follows it is at the head of its file in
`jackbox_env.simulators`.

## Action Space

`action` selects it; `action_repeat` sets how long an action lasts:

- `"torque"` (default): `Box(-1, 1, (1,))`, the torque on the box in units of `scene.torque_limit` (90000 N m),
  positive counter-clockwise. A plain number is accepted too.
- `"landing"`: `Box(-1, 1, (2,))`, the box's angle over 0.5 rad, from the nearest quarter turn, and its rate over
  2.5 rad/s at the jack's next landing: when its centre has fallen to where a foot that points down touches a level
  box's floor. In each control step a torque steers the box along a cubic in time that ends there. Walls on the way
  are ignored.
- `"discrete"`: `Discrete(3)`, -1, 0 or 1 times the torque limit.
- a `jackbox_env.Action` of your own.

The torque is constant for one control step. Finite values outside a Box are clipped; NaN and infinities raise
ValueError.

A step of the environment is a decision: it repeats the action for `action_repeat` control steps. With
`action_repeat="bounce"` it lasts until the jack's next impact:

- Several impacts within a control step end one decision.
- An impact ends a decision only after a control step without one, or once 0.4 s have passed. So a second foot that
  strikes in the next step does not end it, and while a foot rests, an impact in each step, a decision lasts 0.4 s.
- Without an impact it ends after 2 s (without gravity, for instance), or after one control step if that is longer.
- The end of an episode ends it, too.

`step(None)` applies the scene's own drive instead, for the whole decision. By default that is a chirp: a sine of
90000 N m whose frequency grows from 0.5 Hz by 0.9 Hz per second, continuous in time. The native vector environment
accepts None too. Action wrappers, Gymnasium's Sync and AsyncVectorEnv and Stable-Baselines3 cannot pass None: make
the environment with `torque="chirp"` there, which ignores the action. An action replaces the drive's torque, not
its side forces.

## Observation Space

`observation` selects it: `"state"` (default), the ten numbers below; `"landing"`, these and the eleven of
`jackbox_env.model.landing.FEATURES`, which foretell the next landing; `"pixels"` or a `jackbox_env.Pixels`, below;
or a `jackbox_env.Observation` of your own.

`"state"` is a `Box` of shape (10,), float32, a function of the state, with v0 = sqrt(2 * 9.81 * L) = 10.85 m/s and
the jack's arm l = 1 m. Values are clipped to the bounds; `info["state"]` has the full state.

| Num | Observation                                    | Min | Max | Unit     |
|-----|------------------------------------------------|-----|-----|----------|
OBSERVED NUMBERS

(*) difference of the centres' velocities, along the box's axes; not the velocity seen from the turning box.

`"pixels"` is a `Box` of shape (84, 84, 1), uint8: a grey picture of box and jack, whose camera follows the box.
`jackbox_env.Pixels(size=(64, 64), stack=4)`, or `"pixels-64x64x4"`, has another size and, in channels, the pictures
of the last four control steps. They are drawn from the state by compiled code, with the same bits on every machine.

## Rewards

`task` selects the reward, a sum of named terms, in `info` as `reward_<term>`:

- `"juggle"`: `centre`, 1 if the jack is in the middle of the box, falling linearly to 0 at max(L - l, L / 6).
- `"spin"`: `spin`, the jack's counter-clockwise rate over v0 / l within [-1, 1], times 1 - |omega_box| L / v0.
- `"rattle"`: `knock`, the impulse of the step's impacts over 4 m_j v0, at most 1, times 1 - |omega_box| L / (2 v0),
  and `effort`, -0.01 times the square of the torque over its limit. Neither factor falls below 0.

## Starting State

The box at rest at the origin, the jack at rest, its centre uniform in +-min(1 m, (L - l) / 5) on both axes, its
angle uniform in +-0.5 rad; a jack with L <= l < sqrt(2) L starts in the middle at 45 degrees. The time starts at 0.
A task of your own may draw other starts.

## Episode End

The episode never terminates, unless a task of your own ends it. It is truncated after `episode_steps` control
steps, by default 500 (10 s), wherever the environment is made; None: never.

Gymnasium counts decisions instead. `env.spec.max_episode_steps` is their number: 125 with `action_repeat=4`; None
with `"bounce"`. `gymnasium.make(..., max_episode_steps=n)` sets it to n and adds a wrapper that truncates after n
decisions, so it can shorten an episode but not lengthen it. To make a spec again with other `episode_steps` or
`action_repeat`, add `max_episode_steps=-1`.

If the jack would leave the box, `step` raises `JackLostError`, a RuntimeError. In the default scene 10 s of torque
cannot make it fast enough for that.

## Information

`reset` and `step` return the same keys: `state` (float64, (12,): x, y, angle of the box and of the jack, then their
rates, SI units), `time` [s], `torque` (mean over the step) [N m], `impacts` (count in the step), `impulse` (their
sum) [N s], `duration` of the step [s] and `reward_<term>` for each term, summed over the step. With `randomize`
there is also `scene`, a dict of the drawn fields.

## Arguments

| Parameter        | Default      | Meaning                                                                        |
|------------------|--------------|--------------------------------------------------------------------------------|
| `fidelity`       | `None`       | `"coarse"`, `"balanced"`, `"fine"` or `"exact"`, see below; None: `"balanced"` |
| `scene`          | `None`       | a `Scene`, or a dict of some of its fields                                     |
| `task`           | `"juggle"`   | the name of one under Rewards, or a `jackbox_env.Task` of your own             |
| `observation`    | `"state"`    | a name under Observation Space, a `jackbox_env.Observation` or `Pixels`        |
| `action`         | `"torque"`   | the name of one under Action Space, or a `jackbox_env.Action`                  |
| `action_repeat`  | `1`          | control steps of an action, or `"bounce"`                                      |
| `episode_steps`  | `500`        | control steps of an episode; None: no limit                                    |
| `control_dt`     | `0.02`       | duration of a control step [s], > 0                                            |
| `torque`         | `"agent"`    | `"agent"`: the action, or the drive if it is None; `"chirp"`: always the drive |
| `render_mode`    | `None`       | `"human"`, `"rgb_array"`, or `"rgb_array_list"`: the frames of control steps   |
| `randomize`      | `None`       | fields of the scene that are drawn at each reset, see below                    |
| `render_size`    | `(512, 512)` | width and height of a frame [pixels], from 16 to 4096; below 400 without text  |
| `render_overlay` | `True`       | False: a frame shows box, jack and ruled lines alone                           |

`reset(options={"state": ..., "time": ...})` starts from these 12 numbers at that time. Every foot must be inside,
up to 1e-9 m (far from the origin, 4 units in the last place). `env.unwrapped.set_state(state, time)` restores any
state from `info`, also one in contact; `env.unwrapped.observation` is then its observation.

## Other Scenes

`reset(options={"scene": {"gravity": 1.62}})` overrides fields of the environment's scene until the next reset with
that option. Unless set, inertias follow mass and size. `env.unwrapped.scene` is the present scene.

`randomize={"jack_mass": (2.0, 6.0), "restitution": (0.8, 1.0)}` draws these fields at each reset, uniformly, in the
order of `Scene`'s fields and before the start. They are not observed. Ranges that include an invalid scene raise
ValueError at once. `randomize` may also be a function that takes the environment's `numpy.random.Generator` and
returns a dict of fields. The option `"scene"` then overrides drawn fields for that episode.

## Fidelity

`"coarse"`, `"balanced"` (the default) and `"fine"` are pymunk with 2, 4 and 64 substeps, `"exact"` is the exact
model. docs/accuracy.md has the error and the speed of each. For studies, `contact="pymunk"` (time stepping) with
`substeps` (engine steps per control step, 4 by default), or `contact="exact"`, in place of a fidelity selects
combinations without a name; together with another `fidelity` they raise ValueError.

>>> import gymnasium as gym, jackbox_env
>>> env = gym.make("JackInBox-v0")
>>> observation, info = env.reset(seed=0)
>>> for _ in range(60):  # 1.2 s of the chirp
...     observation, reward, terminated, truncated, info = env.step(None)
>>> observation.shape, bool(info["time"] > 1.19), terminated
((10,), True, False)

## Version History

* v0: initial version

Raises:
    TypeError, ValueError: an argument out of its range; the message names the value and what is allowed. A refused
        call leaves the environment as it was.
"""

from __future__ import annotations

from jackbox_env.model.observation import STATE_TABLE

_ROWS = [
    f"| {k:<3} | {what:<46} | {-bound:<3} | {bound:<3} | {unit:<8} |"
    for k, (_, what, bound, unit) in enumerate(STATE_TABLE)
]
__doc__ = (__doc__ or "").replace("OBSERVED NUMBERS", "\n".join(_ROWS))
