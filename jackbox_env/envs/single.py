"""The Gymnasium environment: it sequences the simulator, the agent's functions and the renderer.

A step is a decision: one or several control steps of the simulator, each under the action's torque and scored by the
task; then an observation, and frames if they are shown.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import ArrayLike, NDArray

from jackbox_env.envs.decisions import decide
from jackbox_env.envs.past import Past
from jackbox_env.envs.settings import Settings
from jackbox_env.exact.threads import Threads
from jackbox_env.model import tasks
from jackbox_env.model.action import ACTIONS, Action, Repeats, action_of, episode_limit, repeat_of
from jackbox_env.model.observation import Observation, seen_of
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.randomization import Randomization
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import LATEST_TIME, RATES, Array, as_start
from jackbox_env.simulators import Impact, Simulator, StepResult, make_simulator
from jackbox_env.simulators.agent_functions import Functions, make_functions
from jackbox_env.simulators.fidelity import FURTHER, resolve
from jackbox_env.simulators.plain_functions import ControlStep, Nouns, tried
from jackbox_env.tools import checks as check

Seen = NDArray[Any]  # float32, or uint8 pictures
AnyAction = NDArray[Any] | float | None
# Arguments of the vector environment alone, and the end of the sentence that is raised for them here.
VECTOR_ONLY = dict.fromkeys(
    ("num_envs", "autoreset_mode", "num_threads", "with_infos"),
    'belongs to the native vector environment: gymnasium.make_vec with vectorization_mode="vector_entry_point"',
)
_KEYS: dict[Action, tuple[Any, Any]] = {  # the actions of the left and the right arrow key
    ACTIONS["torque"]: (np.ones(1, np.float32), -np.ones(1, np.float32)), ACTIONS["discrete"]: (2, 0),
}  # fmt: skip
Randomize = Mapping[str, tuple[float, float]] | Callable[[np.random.Generator], Mapping[str, Any]] | None


class Snapshot(NamedTuple):
    """All of an environment that steps and resets change, but its generator and the frames of a list."""

    parts: tuple[Simulator, Functions]
    present: StepResult
    elapsed_steps: int
    impacts: Sequence[Impact] | None
    past: Past | None
    picture: Any

    @property
    def scene(self) -> Scene:
        """The scene then."""
        return self.parts[0].scene


class JackInBoxEnv(Settings, gym.Env[Seen, AnyAction]):
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
    | 0   | x of the jack's centre, in the box frame       | -1  | 1   | L        |
    | 1   | y of the jack's centre, in the box frame       | -1  | 1   | L        |
    | 2   | x velocity relative to the box's centre (*)    | -10 | 10  | v0       |
    | 3   | y velocity relative to the box's centre (*)    | -10 | 10  | v0       |
    | 4   | cosine of the box's angle                      | -1  | 1   |          |
    | 5   | sine of the box's angle                        | -1  | 1   |          |
    | 6   | angular velocity of the box                    | -10 | 10  | v0 / L   |
    | 7   | cosine of 4 (jack's angle - box's angle)       | -1  | 1   |          |
    | 8   | sine of 4 (jack's angle - box's angle)         | -1  | 1   |          |
    | 9   | angular velocity of the jack                   | -10 | 10  | v0 / l   |

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

    The episode never terminates, unless a task of your own ends it. The time limit that `gymnasium.make` adds,
    `max_episode_steps`, truncates it after 500 decisions (by default 10 s). If actions are repeated, the environment
    itself truncates it after `episode_steps` control steps, by default 500. If the jack would leave the box, `step`
    raises `JackLostError`, a RuntimeError. In the default scene 10 s of torque cannot make it fast enough for that.

    ## Information

    `reset` and `step` return the same keys: `state` (float64, (12,): x, y, angle of the box and of the jack, then their
    rates, SI units), `time` [s], `torque` (mean over the step) [N m], `impacts` (count in the step), `impulse` (their
    sum) [N s], `duration` of the step [s] and `reward_<term>` for each term, summed over the step. With `randomize`
    there is also `scene`, a dict of the drawn fields.

    ## Arguments

    | Parameter        | Default      | Meaning                                                                        |
    |------------------|--------------|--------------------------------------------------------------------------------|
    | `fidelity`       | `None`       | `"coarse"`, `"balanced"`, `"fine"` or `"exact"`, see below; None: `"balanced"` |
    | `contact`        | `None`       | in place of a fidelity: `"pymunk"` (time stepping) or `"exact"` (compiled)     |
    | `substeps`       | `None`       | engine steps of pymunk per control step, >= 1; None: 4                         |
    | `scene`          | `None`       | a `Scene`, or a dict of some of its fields                                     |
    | `task`           | `"juggle"`   | the name of one under Rewards, or a `jackbox_env.Task` of your own             |
    | `observation`    | `"state"`    | a name under Observation Space, a `jackbox_env.Observation` or `Pixels`        |
    | `action`         | `"torque"`   | the name of one under Action Space, or a `jackbox_env.Action`                  |
    | `action_repeat`  | `1`          | control steps of an action, or `"bounce"`                                      |
    | `episode_steps`  | `None`       | control steps of an episode; None: 500 if actions are repeated, else no limit  |
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
    model. docs/accuracy.md has the error and the speed of each. `contact` and `substeps` select unnamed combinations;
    if they conflict with `fidelity`, they raise ValueError.

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

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array", "rgb_array_list"], "render_fps": 50, "render_size": (512, 512),
    }  # fmt: skip

    @check.refuse_unknown("JackInBox-v0", VECTOR_ONLY, FURTHER)
    def __init__(
        self,
        contact: str | None = None,
        substeps: int | None = None,
        scene: Scene | Mapping[str, Any] | None = None,
        task: str | tasks.Task = "juggle",
        control_dt: float = 0.02,
        torque: str = "agent",
        render_mode: str | None = None,
        fidelity: str | None = None,
        randomize: Randomize = None,
        render_size: tuple[int, int] = (512, 512),
        render_overlay: bool = True,
        observation: str | Observation | Pixels = "state",
        action: str | Action = "torque",
        action_repeat: Repeats = 1,
        episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        setting = resolve(fidelity, contact, substeps=substeps, **settings)
        dt = check.real("control_dt", control_dt, above=0.0)
        check.choice("torque", torque, ("agent", "chirp"))
        if render_mode is not None:
            check.choice("render_mode", render_mode, self.metadata["render_modes"])
        size = check.size("render_size", render_size, at_least=16, at_most=4096)
        overlay = check.flag("render_overlay", render_overlay)
        self.repeat = repeat_of(action_repeat, dt)
        limit = episode_limit(episode_steps, action_repeat)
        self._settings = {
            **setting._asdict(), "fidelity": fidelity, "task": task, "control_dt": dt, "torque": torque,
            "action": action, "action_repeat": action_repeat, "episode_steps": limit, "randomize": randomize,
            "render_mode": render_mode, "render_size": size, "render_overlay": overlay,
        }  # fmt: skip
        self._dt, self._driven = dt, torque == "chirp"
        numbers, pixels = seen_of(observation)
        self.nouns = nouns = Nouns(tasks.task_of(task), numbers, action_of(action), pixels)
        self._limit = math.inf if limit is None else limit
        self._builtin, self._by_torque = nouns.builtin, nouns.action is ACTIONS["torque"]
        self._most: float = self.repeat.steps
        self._first_scene = scene = Scene.of(scene)
        self.simulator_of: Callable[[Scene], Simulator] = partial(make_simulator, **setting._asdict())
        self._parts = make_simulator(scene, **setting._asdict()), make_functions(scene, nouns, setting.contact)
        if not self._builtin:  # unfit functions raise now
            tried(self._parts[1], tasks.sample_start(self._first_scene, np_random(0)[0]), dt)
        self._randomize = None if randomize is None else Randomization(randomize, [scene], self.simulator_of)
        self._terms = [f"reward_{name}" for name in nouns.task.terms]
        self.observation_space = nouns.space
        self.action_space: Any = copy.deepcopy(nouns.action.space)  # each has a generator of its own
        fps = max(1, round(1.0 / max(dt * (self.repeat.steps if render_mode == "rgb_array" else 1), 1e-4)))
        self.metadata = {**self.metadata, "render_fps": fps, "render_size": size}
        self._renderer, self._frames = None, list[NDArray[np.uint8]]()
        self._past: Past | None = None  # of the pictures that are observed
        self._started, self.elapsed_steps = False, 0  # control steps of the episode
        self._impacts: Sequence[Impact] | None = None  # of the last decision; None: those of the last control step
        self.control_steps: Sequence[ControlStep] = ()  # of the last decision, its last ``stored_steps``; None: all
        self.stored_steps = None if render_mode else (pixels or Pixels()).stack
        if render_mode is not None:
            from jackbox_env.render.renderer import Renderer

            name = task if isinstance(task, str) else ", ".join(nouns.task.terms)
            self._renderer = Renderer(self.scene, render_mode, fps, name, size, overlay)
        self._start_pictures()

    # -- the simulated system -----------------------------------------------------------------------------------------

    def _parts_for(self, scene: Scene) -> tuple[Simulator, Functions]:
        """The parts that depend on the scene. Assigned together, so that an interrupt cannot separate them."""
        return self._parts if scene == self.scene else (self.simulator_of(scene), self._parts[1].of(scene))

    @property
    def _simulator(self) -> Simulator:
        return self._parts[0]

    @property
    def scene(self) -> Scene:
        """The present scene, every field resolved."""
        return self._simulator.scene

    @property
    def state(self) -> Array:
        """A copy of the 12 state numbers (see :mod:`jackbox_env.mechanics`), float64, SI units."""
        return self._simulator.state

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self._simulator.time

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step, in time order."""
        return self._simulator.impacts if self._impacts is None else list(self._impacts)

    @property
    def observation(self) -> Seen:
        """The observation of the present state: a fresh array."""
        if self._past is not None:
            return self._pictures(self._past)
        return self._parts[1].observe(self.state, self.time)

    def set_state(self, state: ArrayLike, time: float = 0.0) -> None:
        """Set the state, shape (12,), and the time [s], exactly. The episode continues.

        Every state of a contact model is valid, so a foot may be up to 1 m outside.

        Raises:
            TypeError, ValueError: unusable values. The environment is unchanged.
        """
        self._simulator.reset(state, time)
        self._started, self._impacts = True, None
        self._start_pictures()

    # -- Gymnasium's methods ------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:
        """Start an episode. The class documents ``options`` and the distribution of starts.

        Raises:
            TypeError, ValueError: an unusable option.
            jackbox_env.TaskError: the start's observation has a NaN. An error leaves the environment unchanged.
        """
        if not isinstance(options, Mapping | None):
            names = "'state', 'time' and 'scene'"
            raise TypeError(f"options must be a dict of {names} or None, got {check.shown(options)}")
        options = dict(options or {})
        check.known_keys("options", options, ("state", "time", "scene"))
        time = 0.0 if options.get("time") is None else options["time"]
        time = check.real("options['time']", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        generator = self.np_random if seed is None else np_random(seed)[0]
        if self.nouns.task.start is not None:  # it may change more than the bits' state
            generator = copy.deepcopy(generator)
        bits = generator.bit_generator.state  # faster than a copy
        try:
            scene = self._next_scene(generator, options.get("scene"))
            if options.get("state") is None:
                state = tasks.draw_start(self.nouns.task, scene, generator)
            else:
                state = as_start(scene, options["state"])
            parts = self._parts_for(scene)
            if self.nouns.task not in tasks.TASKS.values():  # a wrong type of its functions raises now
                tried(parts[1], state)
            observation = parts[1].observe(state, time)
        except BaseException:
            generator.bit_generator.state = bits
            raise
        super().reset(seed=seed)
        self._np_random = generator
        self._place(parts, state, time)
        observation = observation if self._past is None else self._pictures(self._past)
        if self.render_mode == "human":
            self.render()
        none = ControlStep(state, time, 0.0, [], 0.0, [0.0] * len(self._terms), 0.0, False, observation)
        return observation, self._info(none, 0)  # no reward yet

    def _next_scene(self, generator: np.random.Generator, changes: Any) -> Scene:
        """The scene of the next episode."""
        if changes is not None and not isinstance(changes, Mapping):
            raise TypeError(f"options['scene'] must be a dict of the scene's fields, got {check.shown(changes)}")
        if self._randomize is None:
            return self.scene if changes is None else self._first_scene.changed(**changes)
        drawn = self._randomize.draw(self._first_scene, generator)
        return self._first_scene.changed(**{**drawn, **(changes or {})})

    def _place(self, parts: tuple[Simulator, Functions], state: Array, time: float, steps: int = 0) -> None:
        """Continue in another scene, state and time [s], after some control steps of the episode, and draw it."""
        parts[0].reset(state, time)
        if self._renderer is not None and parts[0].scene != self.scene:
            self._renderer.show(parts[0].scene)
        self._parts, self._started, self.elapsed_steps, self._impacts = parts, True, steps, None
        self._start_pictures()

    def step(self, action: AnyAction) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Make a decision: one or several control steps under ``action``, or under the scene's drive if it is None.

        Raises:
            TypeError, ValueError: an unusable action.
            gymnasium.error.ResetNeeded: the environment was never reset, or has made ``episode_steps``.
            JackLostError: the jack would leave the box, or cannot be followed.
            jackbox_env.TaskError: the reward of a task of your own is NaN or infinite; or a number of an observation or
                the torque of an action of your own is NaN. An error leaves the environment unchanged.
        """
        torque, controls = None, None
        if not (action is None or self._driven):
            if self._by_torque:
                torque = self._torque_of(action)
            else:
                controls = self.nouns.action.checked(action)[:, 0]
        if not self._started:
            raise gym.error.ResetNeeded("step must come after a reset, got none yet")
        left = self._limit - self.elapsed_steps
        most = self._most if self._most < left else left
        if most <= 0:
            raise gym.error.ResetNeeded(f"step must come after a reset, as the episode has had its {self._limit} steps")
        simulator, functions = self._parts
        before = None if most == 1 and self._builtin else simulator.snapshot()
        try:
            whole, made, parts = decide(
                simulator, functions, self._dt, torque, controls, most, self.repeat.max_contact_steps, self.stored_steps
            )
        except BaseException:
            if before is not None:
                simulator.restore(before)
            raise
        self.control_steps = parts
        self.elapsed_steps += made
        if self._renderer is not None:
            self._show(parts)
        self._impacts = None if made == 1 else whole.impacts
        if self._past is not None:
            self._past = self._past.later(np.array([[part.state for part in parts]]))
            whole = whole._replace(seen=self._pictures(self._past))
        return whole.seen, whole.reward, whole.over, self.elapsed_steps >= self._limit, self._info(whole, made)

    def _show(self, parts: Sequence[ControlStep]) -> None:
        """Draw control steps, as far as the render mode shows them."""
        assert self._renderer is not None
        for part in parts:
            self._renderer.record(part.state, part.time, part.torque, part.impacts, part.reward)
            if self.render_mode == "human":
                self.render()
            elif self.render_mode == "rgb_array_list":
                self._frames.append(self._renderer.drawn())

    def render(self) -> Any:
        """Return a fresh frame, uint8, shape (height, width, 3), or show it in a window ("human").

        In the mode "rgb_array_list" return, and clear, the frames of all control steps since the last call or reset,
        that of the start included.
        """
        if self.render_mode == "rgb_array_list" and self._renderer is not None:
            frames, self._frames = self._frames, []
            return frames
        if self._renderer is None:
            cause = "comes after close" if self.render_mode else 'needs a render_mode, e.g. render_mode="rgb_array"'
            gym.logger.warn(f"render {cause}: there is no picture")
            return None
        return self._renderer.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    @property
    def get_keys_to_action(self) -> Callable[[], dict[tuple[int, ...], AnyAction]]:
        """Keys for `gymnasium.utils.play`. Left turns the box counter-clockwise, right clockwise.

        With the action "discrete" use ``play(..., noop=1)``: its default, 0, is the action of the right key.

        Raises:
            AttributeError: the action is neither "torque" nor "discrete", so Gymnasium finds no keys.
        """
        if self.nouns.action not in _KEYS:
            raise AttributeError("there are keys for action='torque' and 'discrete' only")
        left, right = _KEYS[self.nouns.action]

        def keys() -> dict[tuple[int, ...], AnyAction]:
            import pygame

            return {(pygame.K_LEFT,): left, (pygame.K_RIGHT,): right}

        return keys

    # -- for batches --------------------------------------------------------------------------------------------------

    def _snapshot(self) -> Snapshot:
        """The environment as it is now, for :meth:`_restore`."""
        picture = None if self._renderer is None else self._renderer.snapshot()
        return Snapshot(self._parts, self._parts[0].snapshot(), self.elapsed_steps, self._impacts, self._past, picture)

    def _restore(self, snapshot: Snapshot) -> None:
        """Return to the moment of a :meth:`_snapshot`."""
        self._parts, present, self.elapsed_steps, self._impacts, self._past, picture = snapshot
        self._parts[0].restore(present)
        if self._renderer is not None:
            self._renderer.show(self.scene)
            self._renderer.restore(picture)

    # -- helpers ------------------------------------------------------------------------------------------------------

    def _torque_of(self, action: AnyAction) -> float:
        if type(action) is np.ndarray and action.shape == (1,) and action.dtype.char in "fd":
            value: float = action.item()
            if -1.0 <= value <= 1.0:  # most often
                return value * self._parts[0].scene.torque_limit
        else:
            action = check.array("action", action, "be one finite number (clipped to [-1, 1])")
        if action.shape not in ((1,), ()):
            raise ValueError(f"action must have shape (1,), got shape {action.shape}")
        value = float(action.item())
        if not math.isfinite(value):
            raise ValueError(f"action must be a finite number (clipped to [-1, 1]), got {value}")
        return max(-1.0, min(1.0, value)) * self._parts[0].scene.torque_limit

    def _info(self, of: ControlStep, steps: int) -> dict[str, Any]:
        """The info of a decision of so many control steps."""
        state, time, torque, impacts, impulse, terms, *_ = of
        info = {
            "state": state, "time": time, "torque": torque, "impacts": len(impacts), "impulse": impulse,
            "duration": steps * self._dt,
        }  # fmt: skip
        for name, value in zip(self._terms, terms):  # noqa: B905  # strict=True takes half as long as the physics
            info[name] = value
        return info if self._randomize is None else info | self._drawn()

    def _drawn(self) -> dict[str, Any]:
        names = self._randomize.names if self._randomize else []
        return {"scene": {name: getattr(self.scene, name) for name in names}} if names else {}

    def _pictures(self, past: Past) -> Seen:
        frames = past.draw(np.array([self.scene.numbers]), np.zeros(1, np.int64), self.nouns.unfilled(1), Threads(1))
        return frames[0]  # type: ignore[no-any-return]

    def _start_pictures(self) -> None:
        if self.nouns.pixels is not None:
            poses = np.tile(self._simulator.state[:RATES], (1, self.nouns.pixels.stack, 1))
            self._past = Past(self.nouns.pixels, poses)
        if self._renderer is not None:
            self._renderer.reset(self._simulator.state, self._simulator.time)
        if self._renderer is not None and self.render_mode == "rgb_array_list":
            self._frames = [self._renderer.drawn()]
