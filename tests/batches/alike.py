"""Every kind of environment gets the same calls and must do the same, bit for bit.

``Alike`` has two batches with different numbers of threads, environments of Stable-Baselines3, and single environments
for some rows. After each call it compares all that they return and all that a user can read.
"""

from __future__ import annotations

import contextlib
import copy
import math
import pickle
import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any
from unittest.mock import ANY

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import Chirp, JackInBoxEnv, JackInBoxVectorEnv, JackLostError, Scene
from tests.batches.drawn import USERS
from tests.batches.several import assert_same
from tests.invariants.cases import draw_start

DEFAULTS: dict[str, Any] = {
    "control_dt": 0.02, "render_mode": None, "torque": "agent", "randomize": None, "task": "juggle",
    "observation": "state", "action": "torque",
}  # fmt: skip
make_sb3_vec_env: Any = None
with contextlib.suppress(ImportError):  # the others are compared where Stable-Baselines3 is missing
    from jackbox_env.sb3 import make_sb3_vec_env


class Row:
    """A single environment with a limit of decisions, which restarts as a row of a batch does."""

    def __init__(self, env: JackInBoxEnv, limit: int | None, mode: AutoresetMode, with_infos: bool) -> None:
        self.env, self.limit, self.mode, self.with_infos = env, limit, mode, with_infos
        self.made, self.earned, self.over = 0, 0.0, False
        self.begun, self.listed = dict[str, Any](), dict[str, Any]()  # infos for Stable-Baselines3: of the start; now

    def shown(self, info: dict[str, Any]) -> dict[str, Any]:
        """What a batch shows of an info."""
        return info if self.with_infos else {"duration": info["duration"]}

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self.made, self.earned, self.over, self.begun = 0, 0.0, False, self.shown(info)
        return observation, self.begun

    def set_state(self, state: Any, time: float) -> None:
        self.env.set_state(state, time, 0 if self.over else None)
        if self.over:
            self.made, self.over = 0, False

    def step(self, action: Any) -> tuple[Any, ...]:
        """What a batch returns for this row, the infos of the ended episode in its info."""
        if self.over:
            observation, info = self.reset()
            return observation, 0.0, False, False, info
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.made, self.earned = self.made + 1, self.earned + reward
        truncated = truncated or self.made == self.limit
        self.over, info = terminated or truncated, self.shown(info)
        in_time = {"TimeLimit.truncated": truncated and not terminated} if self.with_infos or self.over else {}
        self.listed = info | in_time
        if self.over and self.mode is AutoresetMode.SAME_STEP:
            episode = {"r": round(self.earned, 6), "l": self.made, "t": ANY}
            self.listed |= {"episode": episode, "terminal_observation": observation}
            ended = {"final_obs": observation, "final_info": info}
            observation, info = self.reset()
            info = info | ended
        return observation, reward, terminated, truncated, info

    def restore_in(self, fresh: JackInBoxEnv) -> None:
        """Go on with an environment that gets scene, state, time, generator and the episode's steps, nothing else."""
        scene = {field.name: getattr(self.env.scene, field.name) for field in fields(Scene)}
        fresh.reset(seed=0, options={"scene": scene})
        fresh.set_state(self.env.state, self.env.time, self.env.elapsed_steps)
        fresh.np_random, self.env = copy.deepcopy(self.env.np_random), fresh


def overwrite(handed: Any) -> None:
    """Write into all arrays and dicts, which belong to the caller."""
    if isinstance(handed, np.ndarray) and handed.dtype != object:
        handed[...] = 7
    elif np.iterable(handed) and not isinstance(handed, str):
        for part in [*handed.values()] if isinstance(handed, dict) else handed:
            overwrite(part)
    if isinstance(handed, dict):
        handed["overwritten"] = 7


def at(infos: dict[str, Any], number: int) -> dict[str, Any]:
    """The infos that are valid for an environment, by their masks."""
    return {
        name: at(values, number) if isinstance(values, dict) else values[number]
        for name, values in infos.items()
        if name[0] != "_" and infos[f"_{name}"][number]
    }


class Alike:
    """Environments of all kinds; those of its methods that draw are calls that all of them get.

    Args:
        shared: arguments of each kind.
        scenes: one for all, or some that take turns.
        count: environments.
        rows: those that are compared with single environments; those beyond the last one are ignored.
        mode: when episodes restart.
        limit: decisions of an episode; -1: no limit.
        threads: of each of the two batches.
        with_infos: whether they return all infos.

    Raises:
        ValueError: pymunk refuses a scene.
    """

    def __init__(
        self,
        shared: dict[str, Any],
        scenes: Sequence[Scene],
        count: int,
        rows: Sequence[int],
        mode: AutoresetMode = AutoresetMode.SAME_STEP,
        limit: int | None = None,
        threads: Sequence[int | None] = (None, 2),
        with_infos: bool = True,
    ) -> None:
        self.shared, self.count, self.mode = DEFAULTS | shared, count, mode
        self.scenes = [scenes[number % len(scenes)] for number in range(count)]
        made = {"scene": self.scenes, "with_infos": with_infos, **shared}
        self.batches = [JackInBoxVectorEnv(count, limit, mode, num_threads=number, **made) for number in threads]
        self.rows = {row: Row(self.single(row), limit, mode, with_infos) for row in sorted({*rows}) if row < count}
        self.stable: Any = None
        # With options, Stable-Baselines3 starts environments one by one, each time in a copy of all.
        if mode is AutoresetMode.SAME_STEP and count <= 5 and make_sb3_vec_env is not None:
            self.stable = make_sb3_vec_env(count, max_episode_steps=limit, **made)
        self.several = [*self.batches, *([self.stable] if self.stable else [])]
        self.driven = self.shared["torque"] == "chirp"
        self.over, self.lost = np.zeros(count, dtype=np.bool_), False  # episodes that wait; whether a jack is lost
        self.handed: Any = ()  # by the last call
        self.copied: Any = ()
        self.counts = Counter[str]()

    def single(self, number: int) -> JackInBoxEnv:
        """One that is driven by None if the others are by torque="chirp"."""
        return JackInBoxEnv(**{**self.shared, "scene": self.scenes[number], "torque": "agent"})

    def returned(self, results: list[Any]) -> None:
        """Check that no call wrote into what the last one returned, and overwrite that."""
        assert_same(self.handed, self.copied, "returned before")
        overwrite(self.handed)
        self.handed, self.copied = results, copy.deepcopy(results)

    def compare(self) -> None:
        """Compare what can be read."""
        first, last = self.batches
        read = first.states, first.times, first.observations
        assert_same((last.states, last.times, last.observations), read, "batches")
        frames = first.render() if first.render_mode else None
        images = self.stable.get_images() if frames and self.stable else frames
        for number, row in self.rows.items():
            env, path = row.env, f"environment {number}"
            assert_same([part[number] for part in read], [env.state, env.time, env.observation], path)
            assert_same((first.scene_of(number), first.impacts(number)), (env.scene, env.impacts), path)
            if frames and images:
                assert_same([frames[number], images[number]], [env.render()] * 2, path)

    # -- steps ---------------------------------------------------------------------------------------------------------

    def actions(self, draw: random.Random) -> Any:
        """Actions in and out of a Box, or of a Discrete; if the drive ignores them, NaN."""
        space: Any = self.batches[0].single_action_space
        rng = np.random.default_rng(draw.randint(0, 2**32))
        if isinstance(space, gym.spaces.Discrete):
            return rng.integers(0, space.n, self.count)
        return rng.uniform(-1.3, 1.3, (self.count, *space.shape)).astype(np.float32) * (math.nan if self.driven else 1)

    def step(self, draw: random.Random) -> None:
        """A decision; before it the episodes that are over start anew, if they do not by themselves."""
        actions = self.actions(draw)
        if self.mode is AutoresetMode.DISABLED and self.over.any():
            with pytest.raises(RuntimeError, match=f"DISABLED.* {self.over.sum()} of {self.count} are over"):
                self.batches[0].step(actions)
            self.reset_some(self.over)
        actions = draw.choice((actions, actions, actions, None))
        alone = [None] * self.count if actions is None or self.driven else actions
        before, passed = self.batches[0].states, copy.copy(actions)
        try:
            results = [env.step(passed) for env in self.several]
        except JackLostError:
            assert_same(self.batches[0].states, before, "states after a lost jack")
            self.lose(actions, alone)
            return
        self.returned(results)
        overwrite(passed)
        assert_same(results[1], results[0], "batches")
        observations, rewards, terminations, truncations, infos = results[0]
        self.over = terminations | truncations
        for listed in results[2:]:
            assert_same(list(listed[:3]), [observations, rewards.astype(np.float32), self.over], "Stable-Baselines3")
        for number, row in self.rows.items():
            expected, path = row.step(alone[number]), f"environment {number}"
            assert_same((*[part[number] for part in results[0][:4]], at(infos, number)), expected, path)
            self.counts.update({f"ends {expected[2]} {expected[3]}": 1, "impacts": len(row.env.impacts)})
            for listed in results[2:]:
                infos_of_stable = listed[3][number], self.stable.reset_infos[number]
                assert_same(infos_of_stable, (row.listed, row.begun), f"{path} of Stable-Baselines3")

    def lose(self, actions: Any, alone: Any) -> None:
        """All kinds refuse a step in which a jack is lost."""
        self.lost = True
        for env in self.several:
            with pytest.raises(JackLostError):
                env.step(actions)
        if len(self.rows) == self.count:
            with pytest.raises(JackLostError):
                [row.step(alone[number]) for number, row in self.rows.items()]

    # -- resets --------------------------------------------------------------------------------------------------------

    def reset(self, draw: random.Random) -> None:
        """Of all or some, with all kinds of seeds and options."""
        chance = random.Random(draw.randint(0, 2**32))
        chosen, options = np.ones(self.count, dtype=np.bool_), dict[str, Any]()
        seed: Any = draw.choice((None, draw.randint(0, 2**64)))
        if not self.stable and draw.choice((True, False)):
            chosen[:-1] = [chance.random() < 0.5 for _ in range(self.count - 1)]
            seed = [chance.choice((None, number, 2**70)) for number in range(self.count)]
        if draw.choice((True, False, False)):
            options["scene"] = draw.choice((self.changes(chance), [self.changes(chance) for _ in range(self.count)]))
        if draw.choice((True, False)):
            one = self.scenes == self.scenes[:1] * self.count and draw.choice((True, False))
            options["state"] = self.states(chance)[0 if one else slice(None)]
        if draw.choice((True, False)):
            options["time"] = draw.choice((0.5, [chance.uniform(-5.0, 5.0) for _ in range(self.count)]))
        self.reset_some(chosen, seed, options)

    def changes(self, chance: random.Random) -> dict[str, Any]:
        """Fields of a scene in which every start of the original ones fits."""
        first, length = self.scenes[0], max(scene.box_half_width for scene in self.scenes)
        return chance.choice([
            {}, {"gravity": 0.5 * first.gravity}, {"drive": None}, {"restitution": 0.5, "box_half_width": 1.5 * length},
            {"drive": Chirp(0.3 * first.torque_limit, 0.1 / self.shared["control_dt"], 0.0)},
        ])  # fmt: skip

    def states(self, chance: random.Random) -> Any:
        """A start for each environment."""
        return np.array([draw_start(chance, scene, self.shared["control_dt"]) for scene in self.scenes])

    def reset_some(self, chosen: Any, seed: Any = None, options: dict[str, Any] | None = None) -> None:
        """Reset the chosen environments by the seed and options of a batch."""
        options, numbers = options or {}, range(self.count)
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + number for number in numbers]
        listed = {name for name, value in options.items() if isinstance(value, list) or np.ndim(value) == 2}
        each: list[dict[str, Any]] = [
            {name: value[number] if name in listed else value for name, value in options.items()} for number in numbers
        ]
        passed = copy.deepcopy(options if chosen.all() else {**options, "reset_mask": chosen})
        results = [batch.reset(seed=seed, options=passed) for batch in self.batches]
        self.returned(results)
        overwrite(passed)
        observations, infos = results[0]
        assert_same(results[1], results[0], "batches")
        if self.stable:
            self.stable.seed(seed) if seed is not None else None
            self.stable.set_options(copy.deepcopy(each))
            assert_same(self.stable.reset(), observations, "Stable-Baselines3")
        for number, row in self.rows.items():
            info, path = dict[str, Any](), f"environment {number}"
            if chosen[number]:
                info = self.reset_row(number, seeds[number], each[number])
            assert_same((observations[number], at(infos, number)), (row.env.observation, info), path)
            if self.stable:
                assert_same(self.stable.reset_infos[number], info, f"{path} of Stable-Baselines3")
        self.over &= ~chosen

    def reset_row(self, number: int, seed: int | None, options: dict[str, Any]) -> dict[str, Any]:
        """Reset a single environment, which does what the options say. Returns its info."""
        env, scene, drawn = self.rows[number].env, self.scenes[number], self.shared["randomize"]
        before, twin = (env.scene, env.np_random.bit_generator.state), env
        if drawn and "scene" in options:
            twin = copy.deepcopy(env)
            twin.reset(seed=seed)
            scene = twin.scene
        _, info = self.rows[number].reset(seed, options or None)
        if "scene" in options:  # in place of what is drawn, which does not depend on it
            assert env.scene == scene.changed(**options["scene"])
        elif isinstance(drawn, dict):
            assert env.scene == scene.changed(**{name: getattr(env.scene, name) for name in drawn})
        assert drawn or "scene" in options or env.scene == before[0]
        assert env.time == options.get("time", 0.0)
        if "state" in options:
            assert_same(env.state, np.array(options["state"]), "the option's state")
            assert drawn or seed is not None or env.np_random.bit_generator.state == before[1]  # nothing is drawn
        return info

    # -- states that are put back --------------------------------------------------------------------------------------

    def set_states(self, draw: random.Random) -> None:
        """States of some environments; in batches of the exact model some are far off, spin, or have turned often."""
        chance = random.Random(draw.randint(0, 2**32))
        chosen, states = np.array([chance.random() < 0.7 for _ in range(self.count)]), self.states(chance)
        for state in states if self.shared["contact"] == "exact" else ():
            kind = chance.choice((*range(12), "far", "spinning", "turned"))
            state[[0, 3]] += 5e7 * self.scenes[0].box_half_width * (kind == "far")
            state[11] += 6.0 / self.shared["control_dt"] * (kind == "spinning")
            state[[2, 5]] += 1e6 * math.tau * (kind == "turned")
        times = np.array([chance.choice((0.0, 1.7, 25.0)) for _ in range(self.count)]) * draw.choice((0.0, 1.0))
        for batch in self.batches:
            batch.set_states(states, times, chosen)
        for number in np.flatnonzero(chosen).tolist():
            if self.stable:
                self.stable.env_method("set_state", states[number], times[number], indices=[number])
            if number in self.rows:
                self.rows[number].set_state(states[number], times[number].item())
        self.over &= ~chosen

    def duplicate(self, draw: random.Random) -> None:
        """A copy of a batch goes on beside it, and a copy of each single environment in its place."""
        users = any(self.shared[name] in USERS for name in ("task", "observation", "action"))
        pickled = draw.choice((*[False] * (20 if users else 1), True))  # then functions are compiled again, for seconds
        whole = self.batches[0], [row.env for row in self.rows.values()]
        self.batches[1], envs = pickle.loads(pickle.dumps(whole)) if pickled else copy.deepcopy(whole)
        self.several[1] = self.batches[1]
        for row, env in zip(self.rows.values(), envs, strict=True):
            row.env = env

    def restore(self, draw: random.Random) -> None:
        """Scene, state and time are all that single environments need, if no picture shows the steps before."""
        if not self.shared["render_mode"] and self.rows[0].env.interface.pixels is None:
            for number, row in self.rows.items():
                row.restore_in(self.single(number))
        self.step(draw)


CALLS: Sequence[Callable[[Alike, random.Random], None]] = (
    *[Alike.step] * 8, Alike.reset, Alike.reset, Alike.set_states, Alike.duplicate, Alike.restore,
)  # fmt: skip


def play(alike: Alike, draw: random.Random, calls: int) -> Counter[str]:
    """Make calls of all kinds; count them, and what happens in them."""
    alike.reset_some(np.ones(alike.count, dtype=np.bool_), draw.randint(0, 1000))
    for _ in range(calls):
        if not alike.lost:
            call = draw.choice(CALLS)
            call(alike, draw)
            alike.counts[call.__name__] += 1
            alike.compare()
    alike.counts["lost"] += alike.lost
    return alike.counts
