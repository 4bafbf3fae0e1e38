"""The Gymnasium environment: it sequences the simulator, the agent's functions and the renderer.

A step is a decision: control steps under the action's torque, each scored by the task; then an observation and frames.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import add
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import ArrayLike

from jackbox_env.envs import reference
from jackbox_env.envs.arguments import options_of
from jackbox_env.envs.infos import Infos
from jackbox_env.envs.keys import keys_of
from jackbox_env.envs.settings import VECTOR_ONLY, Settings
from jackbox_env.exact.threads import Threads
from jackbox_env.model import tasks
from jackbox_env.model.action import (
    ACTIONS,
    EPISODE_STEPS,
    MOST_STEPS,
    Action,
    Repeats,
    action_of,
    clipped_share,
    decisions_of,
    repeat_of,
)
from jackbox_env.model.landing import ends_decision
from jackbox_env.model.observation import Observation, observation_parts
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.randomization import Randomization, Randomize, next_scene
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import LATEST_TIME, RATES, Array, as_start
from jackbox_env.render.raster import Past
from jackbox_env.simulators import Impact, Simulator, StepResult, make_simulator
from jackbox_env.simulators.agent_functions import make_functions
from jackbox_env.simulators.fidelity import FURTHER, resolve
from jackbox_env.simulators.plain_functions import ControlStep, Functions, Interface, Observed
from jackbox_env.tools import checks as check

AnyAction = Observed | float | None


class Model(NamedTuple):
    """The parts that depend on the scene. Assigned together, so that an interrupt cannot separate them."""

    simulator: Simulator
    functions: Functions


class Snapshot(NamedTuple):
    """All of an environment that steps and resets change, but its generator and the frames of a list."""

    model: Model
    present: StepResult
    elapsed_steps: int
    impacts: Sequence[Impact] | None
    past: Past | None
    picture: Any


class JackInBoxEnv(Settings, gym.Env[Observed, AnyAction]):
    """A planar jack bounces inside a square box that a torque turns. ``reference.py`` has the whole page."""

    __doc__ = reference.__doc__

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
        episode_steps: int | None = EPISODE_STEPS,
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
        if episode_steps is not None:
            episode_steps = check.whole("episode_steps", episode_steps, at_least=1, at_most=MOST_STEPS)
        self._settings = {
            **setting._asdict(), "fidelity": fidelity, "task": task, "control_dt": dt, "torque": torque,
            "action": action, "action_repeat": action_repeat, "episode_steps": episode_steps, "randomize": randomize,
            "max_episode_steps": decisions_of(episode_steps, action_repeat),
            "render_mode": render_mode, "render_size": size, "render_overlay": overlay,
        }  # fmt: skip
        self._dt, self._driven = dt, torque == "chirp"
        numbers, pixels = observation_parts(observation)
        self.interface = interface = Interface(tasks.task_of(task), numbers, action_of(action), pixels)
        self._limit = math.inf if episode_steps is None else episode_steps
        self._builtin, self._by_torque = interface.builtin, interface.action is ACTIONS["torque"]
        self._first_scene = scene = Scene.of(scene)
        self.simulator_of: Callable[[Scene], Simulator] = partial(make_simulator, **setting._asdict())
        self._model = Model(
            make_simulator(scene, **setting._asdict()), make_functions(scene, interface, setting.contact)
        )
        if not self._builtin:  # unfit functions raise now
            self._model.functions.check_types(tasks.sample_start(self._first_scene, np_random(0)[0]), dt)
        self._randomize = None if randomize is None else Randomization(randomize, [scene], self.simulator_of)
        self._terms = [f"reward_{name}" for name in interface.task.terms]
        self.observation_space = interface.space
        self.action_space: Any = copy.deepcopy(interface.action.space)  # each has a generator of its own
        fps = max(1, round(1.0 / max(dt * (self.repeat.steps if render_mode == "rgb_array" else 1), 1e-4)))
        self.metadata = {**self.metadata, "render_fps": fps, "render_size": size}
        self._renderer = None
        self._past: Past | None = None  # of the pictures that are observed
        self._started, self._ended, self.elapsed_steps = False, False, 0  # control steps of the episode
        self._impacts: Sequence[Impact] | None = None  # of the last decision; None: those of the last control step
        self.control_steps: Sequence[ControlStep] = ()  # of the last decision, its last ``stored_steps``; None: all
        self.stored_steps = None if render_mode else (pixels or Pixels()).stack
        if render_mode is not None:
            from jackbox_env.render.renderer import Renderer

            name = task if isinstance(task, str) else ", ".join(interface.task.terms)
            self._renderer = Renderer(self.scene, render_mode, fps, name, size, overlay)
        self._start_pictures()

    # -- the simulated system -----------------------------------------------------------------------------------------

    def _model_of(self, scene: Scene) -> Model:
        return self._model if scene == self.scene else Model(self.simulator_of(scene), self._model.functions.of(scene))

    @property
    def scene(self) -> Scene:
        """The present scene, every field resolved."""
        return self._model.simulator.scene

    @property
    def state(self) -> Array:
        """A copy of the 12 state numbers (see :mod:`jackbox_env.mechanics`), float64, SI units."""
        return self._model.simulator.state

    @property
    def time(self) -> float:
        """Present time [s]."""
        return self._model.simulator.time

    @property
    def impacts(self) -> list[Impact]:
        """The impacts of the last step, in time order."""
        return self._model.simulator.impacts if self._impacts is None else list(self._impacts)

    @property
    def observation(self) -> Observed:
        """The observation of the present state: a fresh array."""
        return self._pictures(self._past) if self._past else self._model.functions.observe(self.state, self.time)

    def set_state(self, state: ArrayLike, time: float = 0.0, steps: int | None = None) -> None:
        """Set the state, shape (12,), and the time [s], exactly. The episode continues; a finished one starts anew.

        Every state of a contact model is valid, so a foot may be up to 1 m outside. ``steps``, the control steps that
        the episode has had, restores ``elapsed_steps`` too.

        Raises:
            TypeError, ValueError: unusable values. The environment is unchanged.
        """
        if steps is None:
            steps = 0 if self._ended else self.elapsed_steps
        steps = check.whole("steps", steps, at_least=0, at_most=self.episode_steps)
        self._place(self._model, state, time, steps)

    # -- Gymnasium's methods ------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observed, Infos]:
        """Start an episode. The class documents ``options`` and the distribution of starts.

        Raises:
            TypeError, ValueError: an unusable option.
            jackbox_env.TaskError: the start's observation has a NaN. An error leaves the environment unchanged.
        """
        options = options_of(options, ("state", "time", "scene"))
        time = 0.0 if options.get("time") is None else options["time"]
        time = check.real("options['time']", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        generator = self.np_random if seed is None else np_random(seed)[0]
        if self.interface.task.start is not None:  # it may change more than the bits' state
            generator = copy.deepcopy(generator)
        bits = generator.bit_generator.state  # faster than a copy
        try:
            scene = self._next_scene(generator, options.get("scene"))
            start = options.get("state")
            state = tasks.draw_start(self.interface.task, scene, generator) if start is None else as_start(scene, start)
            model = self._model_of(scene)
            if self.interface.task not in tasks.TASKS.values():  # a wrong type of its functions raises now
                model.functions.check_types(state)
            observation = model.functions.observe(state, time)
        except BaseException:
            generator.bit_generator.state = bits
            raise
        super().reset(seed=seed)
        self._np_random = generator
        self._place(model, state, time)
        observation = self._pictures(self._past) if self._past else observation
        if self.render_mode == "human":
            self.render()
        none = ControlStep(state, time, 0.0, [], 0.0, [0.0] * len(self._terms), 0.0, False, observation)
        return observation, self._info(none, 0)  # no reward yet

    def _next_scene(self, generator: np.random.Generator, changes: Any) -> Scene:
        """The scene of the next episode."""
        if changes is not None and not isinstance(changes, Mapping):
            raise TypeError(f"options['scene'] must be a dict of the scene's fields, got {check.shown(changes)}")
        if self._randomize is None and changes is None:
            return self.scene
        return next_scene(self._first_scene, self._randomize, generator, changes or {})

    def _place(self, model: Model, state: ArrayLike, time: float, steps: int = 0) -> None:
        """Continue in another scene, state and time [s], after some control steps of the episode, and draw it."""
        model.simulator.reset(state, time)
        if self._renderer is not None and model.simulator.scene != self.scene:
            self._renderer.show(model.simulator.scene)
        self._model, self._started, self._ended = model, True, steps >= self._limit
        self.elapsed_steps, self._impacts = steps, None
        self._start_pictures()

    def step(self, action: AnyAction) -> tuple[Observed, float, bool, bool, Infos]:
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
                controls = self.interface.action.checked(action)[:, 0]
        if not self._started:
            raise gym.error.ResetNeeded("step must come after a reset, got none yet")
        left = self._limit - self.elapsed_steps
        most = left if left < self.repeat.steps else self.repeat.steps
        if most <= 0:
            raise gym.error.ResetNeeded(f"step must come after a reset, as the episode has had its {self._limit} steps")
        simulator = self._model.simulator
        before = None if most == 1 and self._builtin else simulator.snapshot()
        try:
            whole, made, self.control_steps = self._decide(torque, controls, most)
        except BaseException:
            if before is not None:
                simulator.restore(before)
            raise
        self.elapsed_steps += made
        if self._renderer is not None:
            for part in self.control_steps:
                self._renderer.record(part.state, part.time, part.torque, part.impacts, part.reward)
                if self.render_mode == "human":
                    self.render()
        self._impacts = None if made == 1 else whole.impacts
        if self._past is not None:
            self._past = self._past.later(np.array([[part.state for part in self.control_steps]]))
            whole = whole._replace(observation=self._pictures(self._past))
        truncated = self.elapsed_steps >= self._limit
        self._ended = whole.terminated or truncated
        return whole.observation, whole.reward, whole.terminated, truncated, self._info(whole, made)

    def _decide(
        self, torque: float | None, controls: Array | None, most: float
    ) -> tuple[ControlStep, int, Sequence[ControlStep]]:
        """Step the simulator until ``most`` control steps, an impact or the task's end ends the decision.

        Only its end is observed. Sums are from the first value on, as those of the exact model's loop. For ``torque``
        and ``controls`` see :meth:`_control_step`.

        Returns:
            The whole decision, with sums over its control steps, the mean torque and the state at the end; the number
            of its control steps; and the last ``stored_steps`` of them.
        """
        if most == 1:
            part = self._control_step(torque, controls, True)
            return part, 1, [part]
        steps, impacts, sums = deque[ControlStep](maxlen=self.stored_steps), list[Impact](), list[float]()
        made, ended, separated = 0, False, False
        while made < most and not ended:
            part = self._control_step(torque, controls, False)
            steps.append(part)
            impacts += part.impacts
            values = [part.torque, part.impulse, part.reward, *part.terms]
            sums = list(map(add, sums, values)) if made else values
            made, struck = made + 1, bool(part.impacts)
            ended = part.terminated or ends_decision(made, separated, struck, self.repeat.max_contact_steps)
            separated = separated or not struck
        mean, impulse, reward, *terms = sums
        whole = part._replace(
            torque=mean / made, impacts=impacts, impulse=impulse, terms=terms, reward=reward,
            observation=self._model.functions.observe(part.state, part.time),
        )  # fmt: skip
        return whole, made, steps

    def _control_step(self, torque: float | None, controls: Array | None, observed: bool) -> ControlStep:
        """Make one control step under a ``torque`` [N m], an action's numbers ``controls``, (n,), or the drive."""
        simulator, functions = self._model
        if controls is not None:
            share = clipped_share(functions.share(simulator.state, controls, simulator.time, self._dt))
            torque = share * simulator.scene.torque_limit
        return functions.step_and_score(simulator, self._dt, torque, observed)

    def render(self) -> Any:
        """Return a fresh frame, uint8, shape (height, width, 3), or show it in a window ("human").

        In the mode "rgb_array_list" return, and clear, the frames of control steps since the last call or reset.
        """
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
        """
        return keys_of(self.interface.action)

    def _snapshot(self) -> Snapshot:
        """The environment as it is now, for :meth:`_restore`."""
        return Snapshot(
            self._model, self._model.simulator.snapshot(), self.elapsed_steps, self._impacts, self._past,
            self._renderer and self._renderer.snapshot(),
        )  # fmt: skip

    def _restore(self, snapshot: Snapshot) -> None:
        """Return to the moment of a :meth:`_snapshot`."""
        self._model, present, self.elapsed_steps, self._impacts, self._past, picture = snapshot
        self._model.simulator.restore(present)
        if self._renderer is not None:
            self._renderer.show(self.scene)
            self._renderer.restore(picture)

    def _torque_of(self, action: AnyAction) -> float:
        if type(action) is np.ndarray and action.shape == (1,) and action.dtype.char in "fd":
            value: float = action.item()
            if -1.0 <= value <= 1.0:  # most often
                return value * self._model.simulator.scene.torque_limit
        return float(self.interface.action.checked(action)[0, 0]) * self._model.simulator.scene.torque_limit

    def _info(self, of: ControlStep, steps: int) -> Infos:
        """The info of a decision of so many control steps."""
        state, time, torque, impacts, impulse, terms, *_ = of
        info = {
            "state": state, "time": time, "torque": torque, "impacts": len(impacts), "impulse": impulse,
            "duration": steps * self._dt,
        }  # fmt: skip
        for name, value in zip(self._terms, terms):  # noqa: B905  # strict=True takes half as long as the physics
            info[name] = value
        if self._randomize is not None and (names := self._randomize.names):
            info["scene"] = {name: getattr(self.scene, name) for name in names}
        return info

    def _pictures(self, past: Past) -> Observed:
        frames, values = self.interface.new_observations(1), np.array([self.scene.numbers])
        return past.draw(values, np.zeros(1, np.int64), frames, Threads(1))[0]  # type: ignore[no-any-return]

    def _start_pictures(self) -> None:
        if self.interface.pixels is not None:
            poses = np.tile(self._model.simulator.state[:RATES], (1, self.interface.pixels.stack, 1))
            self._past = Past(self.interface.pixels, poses)
        if self._renderer is not None:
            self._renderer.reset(self._model.simulator.state, self._model.simulator.time)
