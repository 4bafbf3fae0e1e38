"""The vector environment on a GPU: ``gymnasium.make_vec("JackInBox-v0", 65536, fidelity="exact", device="cuda")``.

One thread makes the decision of one environment, by ``gpu/decision.py``. What a GPU does not compute, such as feet at
rest, the CPU does, from the same numbers and with the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import ArrayLike

from jackbox_env.envs.arguments import actions_of, options_of, seeds_of, states_of, times_of
from jackbox_env.envs.compiled_batch import ExactBatch
from jackbox_env.envs.repeated_step import RepeatedStep
from jackbox_env.envs.scene_table import SceneTable
from jackbox_env.envs.settings import ReadOnly, VectorSettings
from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.exact import pcg64, run
from jackbox_env.exact.step import CONSTANT
from jackbox_env.exact.threads import Halt, run_blocks
from jackbox_env.exact.workspace import (
    CONTROL_SHARES,
    DECISIONS,
    HEIGHT,
    OVER,
    STEPS,
    TIME,
    Call,
    Results,
    Scenes,
    Status,
    new_memory,
)
from jackbox_env.gpu import decision, ptx
from jackbox_env.jit.compiler import compiled, kinds_of
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import as_restored
from jackbox_env.planning.card import checked
from jackbox_env.simulators.exact import NO_PIECES
from jackbox_env.simulators.plain_functions import Interface
from jackbox_env.simulators.users_functions import functions_together, name_of
from jackbox_env.tools import checks as check
from jackbox_env.tools.one_thread import ThreadNote, by_one_thread

Tensor = Any  # of PyTorch, which is imported when an environment is made
_NOTHING = (0,) * 25  # words of the memory of ``exact.workspace.Arguments``, which each thread has itself


class CardVectorEnv(VectorSettings, VectorEnv[Tensor, Any, Tensor]):  # type: ignore[misc, override]
    """Environments on a GPU, with tensors in place of arrays: the bits of :class:`.JackInBoxVectorEnv`.

    Observations and actions need + - * / and square roots alone, as "state", "landing", "torque" and "discrete" do.
    There are no ``impacts``, ``observations``, ``field`` or pictures, no options of ``reset``, no ``set_states`` of
    some, and no copies; what :func:`refuse` lists is refused.

    Args:
        num_envs: number of environments N.
        device: "cuda", the present GPU.
        settings: the other arguments of :class:`.JackInBoxVectorEnv`, with ``fidelity="exact"``.

    Raises:
        TypeError, ValueError: an argument out of its range, or that only environments on the CPU have.
        RuntimeError: there is no GPU or driver.
    """

    device = ReadOnly()

    def __init__(self, num_envs: int = 1, *, device: str = "cuda", **settings: Any) -> None:
        checked(device)
        with check.extra('device="cuda"', "PyTorch", "gpu"):
            from jackbox_env.gpu import device as card
        card.require()  # before what takes a minute
        self._card: Any = card
        cpu = JackInBoxVectorEnv(num_envs, **settings)
        refuse(cpu)
        batch = cpu._batch
        assert isinstance(batch, ExactBatch)
        self._settings = {**cpu._settings, "device": device}
        self.metadata = cpu.metadata
        self.single_observation_space, self.single_action_space = cpu.single_observation_space, cpu.single_action_space
        self.observation_space, self.action_space = cpu.observation_space, cpu.action_space
        self.interface, self._batch, self._mode = cpu._interface, batch, cpu.autoreset_mode
        self._decide, self._begin = (card.launcher(code) for code in codes_of(self.interface))
        self._rules = batch._rules._replace(score=0, observe=0, act=0, patience=np.inf)
        scenes = batch._present.scenes.originals
        table = SceneTable(scenes, cpu.randomize is not None, (num_envs, HEIGHT, 1), num_envs, self._rules.dt)
        self._table, self._one_scene = table, not table.several
        self._values, self._scene_params = self._tensor(table.values), self._tensor(table.scene_params)
        drawn = batch._randomize
        self._ranges = self._tensor(drawn.table if drawn else np.zeros((0, 3)))
        self._derived = self._tensor(np.array([drawn.derived(scenes[0])] if drawn else [], np.bool_).reshape(-1, 2))
        self._words = self._tensor(pcg64.fresh(num_envs).view(np.int64))
        self._blocks = self._tensor(np.zeros((num_envs, HEIGHT, 1)))
        self._numbers = self._tensor(np.arange(num_envs))
        self._kinds = self._tensor(np.full(len(table.values), CONSTANT))
        space: Any = self.single_action_space
        ends = (space.low, space.high) if self.interface.action.size else ([0.0], [space.n - 1.0])
        self._bounds = [self._tensor(np.array(one, np.float64)) for one in ends]
        self._ready, self._seeds, self._inside = False, dict[int, int](), ThreadNote()

    def _tensor(self, array: Any) -> Tensor:
        return self._card.torch.from_numpy(np.array(array, order="C")).to(self._card.PLACE)

    # -- the simulated systems ----------------------------------------------------------------------------------------

    @property
    def states(self) -> Tensor:
        """A copy of all states, float64, shape (N, 12), SI units."""
        return self._blocks[:, :12, 0].clone()

    @property
    def times(self) -> Tensor:
        """A copy of all times [s], shape (N,)."""
        return self._blocks[:, TIME, 0].clone()

    def scene_of(self, number: int) -> Scene:
        """The present scene of one environment.

        Raises:
            TypeError, ValueError: there is no such environment.
        """
        number = check.whole("number", number, at_least=0, at_most=self.num_envs - 1)
        return self._table.scene_of(number, self._values[self._row(number)][0].cpu().numpy())

    def _as_tensor(self, numbers: Any) -> Tensor | None:
        """A tensor of any library, by DLPack; None if it is none, or needs gradients."""
        if isinstance(numbers, np.ndarray) or not hasattr(numbers, "__dlpack__"):
            return None
        return None if getattr(numbers, "requires_grad", False) else self._card.torch.from_dlpack(numbers)

    def _on_host(self, numbers: Any) -> Any:
        """A tensor as an array in the machine's memory; anything else as it is."""
        tensor = self._as_tensor(numbers)
        if tensor is None:
            return numbers
        return (tensor.double() if tensor.is_floating_point() else tensor).cpu().numpy()

    def _row(self, number: int) -> slice:
        """The row of an environment's scene."""
        return slice(None) if self._one_scene else slice(number, number + 1)

    @by_one_thread
    def set_states(self, states: ArrayLike, times: ArrayLike) -> None:
        """Set all states, shape (12,) or (N, 12), and times [s], a number or shape (N,), as on the CPU.

        Raises:
            TypeError, ValueError: unusable values. All environments are unchanged.
        """
        every, blocks = np.ones(self.num_envs, np.bool_), self._blocks.clone()
        placed = states_of(self.num_envs, "states", self._on_host(states), every, as_restored)(self.scene_of)
        blocks[:, TIME, 0] = self._tensor(times_of(self.num_envs, "times", self._on_host(times), every))
        blocks[:, :12, 0] = self._tensor(placed)
        for row in (STEPS, DECISIONS, OVER):
            blocks[blocks[:, OVER, 0] != 0.0, row] = 0.0
        self._blocks = blocks

    # -- Gymnasium's methods ------------------------------------------------------------------------------------------

    @by_one_thread
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """Start an episode in each environment.

        Args:
            seed: s for the seeds s + i, or a list of ints and None.
            options: none.

        Raises:
            TypeError, ValueError: an unusable seed or option. All environments are unchanged.
        """
        names = ("state", "time", "scene", "reset_mask")
        given = [name for name, one in options_of(options, names).items() if one is not None]
        if given:
            raise ValueError(f'device="cuda" has no options of reset, got {" and ".join(given)}')
        seeds, words = seeds_of(self.num_envs, seed), self._words.cpu().numpy().copy().view(np.uint64)
        new = {number: one for number, one in enumerate(seeds) if one is not None}
        for number, one in new.items():
            words[number] = pcg64.seeded(one)
        observations = self._new(len(self.interface.observation.names), kind="float32")
        chosen = self._new(kind="bool").fill_(True)
        begun = self._begun(chosen, self._tensor(words.view(np.int64)), self._new(HEIGHT, 1), observations)
        self._commit(begun, self._seeds | new)
        return observations, {"duration": self._new(), "_duration": chosen}

    @by_one_thread
    def step(self, actions: Any) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Make a decision in each environment under ``actions``, of any library with DLPack, shape (N, n) or (N,).

        ``infos["left_to_cpu"]`` has the number of environments that the CPU has stepped.

        Raises:
            TypeError, ValueError, JackLostError, jackbox_env.TaskError, RuntimeError: as on the CPU. If several
                environments fail, another may be named.
        """
        if not self._ready:
            raise RuntimeError("step must come after a reset of all environments, got none yet")
        waiting = self._blocks[:, OVER, 0] != 0.0
        controls = self._controls(actions, waiting)
        several = self._rules.steps > 1
        before, after = self._blocks.clone() if several else self._blocks, self._new(HEIGHT, 1)
        filled = self._results(self.num_envs, several)
        left = self._played(before, after, controls, filled)
        after = after if self._rules.steps & 1 else before
        made = after[:, STEPS, 0] - self._blocks[:, STEPS, 0]
        durations = (made if several else (~waiting).double()) * self._rules.dt
        ended = filled.terminations | filled.truncations
        infos: dict[str, Any] = {"duration": durations, "_duration": ended | True, "left_to_cpu": left}
        restarting = waiting
        if self._mode is AutoresetMode.SAME_STEP and bool(ended.any()):
            final = {"duration": durations * ended, "_duration": ended.clone()}
            infos |= {"final_obs": filled.observations.clone(), "_final_obs": ended.clone(), "final_info": final}
            infos |= {"_final_info": ended, "duration": durations * ~ended}
            restarting = ended
        self._commit(self._begun(restarting, self._words.clone(), after, filled.observations), self._seeds)
        rewards = filled.returns if several else filled.rewards[0]
        return filled.observations, rewards, filled.terminations, filled.truncations, infos

    # -- kernels ------------------------------------------------------------------------------------------------------

    def _new(self, *shape: int, kind: str = "float64") -> Tensor:
        """Zeros for each environment."""
        torch = self._card.torch
        return torch.zeros((self.num_envs, *shape), dtype=getattr(torch, kind), device=self._card.PLACE)

    def _results(self, count: int, several: bool) -> Any:
        """Tensors for a step of so many environments, as ``workspace.Results``; ``several``: control steps."""
        torch = self._card.torch
        kinds = {np.float64: torch.float64, np.float32: torch.float32, np.bool_: torch.bool, np.int64: torch.int64}
        shapes = {
            "observations": (count, len(self.interface.observation.names)), "rewards": (1, count),
            "returns": (count * several,), "terminations": (count,), "truncations": (count,),
        }  # fmt: skip
        return Results(
            *(
                torch.zeros(shapes.get(name, empty.shape), dtype=kinds[empty.dtype.type], device=self._card.PLACE)
                for name, empty in Results()._asdict().items()
            )
        )

    def _controls(self, actions: Any, waiting: Tensor) -> Tensor:
        """Actions as float64, shape (n, N), contiguous, checked as on the CPU; tensors on the GPU do not leave it."""
        action, count = self.interface.action, self.num_envs
        tensor = self._as_tensor(actions)
        if tensor is not None:
            shaped = tensor.shape == (count, max(action.size, 1)) or (action.size < 2 and tensor.shape == (count,))
            whole = not (tensor.is_floating_point() or tensor.is_complex() or tensor.dtype is self._card.torch.bool)
            if shaped and (tensor.is_floating_point() if action.size else whole):
                values = tensor.to(self._card.PLACE, self._values.dtype).reshape(count, -1)
                if self._rules.controls == CONTROL_SHARES:
                    return values.T.contiguous()
                clipped = values.clamp(*self._bounds)
                usable = values.isfinite() if action.size else values == clipped
                if bool((usable.all(dim=1) | waiting).all()):
                    return clipped.T.contiguous()
        return self._tensor(actions_of(count, action, self._on_host(actions), waiting.cpu().numpy()))

    def _played(self, before: Tensor, after: Tensor, controls: Tensor, filled: Any) -> int:
        """Fill in ``after`` or ``before``, and results; return the number of environments that the CPU has stepped."""
        ended, made = self._new(kind="int64"), self._new(kind="int64")
        none, no_counts = self._tensor(np.zeros((0, NO_PIECES[0].shape[1]))), self._tensor(np.zeros(0, np.int64))
        scenes = self._values, self._scene_params, self._kinds, none, no_counts, no_counts
        words = self._card.words_of_call(
            ended, made, *scenes, *self._rules, before, after, controls, *filled, *_NOTHING
        ).to(self._card.PLACE)
        self._decide(words.data_ptr(), self.num_envs)
        left = (ended == Status.UNCOMPILED.value).nonzero()[:, 0]
        failed = ((ended != Status.DONE.value) & (ended != Status.UNCOMPILED.value)).nonzero()[:, 0]
        failures = list(zip(made[failed].tolist(), failed.tolist(), ended[failed].tolist(), strict=True))
        if len(left):
            failures += self._by_cpu(left, after if self._rules.steps & 1 else before, controls, filled)
        if failures:
            made_steps, number, status = min(failures)
            row = self._blocks[number, :, 0].cpu().numpy()
            step = RepeatedStep(
                number, self.scene_of(number), self.interface, self._rules.dt, row, controls[:, number].cpu().numpy()
            )
            raise step.failure(status, made_steps, filled.observations.cpu().numpy())
        return len(left)

    def _by_cpu(self, rows: Tensor, result: Tensor, controls: Tensor, filled: Any) -> list[tuple[int, int, int]]:
        """Step rows by the CPU into the blocks of the result; return failures: steps made, environment, status."""

        def own(tensor: Tensor) -> Any:
            return np.ascontiguousarray(
                (tensor if len(tensor) == 1 and self._one_scene else tensor[rows]).cpu().numpy()
            )

        count, failures = len(rows), list[tuple[int, int, int]]()
        blocks = self._blocks[rows].cpu().numpy()
        other = np.zeros_like(blocks)
        results = Results(*(one.cpu().numpy() for one in self._results(count, self._rules.steps > 1)))
        call = Call(new_memory(1))
        scenes = Scenes(own(self._values), own(self._scene_params), own(self._kinds), *NO_PIECES)
        acting = np.ascontiguousarray(controls[:, rows].cpu().numpy())
        call.set_arguments(scenes, self._batch._rules, blocks, other, acting, results)
        low, loop = 0, compiled(run.run)
        while low < count:
            ended, number, made, *_ = run_blocks(loop, [call], 0, low, count, Halt())
            if not ended:
                break
            failures.append((made, int(rows[number]), ended))
            low = number + 1
        result[rows] = self._tensor(other if self._rules.steps & 1 else blocks)
        for name in ("observations", "returns", "terminations", "truncations"):
            if len(made_here := getattr(results, name)):
                getattr(filled, name)[rows] = self._tensor(made_here)
        filled.rewards[0, rows] = self._tensor(results.rewards[0])
        return failures

    def _begun(self, chosen: Tensor, words: Tensor, blocks: Tensor, observations: Tensor) -> tuple[Tensor, ...]:
        """Begin episodes in ``blocks``, by generators with these ``words``; return what :meth:`_commit` commits."""
        ended, values, params = self._new(kind="int64"), self._values, self._scene_params
        if len(self._ranges):
            values, params = values.clone(), params.clone()
        call = self._card.words_of_call(
            ended, chosen, self._numbers, self._rules.dt, values, params, self._ranges, self._derived, words, blocks,
            observations,
        ).to(self._card.PLACE)  # fmt: skip
        self._begin(call.data_ptr(), self.num_envs)
        for number in ended.nonzero()[:1, 0].tolist():  # the CPU raises the error
            numbers, seen = np.array([number]), observations.cpu().numpy()
            self._batch._observe(values[self._row(number)].cpu().numpy(), blocks.cpu().numpy(), numbers, seen, None)
        return words, values, params, blocks

    def _commit(self, begun: tuple[Tensor, ...], seeds: dict[int, int]) -> None:
        """Replace the present by what :meth:`_begun` returned, in one call, which an interruption cannot cut."""
        names = ("_words", "_values", "_scene_params", "_blocks", "_seeds", "_ready")
        vars(self).update(zip(names, (*begun, seeds, True), strict=True))


def refuse(envs: JackInBoxVectorEnv) -> None:
    """Raise ValueError for what environments on a GPU do not have."""
    batch, scene, task = envs._batch, envs.scene_of(0), envs._interface.task
    if envs.contact != "exact":
        raise ValueError(f'device="cuda" needs fidelity="exact", got {envs.fidelity!r}')
    lacking = {
        "a render_mode": envs.render_mode is not None,
        "with_infos": envs.with_infos,
        "autoreset_mode DISABLED": envs.autoreset_mode is AutoresetMode.DISABLED,
        'torque="chirp"': envs.torque == "chirp",
        "Pixels": envs._interface.pixels is not None,
        "a Task with a start": task.start is not None,
        "a function as randomize": callable(envs.randomize),
        "a scene for each environment": isinstance(batch, ExactBatch) and len(batch._present.scenes.originals) > 1,
        "forces of a Drive": scene.drive is not None and scene.drive.force_bound > 0.0,
    }
    for what, is_lacking in lacking.items():
        if is_lacking:
            raise ValueError(f'device="cuda" does not have {what}: make these environments without device')


@lru_cache(maxsize=8)  # a user's functions are compiled for a minute
def codes_of(interface: Interface) -> tuple[str, str]:
    """PTX of ``decide`` and of ``begin`` with the functions of a task, an observation and an action.

    Raises:
        TypeError: a function needs more than arithmetic.
    """
    task, observation, action, _ = interface
    plain = name_of(action) == "torque"
    actor = decision.no_actor_of if plain else decision.actor_of
    owners: list[Any] = [task, observation, *[action] * (not plain)]
    users = functions_together(owners, {**decision.OF_DECISIONS, "block_actor": actor})
    codes = []
    for function, example in ((decision.decide, decision.arguments()), (decision.begin, (0, 0))):
        names = [function.__name__, *(name_of(one) for one in (task, observation, action))]

        def made(function: Any = function, example: Any = example) -> str:
            return ptx.checked(*users.intermediate_code(function, kinds_of(example)), "sm_80", example)

        codes.append(ptx.stored("-".join(names), made) if all(names) else made())
    return codes[0], codes[1]
