"""The vector environment: it sequences a batch of environments, their episodes and restarts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import FunctionType
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from jackbox_env import checks as check
from jackbox_env.batches.arguments import Arguments
from jackbox_env.batches.base import Batch, Change, Flags, Floats, Outcome, Starts
from jackbox_env.env import JackInBoxEnv, Randomize
from jackbox_env.randomization import NUMBERS, Randomization
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact, contact_model
from jackbox_env.simulators.fidelity import FURTHER
from jackbox_env.states import Array, as_restored, as_start
from jackbox_env.tasks import Task, task_of

Infos = dict[str, Any]

_MOST_ENVS = 1_000_000_000
_NO_LIMIT = 10**15  # steps; float64 counts them all


class ResetPlan(NamedTuple):
    """What a reset does, checked."""

    chosen: Flags  # (N,) which environments
    seeds: list[int | None]
    changes: list[Change] | None  # of the scenes of those chosen; None: they stay, or are drawn as always
    states: Callable[[Callable[[int], Scene]], Array] | None  # (N, 12) where they start, checked against the scenes
    times: Array  # (N,) [s]


class JackInBoxVectorEnv(VectorEnv[Floats, Any, NDArray[Any]]):
    """Many jacks in boxes side by side: ``gymnasium.make_vec("JackInBox-v0", num_envs=1024, contact="exact")``.

    Environment i seeded with s + i gives, bit for bit and across its restarts, what the single environment seeded with
    s + i gives. With ``contact="exact"`` all of it (physics, observation, reward, time limit, restart) is one compiled
    loop; otherwise, or with pictures, the environments are stepped one by one.

    Args:
        num_envs: number of environments N.
        max_episode_steps: steps after which an episode is truncated; -1: never.
        autoreset_mode: when an episode that is over restarts. ``NEXT_STEP``: the step after ignores the action, returns
            the new start and reward 0. ``SAME_STEP``: the step that ends it returns the new start, and the last
            observation in ``infos["final_obs"]``. ``DISABLED``: you restart it, by ``reset`` with a ``reset_mask``. The
            enum or its name.
        num_threads: threads for the exact model; None: as many as the machine has, fewer for a small batch. Results do
            not depend on it.
        with_infos: fill the step's infos with what the single environment's info holds, as arrays.
        render_mode: None or "rgb_array"; "human" for one environment.
        contact: "pymunk" or "exact", in place of a fidelity. This and what follows means the same in the single
            environment, whose page tells more.
        substeps: engine steps of pymunk per control step; None: 4.
        scene: a :class:`Scene`, a dict of some of its fields, or a list of N of them, one for each environment.
        task: the name of one, or a :class:`Task`.
        control_dt: duration of a step [s].
        torque: "agent": the actions are torques; "chirp": the scene's drive acts whatever they are.
        fidelity: "coarse", "balanced", "fine" or "exact"; None: "balanced".
        randomize: what of the scenes is drawn anew at each reset, by each environment's own generator.
        render_size: width and height of each environment's frame [pixels].
        render_overlay: False: frames show box, jack and ruled lines alone.

    ``step`` takes actions of shape (N, 1) or (N,), or None: the scene's drive turns all boxes. ``reset`` takes a seed
    (an int, or a list of ints and None) and ``options``: "state", shape (12,) or (N, 12), "time" [s], a number or shape
    (N,), "scene", a dict of fields for all or a list of N, and "reset_mask", bool (N,), to restart some only. Returned
    arrays are never written again.

    An interruption (Ctrl-C) of ``step`` changes nothing, unless it strikes while the new states replace the old ones.
    Then the environments refuse to step until all are ``reset``.

    Raises:
        TypeError, ValueError: an argument out of its range. Calls that are refused leave all environments as they were.
        MemoryError: more environments than the machine has room for.
    """

    metadata: dict[str, Any] = {**JackInBoxEnv.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    @check.refuse_unknown("the vector environment of JackInBox-v0", {}, FURTHER)
    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int = 500,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_threads: int | None = None,
        with_infos: bool = False,
        render_mode: str | None = None,
        contact: str | None = None,
        substeps: int | None = None,
        scene: Scene | Mapping[str, Any] | Sequence[Scene | Mapping[str, Any] | None] | None = None,
        task: str | Task = "juggle",
        control_dt: float = 0.02,
        torque: str = "agent",
        fidelity: str | None = None,
        randomize: Randomize = None,
        render_size: tuple[int, int] = (512, 512),
        render_overlay: bool = True,
        **settings: Any,
    ) -> None:
        self.num_envs = check.whole("num_envs", num_envs, at_least=1, at_most=_MOST_ENVS)
        limit = _NO_LIMIT
        if not (isinstance(max_episode_steps, int | np.integer) and max_episode_steps == -1):
            limit = check.whole("max_episode_steps", max_episode_steps, at_least=1, at_most=_NO_LIMIT)
        if num_threads is not None:
            num_threads = check.whole("num_threads", num_threads, at_least=1)
        if render_mode is not None:
            check.choice("render_mode", render_mode, JackInBoxEnv.metadata["render_modes"])
        if render_mode == "human" and self.num_envs > 1:
            raise ValueError(f'render_mode must be None or "rgb_array" for several environments, got {render_mode!r}')
        self.autoreset_mode = _autoreset_mode(autoreset_mode)  # TorchRL reads it here, Gymnasium in the metadata
        self._with_infos = check.flag("with_infos", with_infos)
        self._arguments = Arguments(self.num_envs)
        scenes = self._arguments.scenes(scene)
        settings |= {
            "contact": contact, "substeps": substeps, "task": task, "control_dt": control_dt, "torque": torque,
            "fidelity": fidelity, "render_size": render_size, "render_overlay": render_overlay,
        }  # fmt: skip
        shown = render_mode if self.num_envs == 1 else None
        single = JackInBoxEnv(scene=scenes[0], **settings, render_mode=shown)  # checks them all
        single.close()
        drawn = None if randomize is None else Randomization(randomize, scenes, single.simulator_of)
        room = self.num_envs * contact_model(single.contact).room
        np.empty(room, dtype=np.uint8)  # MemoryError now, not after hours of making
        self.task, self.render_mode, self.control_dt = task, render_mode, single.control_dt
        self.torque_source = single.torque_source
        self.metadata = {**single.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._batch: Batch
        if single.contact == "exact" and render_mode is None:
            from jackbox_env.batches.exact import ExactBatch

            self._batch = ExactBatch(
                scenes, self.num_envs, task_of(task), float(control_dt), limit, self._with_infos, num_threads, drawn
            )
        else:
            from jackbox_env.batches.single import SingleBatch

            self._batch = SingleBatch(
                scenes, self.num_envs, limit, self._with_infos, drawn, render_mode=render_mode, **settings
            )
        self._randomize = drawn
        self._seeds = [-1] * self.num_envs  # -1 where none was given
        self._started = np.zeros(self.num_envs, dtype=np.bool_)  # which have been reset
        self._ready, self._waiting = False, False  # whether all have been reset; whether an episode may be over
        self._half = False  # whether a change has begun and not ended
        self.changes = 0  # steps and resets so far

    # -- the simulated systems ----------------------------------------------------------------------------------------

    @property
    def scenes(self) -> list[Scene]:
        """The scene of each environment as it holds now, every field resolved."""
        return [self.scene_of(number) for number in range(self.num_envs)]

    def scene_of(self, number: int) -> Scene:
        """The scene of the environment of that number as it holds now.

        Raises:
            TypeError, ValueError: there is none of that number.
        """
        return self._batch.scene(check.whole("number", number, at_least=0, at_most=self.num_envs - 1))

    @property
    def scene(self) -> Scene:
        """The scene of all environments.

        Raises:
            ValueError: they have different ones; read ``scenes``.
        """
        scenes = self.scenes
        if any(scene != scenes[0] for scene in scenes):
            raise ValueError("the environments have different scenes: read scenes, a list of them")
        return scenes[0]

    @property
    def states(self) -> Array:
        """A copy of all states, float64, shape (N, 12), SI units."""
        return self._batch.states

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self._batch.times

    @property
    def observations(self) -> Floats:
        """What the agents see of the present states: a fresh float32 array, shape (N, 10)."""
        seen = np.empty((self.num_envs, 10), dtype=np.float32)
        self._batch.observe(np.arange(self.num_envs), seen)
        return seen

    def set_states(self, states: ArrayLike, times: ArrayLike, chosen: Flags | None = None) -> None:
        """Put environments into states, shape (12,) or (N, 12), at times [s], a number or shape (N,).

        Their episodes go on, with the steps they have left; an episode that is over starts anew there.

        ``chosen``, bool (N,), says which; None: all. Takes what a contact model itself leaves: feet up to 1 m outside.

        Raises:
            TypeError, ValueError: unusable values; all environments stay as they were.
        """
        chosen = np.ones(self.num_envs, dtype=np.bool_) if chosen is None else self._arguments.mask("chosen", chosen)
        self._refuse_half_changed()
        placed = self._arguments.states("states", states, chosen, as_restored)(self._batch.scene)
        checked = self._arguments.times("times", times, chosen)
        self._half = True
        self._batch.place(chosen, placed, checked)
        self._half = False

    def _refuse_half_changed(self) -> None:
        """Raise RuntimeError if an interruption has left the environments half changed."""
        if self._half:
            raise RuntimeError("an interruption has left the environments half changed: reset all of them first")

    def field(self, name: str) -> Array:
        """A number of each environment's scene as it holds now, by its name in :class:`Scene`, shape (N,).

        Raises:
            TypeError, ValueError: a scene has no such number.
        """
        return self._batch.field(check.choice("name", name, (*NUMBERS, "speed_scale")))

    def impacts(self, number: int) -> list[Impact]:
        """The impacts of the last step of the environment of that number, in time order.

        None where it has been reset, by itself or by you, or put into another state since.

        Raises:
            TypeError, ValueError: there is none of that number.
        """
        return self._batch.impacts(check.whole("number", number, at_least=0, at_most=self.num_envs - 1))

    # -- Gymnasium's methods ------------------------------------------------------------------------------------------

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The environments' seeds, -1 where none was given."""
        return tuple(self._seeds)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, Infos]:
        """Start an episode in each environment, or in those of ``options["reset_mask"]``.

        Raises:
            TypeError, ValueError: an unusable seed or option; all environments stay as they were.
        """
        plan = self.check_reset(seed, options)
        if not plan.chosen.all():
            self._refuse_half_changed()
        numbers = np.flatnonzero(plan.chosen)
        seeds = [plan.seeds[number] for number in numbers.tolist()]
        starts = self._batch.draw(numbers, seeds, plan.changes, plan.states is not None)
        if plan.states is not None:
            placed = plan.states(lambda number: self._batch.scene(number, starts))
            starts = starts._replace(states=placed[numbers])
        self._half = True
        self._batch.start(starts)
        if plan.times.any():
            self._batch.place(plan.chosen, self._batch.states, plan.times)
        for number in numbers.tolist():
            seed_of = plan.seeds[number]
            self._seeds[number] = self._seeds[number] if seed_of is None else seed_of
        self._started[numbers] = True
        self._ready = bool(self._started.all())
        self.changes += 1
        self._half = False
        return self.observations, self._fresh_infos(plan.chosen) if self._with_infos else {}

    def check_reset(self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None) -> ResetPlan:
        """Check what a reset is given, and change nothing. Scenes, and states in them, are checked by the reset itself.

        Raises:
            TypeError, ValueError: an unusable seed or option.
        """
        if not isinstance(options, Mapping | None):
            raise TypeError(
                "options must be a dict of 'state', 'time', 'scene' and 'reset_mask' or None, "
                f"got {check.shown(options)}"
            )
        given = dict(options or {})
        check.known_keys("options", given, ("state", "time", "scene", "reset_mask"))
        chosen = np.ones(self.num_envs, dtype=np.bool_)
        if given.get("reset_mask") is not None:
            chosen = self._arguments.mask("options['reset_mask']", given["reset_mask"])
            if not chosen.any():
                raise ValueError("options['reset_mask'] must choose at least one environment, got none")
        times = self._arguments.times("options['time']", 0.0 if given.get("time") is None else given["time"], chosen)
        states = None
        if given.get("state") is not None:
            states = self._arguments.states("options['state']", given["state"], chosen, as_start)
        changes = None if given.get("scene") is None else self._arguments.changes(given["scene"], chosen)
        return ResetPlan(chosen, self._arguments.seeds(seed), changes, states, times)

    def step(
        self, actions: ArrayLike | Callable[[Array], ArrayLike] | None, repeat: int = 1
    ) -> tuple[Floats, Array, Flags, Flags, Infos]:
        """Advance all environments by one control step under ``actions``, shape (N, 1) or (N,), or under the drive.

        ``repeat`` holds them for so many control steps, 1 to 1,000,000, fewer where an episode ends before. Rewards are
        summed, infos are of the last of these steps, and ``infos["steps"]`` counts them, shape (N,). ``actions`` may be
        a plain function of the states, shape (N, 12): it is asked before each of these steps.

        Raises:
            TypeError, ValueError: unusable actions.
            JackLostError: a jack would leave its box, or cannot be followed.
            jackbox_env.TaskError: a reward of a task of your own is NaN or infinite.
            RuntimeError: there was no reset yet, or an interruption has left the environments half changed. After any
                other error all environments are as they were.
        """
        if not self._ready:
            raise RuntimeError("step must come after a reset of all environments, got none yet")
        self._refuse_half_changed()
        given = actions if isinstance(actions, FunctionType | None) else self._arguments.actions(actions)  # type: ignore[arg-type]
        repeat = check.whole("repeat", repeat, at_least=1, at_most=1_000_000)
        waiting = self._over() if self._waiting else None
        saved = self._batch.saved() if repeat > 1 else None
        infos: Infos = {}
        restarting = waiting
        try:
            outcome, steps = self._repeated(None if self.torque_source == "chirp" else given, repeat, waiting)
            if waiting is None and outcome.finished and self.autoreset_mode is AutoresetMode.SAME_STEP:
                infos, restarting = self._final_infos(outcome), outcome.ended
            starts = None if restarting is None else self._batch.draw(np.flatnonzero(restarting))
        except BaseException:
            if self._half:
                self._batch.restore(saved)
                self._half = False
            raise
        self._half = True
        self._batch.take(outcome.after)
        if starts is not None:
            self._restart(starts, outcome)
        self._waiting = outcome.finished > 0 and self.autoreset_mode is not AutoresetMode.SAME_STEP
        self.changes += 1
        self._half = False
        if self._with_infos:
            everyone = np.ones(self.num_envs, dtype=np.bool_)
            infos |= _marked(outcome.infos | self._drawn(everyone), everyone)
        if repeat > 1:
            infos |= _marked({"steps": steps}, np.ones(self.num_envs, dtype=np.bool_))
        return outcome.observations, outcome.rewards, outcome.terminations, outcome.truncations, infos

    def _repeated(self, actions: Any, repeat: int, waiting: Flags | None) -> tuple[Outcome, Any]:
        """Some steps under the same actions as one, all but the last taken, and how many each environment has made.

        Episodes that are over wait for what comes after.
        """

        def asked() -> Array | None:
            return self._arguments.actions(actions(self.states)) if isinstance(actions, FunctionType) else actions

        outcome = self._batch.step(asked())
        steps = 1 if waiting is None else np.where(waiting, 0, 1)
        for _ in range(1, repeat):
            self._half = True
            self._batch.take(outcome.after)
            steps = steps + np.where(self._batch.over, 0, 1)
            outcome = outcome.followed_by(self._batch.step(asked()))
        return outcome, steps

    def render(self) -> tuple[Any, ...] | None:
        """A frame of each environment, uint8, shape (height, width, 3)."""
        if self.render_mode is None:
            gym.logger.warn('render needs a render_mode, e.g. render_mode="rgb_array": there is no picture')
            return None
        return self._batch.render()

    def tiled(self, first: int = 16, size: tuple[int, int] = (128, 128)) -> NDArray[np.uint8]:
        """One picture of the ``first`` environments as they are now, row by row in a grid, uint8, shape (H, W, 3).

        It needs no ``render_mode``, so a compiled batch is shown too. Each tile is box, jack and ruled lines, drawn
        from the state. ``size`` is width and height of a tile [pixels], from 16 to 1024.

        Raises:
            TypeError, ValueError: an argument out of its range.
            gymnasium.error.DependencyNotInstalled: pygame is missing.
        """
        count = min(check.whole("first", first, at_least=1, at_most=1024), self.num_envs)
        size = check.size("size", size, at_least=16, at_most=1024)
        from jackbox_env.render.renderer import tiled

        return tiled([self.scene_of(number) for number in range(count)], self.states, self.times, size)

    def close_extras(self, **kwargs: Any) -> None:
        """Release what the renderers hold."""
        if hasattr(self, "_batch"):  # a refused construction is closed too, by older Gymnasiums
            self._batch.close()

    # -- episodes -----------------------------------------------------------------------------------------------------

    def _over(self) -> Flags | None:
        """The episodes that are over and wait, if there are any."""
        waiting = self._batch.over
        if not waiting.any():
            return None
        if self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(
                "with autoreset_mode DISABLED, reset the episodes that are over before the next step, by "
                f"options={{'reset_mask': ...}}; {int(waiting.sum())} of {self.num_envs} are over"
            )
        return waiting

    def _restart(self, starts: Starts, outcome: Outcome) -> None:
        """Begin episodes, and let ``outcome`` show their starts."""
        self._batch.start(starts)
        self._batch.observe(starts.numbers, outcome.observations)
        if self._with_infos:
            chosen = np.zeros(self.num_envs, dtype=np.bool_)
            chosen[starts.numbers] = True
            for name, values in self._fresh_infos(chosen).items():
                if name in outcome.infos:
                    outcome.infos[name][chosen] = values[chosen]

    def _fresh_infos(self, chosen: Flags) -> Infos:
        """Infos of environments that have just started: nothing has happened or been earned yet."""
        infos: Infos = {name: np.zeros(self.num_envs) for name in self._batch.info_names}
        infos["impacts"] = np.zeros(self.num_envs, dtype=np.int64)
        infos["state"] = np.where(chosen[:, None], self.states, 0.0)
        infos["time"] = np.where(chosen, self.times, 0.0)
        return _marked(infos | self._drawn(chosen), chosen)

    def _drawn(self, chosen: Flags) -> Infos:
        """What was drawn of some environments' scenes, if anything is: the values that hold now."""
        names = self._randomize.names if self._randomize else []
        return {"scene": _marked({name: self._batch.field(name) for name in names}, chosen)} if names else {}

    def _final_infos(self, outcome: Outcome) -> Infos:
        """The last observations, and infos if asked for, of the episodes that this step ended."""
        ended = outcome.ended
        last = np.full(self.num_envs, None, dtype=object)
        for number in np.flatnonzero(ended):
            last[number] = outcome.observations[number].copy()
        final: Infos = {}
        for name, values in outcome.infos.items():
            final[name] = np.zeros_like(values)
            final[name][ended] = values[ended]
        if self._with_infos:
            final |= self._drawn(ended)
        return _marked({"final_obs": last, "final_info": _marked(final, ended)}, ended)


def _marked(infos: Infos, mask: Flags) -> Infos:
    """Each info with the mask that says which environments it holds for, as Gymnasium's vector environments do."""
    marked: Infos = {}
    for name, values in infos.items():
        marked[name], marked[f"_{name}"] = values, mask.copy()
    return marked


def _autoreset_mode(given: AutoresetMode | str) -> AutoresetMode:
    if isinstance(given, AutoresetMode):
        return given
    name = check.choice("autoreset_mode", given, [mode.name for mode in AutoresetMode])
    return AutoresetMode[name]
