"""The vector environment: it sequences a batch of environments, their episodes and restarts.

A batch (``compiled_batch.py`` or ``one_by_one.py``) steps the states; this file checks arguments and decides which
episodes restart.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from jackbox_env.envs.arguments import (
    ResetPlan,
    actions_of,
    as_autoreset_mode,
    mask_of,
    plan_of,
    scenes_in,
    states_of,
    times_of,
)
from jackbox_env.envs.batch import EpisodeLimits
from jackbox_env.envs.infos import Infos, NoInfos, infos_at_end, infos_at_start, masked
from jackbox_env.envs.one_by_one import SingleBatch
from jackbox_env.envs.settings import VectorSettings
from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.model.action import EPISODE_STEPS, Action, Repeats, decisions_of
from jackbox_env.model.observation import Observation
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.randomization import NUMBERS, Randomization, Randomize
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Flags, Floats, Indices, as_restored
from jackbox_env.model.tasks import Task
from jackbox_env.simulators import Impact, contact_model
from jackbox_env.simulators.fidelity import FURTHER
from jackbox_env.tools import checks as check
from jackbox_env.tools.one_thread import ThreadNote, by_one_thread

if TYPE_CHECKING:
    from jackbox_env.envs.compiled_batch import ExactBatch

_MOST_ENVS = 1_000_000_000
_ON_CARD = {"device": 'belongs to gymnasium.make_vec("JackInBox-v0", fidelity="exact", device="cuda")'}


class JackInBoxVectorEnv(VectorSettings, VectorEnv[Floats, Any, NDArray[Any]]):  # type: ignore[misc, override]
    """Many environments stepped together, made by ``gymnasium.make_vec("JackInBox-v0", num_envs=1024)``.

    Environment i, seeded with s + i, equals the single environment with that seed, bit for bit and across restarts.
    With ``fidelity="exact"`` and no ``render_mode``, physics, rewards and restarts are one compiled loop. Otherwise the
    environments are stepped one by one.

    >>> envs = JackInBoxVectorEnv(3, fidelity="exact")
    >>> observations, infos = envs.reset(seed=0)
    >>> observations, rewards, terminated, truncated, infos = envs.step([0.5, 0.0, -0.5])
    >>> observations.shape, envs.times
    ((3, 10), array([0.02, 0.02, 0.02]))

    Args:
        num_envs: number of environments N.
        max_episode_steps: decisions (calls of ``step``), after which an episode of ``episode_steps`` is cut short.
        autoreset_mode: when a finished episode restarts: the enum, its name or its value. ``NEXT_STEP``: the next step
            ignores the action, returns the new start and reward 0. ``SAME_STEP``: the step that ends it returns the new
            start, and the last observation in ``infos["final_obs"]``. ``DISABLED``: you restart it, by ``reset`` with a
            ``reset_mask``.
        num_threads: of the exact model; None: those of the machine, fewer for a small batch. Results do not change.
        with_infos: return the single environment's info, as arrays.
        render_mode: None or "rgb_array"; "human" for one environment.
        scene: a :class:`Scene`, a dict of some of its fields, or a list of N of them, one for each environment.

    ``gymnasium.make_vec(..., device="cuda")`` makes a :class:`jackbox_env.envs.on_card.CardVectorEnv` in its place.

    The other arguments are those of :class:`JackInBoxEnv`. With ``action_repeat="bounce"`` the environments' times
    differ.

    Returned arrays are never written again. Ctrl-C in ``step``, ``reset`` or ``set_states`` leaves all environments as
    they were, or all as the whole call leaves them. While a thread is in ``step``, ``reset``, ``set_states``,
    ``impacts``, ``observations`` or ``render``, they raise RuntimeError in others.

    Raises:
        TypeError, ValueError: an argument out of its range.
        MemoryError: too many environments for the machine's memory.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        **JackInBoxEnv.metadata, "render_modes": ["human", "rgb_array"], "autoreset_mode": AutoresetMode.NEXT_STEP,
    }  # fmt: skip

    @check.refuse_unknown("the vector environment of JackInBox-v0", _ON_CARD, FURTHER)
    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
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
        observation: str | Observation | Pixels = "state",
        action: str | Action = "torque",
        action_repeat: Repeats = 1,
        episode_steps: int | None = EPISODE_STEPS,
        **settings: Any,
    ) -> None:
        num_envs = check.whole("num_envs", num_envs, at_least=1, at_most=_MOST_ENVS)
        if num_threads is not None:
            num_threads = check.whole("num_threads", num_threads, at_least=1)
        if render_mode is not None:
            check.choice("render_mode", render_mode, self.metadata["render_modes"])
        if render_mode == "human" and num_envs > 1:
            raise ValueError(f'render_mode must be None or "rgb_array" for several environments, got {render_mode!r}')
        self._mode, self._with_infos = as_autoreset_mode(autoreset_mode), check.flag("with_infos", with_infos)
        scenes = scenes_in(num_envs, scene)
        settings |= {
            "contact": contact, "substeps": substeps, "task": task, "control_dt": control_dt, "torque": torque,
            "fidelity": fidelity, "render_size": render_size, "render_overlay": render_overlay,
            "observation": observation, "action": action, "action_repeat": action_repeat,
            "episode_steps": episode_steps,
        }  # fmt: skip
        single = JackInBoxEnv(scene=scenes[0], **settings, render_mode=render_mode if num_envs == 1 else None)
        single.close()
        decisions = decisions_of(single.episode_steps, action_repeat, max_episode_steps)
        drawn = None if randomize is None else Randomization(randomize, scenes, single.simulator_of)
        # MemoryError now, not after hours of construction
        np.empty(num_envs * contact_model(single.contact).room, dtype=np.uint8)
        self._settings = {
            **single._settings, "observation": observation, "randomize": randomize, "render_mode": render_mode,
            "num_envs": num_envs, "max_episode_steps": decisions, "autoreset_mode": self._mode,
            "num_threads": num_threads, "with_infos": with_infos,
        }  # fmt: skip
        self._interface, self._driven = single.interface, torque == "chirp"
        self._terms = single.interface.task.terms if self._with_infos else None  # in infos
        shorter = decisions if max_episode_steps else None
        limits = EpisodeLimits.of(single.repeat, shorter or math.inf, single.episode_steps or math.inf)
        self.metadata = {
            **single.metadata, "render_modes": self.metadata["render_modes"], "autoreset_mode": self._mode,
        }  # fmt: skip
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._batch: ExactBatch | SingleBatch
        if single.contact == "exact" and render_mode is None:
            from jackbox_env.envs.compiled_batch import ExactBatch

            self._batch = ExactBatch(
                scenes, num_envs, single.interface, single.control_dt, single.repeat, limits, self._with_infos,
                num_threads, drawn,
            )  # fmt: skip
        else:
            self._batch = SingleBatch(
                scenes, num_envs, limits, self._with_infos, drawn, render_mode=render_mode, **settings
            )
        self._inside, self._randomize = ThreadNote(), drawn
        self._seeds = dict[int, int]()  # of the environments that one was given
        self._started = np.zeros(num_envs, dtype=np.bool_)  # which have been reset
        self._ready, self._waiting = False, False  # whether all have been reset, and an episode may be over
        self.changes = 0  # steps and resets so far

    # -- the simulated systems ----------------------------------------------------------------------------------------

    def scene_of(self, number: int) -> Scene:
        """The present scene of one environment.

        Raises:
            TypeError, ValueError: there is no such environment.
        """
        return self._batch.scene(check.whole("number", number, at_least=0, at_most=self.num_envs - 1))

    @property
    def states(self) -> Array:
        """A copy of all states, float64, shape (N, 12), SI units."""
        return self._batch.states

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self._batch.times

    @property
    @by_one_thread
    def observations(self) -> Floats:
        """The observations of the present states: a fresh array, shape (N, numbers) or (N, h, w, stack)."""
        return self._observed(np.arange(self.num_envs))

    def _observed(self, numbers: Indices) -> Floats:
        observations = self._interface.new_observations(self.num_envs)
        self._batch.observe(numbers, observations)
        return observations

    @by_one_thread
    def set_states(self, states: ArrayLike, times: ArrayLike, chosen: Flags | None = None) -> None:
        """Set states, shape (12,) or (N, 12), and times [s], a number or shape (N,).

        Episodes continue and keep their remaining steps; a finished episode starts anew. ``chosen``, bool (N,), selects
        environments; None: all. Every state of a contact model is valid, so a foot may be up to 1 m outside.

        Raises:
            TypeError, ValueError: unusable values. All environments are unchanged.
        """
        chosen = np.ones(self.num_envs, dtype=np.bool_) if chosen is None else mask_of(self.num_envs, "chosen", chosen)
        placed = states_of(self.num_envs, "states", states, chosen, as_restored)(self._batch.scene)
        self._batch.set_states(chosen, placed, times_of(self.num_envs, "times", times, chosen))

    def field(self, name: str) -> Array:
        """One field of each environment's present scene, a number, by its name in :class:`Scene`, shape (N,).

        Raises:
            TypeError, ValueError: a scene has no such number.
        """
        return self._batch.field(check.choice("name", name, (*NUMBERS, "speed_scale")))

    @by_one_thread
    def impacts(self, number: int) -> list[Impact]:
        """The last step's impacts of one environment, in time order; empty after a restart or :meth:`set_states`.

        Raises:
            TypeError, ValueError: there is no such environment.
        """
        return self._batch.impacts(check.whole("number", number, at_least=0, at_most=self.num_envs - 1))

    # -- Gymnasium's methods ------------------------------------------------------------------------------------------

    @by_one_thread
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, Infos]:
        """Start an episode in each environment, or in those of ``options["reset_mask"]``.

        Args:
            seed: s for the seeds s + i, or a list of ints and None.
            options: "state", shape (12,) or (N, 12), "time" [s], a number or shape (N,), "scene", a dict of fields for
                all or a list of N, and "reset_mask", bool (N,), to restart only some.

        Raises:
            TypeError, ValueError: an unusable seed or option. All environments are unchanged.
        """
        plan = self.check_reset(seed, options)
        numbers = np.flatnonzero(plan.chosen)
        seeds = [plan.seeds[number] for number in numbers.tolist()]
        starts = self._batch.draw(numbers, seeds, plan.changes, plan.states is not None)
        if plan.states is not None:
            placed = plan.states(lambda number: self._batch.scene(number, starts))
            starts = starts._replace(states=placed[numbers])
        observations = self._observed(np.flatnonzero(~plan.chosen))
        after: Any = self._batch.prepare_starts(starts._replace(times=plan.times[numbers]), observations)
        new = {number: seed for number, seed in zip(numbers.tolist(), seeds, strict=True) if seed is not None}
        self.changes += 1
        self._batch.commit(after)
        self._seeds, self._started = self._seeds | new, self._started | plan.chosen
        self._ready = bool(self._started.all())
        infos = masked(infos_at_start(self._terms, self._batch, plan.chosen) | self._drawn(plan.chosen), plan.chosen)
        return observations, infos if self._with_infos else NoInfos(infos)

    def check_reset(self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None) -> ResetPlan:
        """Check a reset's arguments without changing anything. The reset itself checks scenes, and states in them.

        Raises:
            TypeError, ValueError: an unusable seed or option.
        """
        return plan_of(self.num_envs, seed, options)

    @by_one_thread
    def step(self, actions: ArrayLike | None) -> tuple[Floats, Array, Flags, Flags, Infos]:
        """Make a decision in each environment under ``actions``, shape (N, n) or (N,), or under the drive if None.

        Raises:
            TypeError, ValueError: unusable actions.
            JackLostError: a jack would leave its box, or cannot be followed.
            jackbox_env.TaskError: as in the single environment, whose number it names.
            RuntimeError: no reset yet. Errors change nothing.
        """
        if not self._ready:
            raise RuntimeError("step must come after a reset of all environments, got none yet")
        waiting = self._waiting_episodes() if self._waiting else None
        checked = None
        if not (actions is None or self._driven):
            checked = actions_of(len(self._started), self._interface.action, actions, waiting)  # faster than num_envs
        infos: Infos = {} if self._with_infos else NoInfos()
        outcome, restarting = self._batch.prepare_step(checked), waiting
        if waiting is None and outcome.finished and self._mode is AutoresetMode.SAME_STEP:
            infos |= infos_at_end(outcome, self._drawn(outcome.ended))
            restarting = outcome.ended
        after = outcome.after
        if restarting is not None:
            starts = self._batch.draw(np.flatnonzero(restarting))
            after = self._batch.prepare_starts(starts, outcome.observations, after)
        self._waiting = waiting is not None or (outcome.finished > 0 and self._mode is not AutoresetMode.SAME_STEP)
        self.changes += 1
        self._batch.commit(after)
        if restarting is not None:
            starting = infos_at_start(self._terms, self._batch, restarting)
            for name in starting.keys() & outcome.infos.keys():
                outcome.infos[name][restarting] = starting[name][restarting]
        infos |= masked(outcome.infos | self._drawn(self._started), self._started)
        return outcome.observations, outcome.rewards, outcome.terminations, outcome.truncations, infos

    @by_one_thread
    def render(self) -> tuple[Any, ...] | None:
        """A frame of each environment, uint8, shape (height, width, 3)."""
        if self.render_mode is None:
            gym.logger.warn('render needs a render_mode, e.g. render_mode="rgb_array": there is no picture')
            return None
        assert isinstance(self._batch, SingleBatch)
        return self._batch.render()

    def tiled(self, first: int = 16, size: tuple[int, int] = (128, 128)) -> NDArray[np.uint8]:
        """One picture of the ``first`` environments, row by row in a grid, uint8, shape (H, W, 3).

        It needs no ``render_mode``. ``size`` is width and height of a tile [pixels], from 16 to 1024.

        Raises:
            TypeError, ValueError: an argument out of its range.
            gymnasium.error.DependencyNotInstalled: pygame is missing, which draws tiles from 400 pixels up.
        """
        count = min(check.whole("first", first, at_least=1, at_most=1024), self.num_envs)
        size = check.size("size", size, at_least=16, at_most=1024)
        from jackbox_env.render.renderer import tiled

        return tiled([self.scene_of(number) for number in range(count)], self.states, self.times, size)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of this object; a setting, the scene or the states raise AttributeError with the remedy."""
        setattr(self, name, values)

    def close_extras(self, **kwargs: Any) -> None:
        """Close the renderers."""
        batch = getattr(self, "_batch", None)  # a refused construction is closed too, by older Gymnasiums
        if isinstance(batch, SingleBatch):
            batch.close()

    # -- episodes -----------------------------------------------------------------------------------------------------

    def _waiting_episodes(self) -> Flags | None:
        """The finished episodes that wait; None if there are none."""
        waiting = self._batch.ended
        if not waiting.any():
            return None
        if self._mode is AutoresetMode.DISABLED:
            how = "reset the episodes that are over before the next step, by options={'reset_mask': ...}"
            over = f"{int(waiting.sum())} of {self.num_envs} are over"
            raise RuntimeError(f"with autoreset_mode DISABLED, {how}; {over}")
        return waiting

    def _drawn(self, chosen: Flags) -> Infos:
        """The present values of the randomized fields of some environments' scenes; empty without any or infos."""
        names = self._randomize.names if self._randomize and self._with_infos else []
        return {"scene": masked({name: self._batch.field(name) for name in names}, chosen)} if names else {}
