"""The Gymnasium environment: it sequences the simulator, the task and the renderer.

A step is one step of the simulator, then the task's observation and reward, then a frame if one is shown.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import ArrayLike, NDArray

from jackbox_env import checks as check
from jackbox_env import tasks
from jackbox_env.observation import BOUNDS
from jackbox_env.randomization import Randomization
from jackbox_env.scene import Scene
from jackbox_env.scoring import Score, make_score
from jackbox_env.simulators import Impact, Simulator, make_simulator
from jackbox_env.simulators.base import total_impulse
from jackbox_env.simulators.fidelity import FURTHER, resolve
from jackbox_env.states import LATEST_TIME, Array, as_start

Observation = NDArray[np.float32]
Action = NDArray[np.float32] | float | None
# Arguments of the vector environment alone, and the end of the sentence that is raised for them here.
VECTOR_ONLY = dict.fromkeys(
    ("num_envs", "autoreset_mode", "num_threads", "with_infos"),
    'belongs to the native vector environment: gymnasium.make_vec with vectorization_mode="vector_entry_point"',
)
Randomize = Mapping[str, tuple[float, float]] | Callable[[np.random.Generator], Mapping[str, Any]] | None


class JackInBoxEnv(gym.Env[Observation, Action]):
    """A planar jack bounces inside a square box that a torque turns.

    ## Description

    A square box of half width L = 6 m and a jack, a cross with a point mass at each of its four feet, move in a
    vertical plane. The feet bounce off the inside of the walls without friction, and without loss unless the scene's
    `restitution` is below 1. A lift carries the box's weight; nothing carries the jack's. So the jack falls and
    bounces, and each bounce pushes the box down a little. The agent applies a torque to the box.

    `jackbox_env.mechanics` states the law, and each file of `jackbox_env.simulators` how exactly its contact model
    follows it.

    ## Action Space

    `Box(-1, 1, (1,), float32)`: the torque on the box in units of `scene.torque_limit` (90000 N m), positive
    counter-clockwise, constant for one control step. Finite values outside are clipped; NaN and infinities raise
    ValueError. A plain number is accepted too.

    `step(None)` applies the scene's own drive instead. By default that is a chirp: a sine of 90000 N m whose frequency
    grows from 0.5 Hz by 0.9 Hz per second, continuous in time. The native vector environment accepts None too. Action
    wrappers, Gymnasium's Sync and AsyncVectorEnv and Stable-Baselines3 cannot pass None: make the environment with
    `torque="chirp"` there, which ignores the action. An action replaces the drive's torque, not its side forces.

    ## Observation Space

    `Box` of shape (10,), float32, a function of the state, with v0 = sqrt(2 * 9.81 * L) = 10.85 m/s and the jack's arm
    l = 1 m. Values are clipped to the bounds; `info["state"]` has the full state.

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

    (*) on the axes of the box; the box's own rotation is not subtracted.

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

    The episode never terminates, unless a task of your own ends it. The time limit that `gymnasium.make` adds truncates
    it after 500 steps (by default 10 s). If the jack would leave the box, `step` raises `JackLostError`, a
    RuntimeError. In the default scene 10 s of torque cannot make it fast enough for that.

    ## Information

    `reset` and `step` return the same keys: `state` (float64, (12,): x, y, angle of the box and of the jack, then their
    rates, SI units), `time` [s], `torque` (mean over the step) [N m], `impacts` (count in the step), `impulse` (their
    sum) [N s] and `reward_<term>` for each term. With `randomize` there is also `scene`, a dict of the drawn fields.

    ## Arguments

    | Parameter        | Default      | Meaning                                                                        |
    |------------------|--------------|--------------------------------------------------------------------------------|
    | `fidelity`       | `None`       | `"coarse"`, `"balanced"`, `"fine"` or `"exact"`, see below; None: `"balanced"` |
    | `contact`        | `None`       | in place of a fidelity: `"pymunk"` (time stepping) or `"exact"` (compiled)     |
    | `substeps`       | `None`       | engine steps of pymunk per control step, >= 1; None: 4                         |
    | `scene`          | `None`       | a `Scene`, or a dict of some of its fields                                     |
    | `task`           | `"juggle"`   | the name of one under Rewards, or a `jackbox_env.Task` of your own             |
    | `control_dt`     | `0.02`       | duration of a step [s], > 0                                                    |
    | `torque`         | `"agent"`    | `"agent"`: the action, or the drive if it is None; `"chirp"`: always the drive |
    | `render_mode`    | `None`       | `"human"` or `"rgb_array"`                                                     |
    | `randomize`      | `None`       | fields of the scene that are drawn at each reset, see below                    |
    | `render_size`    | `(512, 512)` | width and height of a frame [pixels], from 16 to 4096; below 400 without text  |
    | `render_overlay` | `True`       | False: a frame shows box, jack and ruled lines alone, for learning from pixels |

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

    `fidelity` sets how impacts are computed: `"coarse"`, `"balanced"` (the default) and `"fine"` are pymunk with 2, 4
    and 64 substeps, `"exact"` is the exact model. docs/accuracy.md has the error and the speed of each. `contact` and
    `substeps` select unnamed combinations; if they conflict with `fidelity`, they raise ValueError.
    `jackbox_env.cheapest` measures which setting stays within given bounds in your own scene.

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
        "render_modes": ["human", "rgb_array"], "render_fps": 50, "render_size": (512, 512),
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
        **settings: Any,
    ) -> None:
        setting = resolve(fidelity, contact, substeps=substeps, **settings)
        self.contact = setting.contact
        self.control_dt = check.real("control_dt", control_dt, above=0.0)
        self.torque_source = check.choice("torque", torque, ("agent", "chirp"))
        if render_mode is not None:
            check.choice("render_mode", render_mode, self.metadata["render_modes"])
        size = check.size("render_size", render_size, at_least=16, at_most=4096)
        overlay = check.flag("render_overlay", render_overlay)
        self.task, self._task = task, tasks.task_of(task)
        self._builtin_task = self._task in tasks.TASKS.values()  # it never fails; a user's may
        self._first_scene = scene = Scene.of(scene)
        self.simulator_of: Callable[[Scene], Simulator] = partial(make_simulator, **setting._asdict())
        self._parts = make_simulator(scene, **setting._asdict()), make_score(scene, self._task, self.contact)
        if not self._builtin_task:  # an unfit task raises now
            self._parts[1].observe(tasks.sample_start(self._first_scene, np_random(0)[0]))
        self._randomize = None if randomize is None else Randomization(randomize, [scene], self.simulator_of)
        self._terms = [f"reward_{name}" for name in self._task.terms]
        self.observation_space = gym.spaces.Box(-BOUNDS, BOUNDS, dtype=np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, shape=(1,), dtype=np.float32)
        fps = max(1, round(1.0 / max(self.control_dt, 1e-4)))
        self.metadata = {**self.metadata, "render_fps": fps, "render_size": size}
        self.render_mode = render_mode
        self._renderer = None
        self._started = False
        if render_mode is not None:
            from jackbox_env.render.renderer import Renderer

            name = task if isinstance(task, str) else ", ".join(self._task.terms)
            self._renderer = Renderer(self.scene, render_mode, fps, name, size, overlay)
            self._start_picture()

    # -- the simulated system -----------------------------------------------------------------------------------------

    def _parts_for(self, scene: Scene) -> tuple[Simulator, Score]:
        """The parts that depend on the scene. Assigned together, so that an interrupt cannot separate them."""
        return self.simulator_of(scene), self._parts[1].of(scene)

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
        return self._simulator.impacts

    @property
    def observation(self) -> Observation:
        """The observation of the present state: a fresh float32 array, shape (10,)."""
        return self._parts[1].observe(self.state)

    def set_state(self, state: ArrayLike, time: float = 0.0) -> None:
        """Set the state, shape (12,), and the time [s], exactly. The episode continues.

        Every state of a contact model is valid, so a foot may be up to 1 m outside.

        Raises:
            TypeError, ValueError: unusable values. The environment is unchanged.
        """
        self._simulator.reset(state, time)
        self._started = True
        self._start_picture()

    # -- Gymnasium's methods ------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode. The class documents ``options`` and the distribution of starts.

        Raises:
            TypeError, ValueError: an unusable option. The environment is unchanged.
        """
        if not isinstance(options, Mapping | None):
            names = "'state', 'time' and 'scene'"
            raise TypeError(f"options must be a dict of {names} or None, got {check.shown(options)}")
        options = dict(options or {})
        check.known_keys("options", options, ("state", "time", "scene"))
        time = 0.0 if options.get("time") is None else options["time"]
        time = check.real("options['time']", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        generator = copy.deepcopy(self.np_random) if seed is None else np_random(seed)[0]
        scene = self._next_scene(generator, options.get("scene"))
        if options.get("state") is None:
            state = tasks.draw_start(self._task, scene, generator)
        else:
            state = as_start(scene, options["state"])
        parts = self._parts if scene == self.scene else self._parts_for(scene)
        observation = parts[1].observe(state)
        super().reset(seed=seed)
        self._np_random = generator
        parts[0].reset(state, time)
        self._adopt(parts)
        if self.render_mode == "human":
            self.render()
        return observation, self._info(state, 0, 0.0, [0.0] * len(self._terms))  # no reward yet

    def _next_scene(self, generator: np.random.Generator, changes: Any) -> Scene:
        """The scene of the next episode."""
        if changes is not None and not isinstance(changes, Mapping):
            raise TypeError(f"options['scene'] must be a dict of the scene's fields, got {check.shown(changes)}")
        if self._randomize is None:
            return self.scene if changes is None else self._first_scene.changed(**changes)
        drawn = self._randomize.draw(self._first_scene, generator)
        return self._first_scene.changed(**{**drawn, **(changes or {})})

    def _adopt(self, parts: tuple[Simulator, Score]) -> None:
        """Continue with a simulator whose state is set, and draw it."""
        if self._renderer is not None and parts[0].scene != self.scene:
            self._renderer.show(parts[0].scene)
        self._parts, self._started = parts, True
        self._start_picture()

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by one control step under ``action``, or under the scene's drive if it is None.

        Raises:
            TypeError, ValueError: an unusable action.
            gymnasium.error.ResetNeeded: the environment was never reset.
            JackLostError: the jack would leave the box, or cannot be followed.
            jackbox_env.TaskError: the reward of a task of your own is NaN or infinite. An error leaves the environment
                unchanged.
        """
        torque = None
        if action is not None and self.torque_source == "agent":
            torque = self._torque_of(action)
        if not self._started:
            raise gym.error.ResetNeeded("step must come after a reset, got none yet")
        simulator, score = self._parts
        before = None if self._builtin_task else simulator.snapshot()
        simulator.step(self.control_dt, torque)
        impacts, state = simulator.impacts, simulator.state
        impulse = total_impulse(impacts)
        try:
            observation, terms, over = score(state, simulator.torque, impulse)
            reward = tasks.checked_reward(self._task, terms)
        except Exception:
            if before is not None:
                simulator.restore(before)
            raise
        if self._renderer is not None:
            self._renderer.record(state, simulator.time, simulator.torque, impacts, reward)
            if self.render_mode == "human":
                self.render()
        return observation, reward, over, False, self._info(state, len(impacts), impulse, terms)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a fresh frame, uint8, shape (height, width, 3), or show it in a window ("human")."""
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

    def get_keys_to_action(self) -> dict[tuple[int, ...], Action]:
        """Keys for `gymnasium.utils.play`. Left turns the box counter-clockwise, right clockwise."""
        import pygame

        left, right = np.array([[1.0], [-1.0]], dtype=np.float32)
        return {(pygame.K_LEFT,): left, (pygame.K_RIGHT,): right}

    # -- helpers ------------------------------------------------------------------------------------------------------

    def _torque_of(self, action: Action) -> float:
        if not (type(action) is np.ndarray and action.dtype.char in "fd"):  # these are fast
            action = check.array("action", action, "be one finite number (clipped to [-1, 1])")
        if action.shape not in ((1,), ()):
            raise ValueError(f"action must have shape (1,), got shape {action.shape}")
        value = float(action.item())
        if not math.isfinite(value):
            raise ValueError(f"action must be a finite number (clipped to [-1, 1]), got {value}")
        return max(-1.0, min(1.0, value)) * self._parts[0].scene.torque_limit

    def _info(self, state: Array, impacts: int, impulse: float, terms: Sequence[float]) -> dict[str, Any]:
        simulator = self._simulator
        return {
            "state": state, "time": simulator.time, "torque": simulator.torque, "impacts": impacts, "impulse": impulse,
            **dict(zip(self._terms, terms, strict=True)), **self._drawn(),
        }  # fmt: skip

    def _drawn(self) -> dict[str, Any]:
        names = self._randomize.names if self._randomize else []
        return {"scene": {name: getattr(self.scene, name) for name in names}} if names else {}

    def _start_picture(self) -> None:
        if self._renderer is not None:
            self._renderer.reset(self._simulator.state, self._simulator.time)


def put(env: JackInBoxEnv, scene: Scene, state: Array, time: float) -> None:
    """Set an environment's scene, state and time [s], which are checked. Batches of environments use it."""
    parts = env._parts if scene == env.scene else env._parts_for(scene)
    parts[0].reset(state, time)
    env._adopt(parts)


def moment(env: JackInBoxEnv) -> tuple[Any, ...]:
    """An environment's state, last step and picture now, for :func:`go_back`."""
    return env._parts, env._parts[0].snapshot(), None if env._renderer is None else env._renderer.snapshot()


def go_back(env: JackInBoxEnv, to: tuple[Any, ...]) -> None:
    """Undo the steps of an environment since a :func:`moment`. Batches of environments use it."""
    env._parts, present, picture = to
    env._parts[0].restore(present)
    if env._renderer is not None:
        env._renderer.restore(picture)
