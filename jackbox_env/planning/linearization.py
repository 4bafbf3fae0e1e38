"""Derivatives of trajectories of the exact model by states, torques and the scene, impacts included.

``linearize`` plays a rollout that records the states at impacts, and ``exact/derivatives.py`` differentiates it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env.exact import derivatives, tangents
from jackbox_env.exact.threads import Halt, Threads, thread_count
from jackbox_env.exact.workspace import new_workspaces
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.scene import Scene, scenes_of
from jackbox_env.model.states import LATEST_TIME, Array, Counts, Flags
from jackbox_env.planning.rollouts import FEWEST_PER_THREAD, OneOrMore, RolloutOptions, Tape, run_rollouts, sequences
from jackbox_env.simulators.exact import drive_kind
from jackbox_env.tools import checks as check

_AT_ONCE = 100_000  # steps of one call, after which Python can handle an interruption


class Linearization:
    """Trajectories and their derivatives, in SI units, from :func:`linearize`.

    The matrices are computed when they are first read; ``vjp`` does not need them. It unpacks as
    ``trajectories, A, B, P, smooth``.

    >>> start = [0, 0, 0, 4.9, 0, 0, 0, 0, 0, 10, 0, 0]  # the jack flies at a wall
    >>> lin = linearize(None, start, [0.0], dt=0.02)
    >>> steps, times, derivatives = lin.impacts(0)
    >>> times.round(6), derivatives[0, 3].round(6).item()  # starting 1 m closer would save 0.1 s
    (array([0.01]), -0.1)

    Attributes:
        trajectories: shape (N, H + 1, 12), those of ``rollout`` bit for bit.
        smooth: shape (N, H), False if a step has no derivative, or rounding hides it: several contacts at one moment,
            an impact slower than 1e-6 v0 or so slow that rounding decides, a foot that rests or begins to, one that
            touches a wall and approaches it at the step's start or end, an impact at the end, impacts that multiply an
            error by 1e10. A, B and P of that step are NaN.
    """

    def __init__(
        self, scenes: list[Scene], dt: float, torques: Array, kinds: NDArray[np.int64], seeds: Array,
        trajectories: Array, tape: Tape, num_threads: int | None,
    ) -> None:  # fmt: skip
        smooth = np.zeros(tape.nonsmooth.shape, np.bool_)
        self._seeds, self._num_threads, self._tape = seeds, num_threads, tape
        begins = np.concatenate([[0], np.cumsum(tape.hits)])
        numbers = np.array([scene.numbers for scene in scenes])
        self._played = derivatives.Played(numbers, kinds, dt, torques, trajectories, tape.rows, begins, smooth)
        compiled(derivatives.mark_smooth)(
            self._played, tape.nonsmooth, np.zeros((tangents.ROWS, len(derivatives.GROWING))), new_workspaces()
        )
        # Views, as compiled code would be compiled once more for arrays that are read-only.
        self.trajectories, self.smooth = trajectories.view(), smooth.view()
        _lock(self.trajectories, self.smooth)

    def __iter__(self) -> Iterator[Array | Flags]:
        return iter((self.trajectories, self.A, self.B, self.P, self.smooth))

    @property
    def A(self) -> Array:  # noqa: N802
        """Derivative by the step's first state, A[n, k, i, j] = d x_i(k + 1) / d x_j(k), shape (N, H, 12, 12)."""
        return self._matrices[0]

    @property
    def B(self) -> Array:  # noqa: N802
        """Derivative by the step's torque [1 / (N m)], shape (N, H, 12); under a drive, by a torque added to it."""
        return self._matrices[1]

    @property
    def P(self) -> Array:  # noqa: N802
        """Derivative by the scene's ``fields`` in their order, shape (N, H, 12, F)."""
        return self._matrices[2]

    @cached_property
    def _matrices(self) -> tuple[Array, Array, Array, Array]:
        shape, columns = (*self.smooth.shape, 12), 13 + self._seeds.shape[1]
        by_time = np.full((len(self._tape.rows), columns), np.nan)
        results = np.empty((*shape, 12)), np.empty(shape), np.empty((*shape, columns - 13)), by_time
        call = compiled(derivatives.matrices)
        self._spread(columns, lambda span, *memory: call(self._played, self._seeds, span, results, *memory))
        _lock(*results)
        return results

    def impacts(self, row: int) -> tuple[Counts, Array, Array]:
        """The impacts of a row, in time order, and the derivatives of their times; NaN in a step without a derivative.

        Returns:
            The step of each impact, (m,), its time since the step's start [s], (m,), and the derivatives of that time
            by the state at the step's start, the torque and the fields, (m, 13 + F).
        """
        count, steps = len(self.trajectories), self.trajectories.shape[1] - 1
        row, begins = check.whole("row", row, at_least=0, at_most=count - 1), self._played.begins
        rows = slice(begins[row * steps], begins[(row + 1) * steps])
        within = np.repeat(np.arange(steps), self._tape.hits[row])
        return within, self._tape.rows[rows, 0], self._matrices[3][rows]

    def vjp(self, g: ArrayLike) -> tuple[Array, Array, Array]:
        """The gradient of sum(g * trajectories), a vector-Jacobian product.

        Args:
            g: weights of the trajectories' states, shape (N, H + 1, 12).

        Returns:
            The gradient by the first states, (N, 12), by the torques, (N, H / repeat), and by the fields, (N, F), of
            each row. NaN if a step without a derivative lies in between.

        Raises:
            TypeError, ValueError: unusable weights.
        """
        weights = _floats("g", g, self.trajectories.shape)
        results = self._zeros()
        call = compiled(derivatives.pull_back)
        self._spread(
            13 + self._seeds.shape[1],
            lambda span, *memory: call(self._played, self._seeds, span, weights, results, *memory),
        )
        return results

    def jvp(
        self, dstates: ArrayLike | None = None, dtorques: ArrayLike | None = None, dfields: ArrayLike | None = None
    ) -> Array:
        """The first-order change of the trajectories, shape (N, H + 1, 12), a Jacobian-vector product.

        Args:
            dstates: of the first states, (N, 12); None: no change.
            dtorques: of the torques, (N, H / repeat) [N m]; None: no change.
            dfields: of the fields, (N, F); None: no change.

        Raises:
            TypeError, ValueError: unusable changes.
        """
        names = ("dstates", "dtorques", "dfields")
        states, torques, scene = (
            zero if change is None else _floats(name, change, zero.shape)
            for name, change, zero in zip(names, (dstates, dtorques, dfields), self._zeros(), strict=True)
        )
        changes, steps = np.empty(self.trajectories.shape), self._played.smooth.shape[1]
        held = np.repeat(torques, steps // max(1, self._played.torques.shape[1]), axis=1)
        changes[:, 0] = states
        for k in range(steps):
            changes[:, k + 1] = np.einsum("nij,nj->ni", self.A[:, k], changes[:, k]) + self.B[:, k] * held[:, k, None]
            changes[:, k + 1] += np.einsum("nif,nf->ni", self.P[:, k], scene)
        return changes

    def _zeros(self) -> tuple[Array, Array, Array]:
        count = len(self.trajectories)
        return np.zeros((count, 12)), np.zeros(self._played.torques.shape), np.zeros((count, self._seeds.shape[1]))

    def _spread(self, columns: int, call: Callable[..., None]) -> None:
        """Call ``call`` for ranges of rows, on several threads."""
        count, steps = len(self.trajectories), self.trajectories.shape[1] - 1
        ranges = count if self._num_threads is not None else min(count, count * steps // FEWEST_PER_THREAD)
        threads, halt = Threads(thread_count(self._num_threads, ranges)), Halt()
        at_once = max(1, _AT_ONCE // max(1, steps))

        def work(thread: int, low: int, high: int) -> None:
            memory = np.zeros((tangents.ROWS, columns)), new_workspaces()
            for first in range(low, high, at_once):
                if halt.requested:
                    return
                call((first, min(first + at_once, high)), *memory)

        threads.run(work, count, halt=halt)


def linearize(
    scene: OneOrMore,
    states: ArrayLike,
    torques: ArrayLike | None,
    dt: float,
    time: float | ArrayLike = 0.0,
    *,
    fields: Sequence[str] = (),
    repeat: int = 1,
    steps: int | None = None,
    num_threads: int | None = None,
) -> Linearization:
    """Play torques like :func:`rollout`, and differentiate each step by its state, its torque and the scene.

    The derivatives include the impacts, by saltation matrices (``exact/tangents.py``), exact up to rounding. Each
    impact multiplies them by about 10, like every error (docs/physics.md).

    >>> lin = linearize({"gravity": 10.0}, [0.0] * 12, [0.0], dt=0.02, fields=["gravity"])
    >>> lin.A[0, 0, 4, 10].item(), lin.P[0, 0, 10, 0].item()  # y by its rate, the rate by gravity
    (0.02, -0.02)

    Args:
        scene: a Scene, a dict of some of its fields, or None; or a list of N, one for each row.
        states: shape (N, 12), or (12,) for all sequences; a foot may be up to 1 m outside.
        torques: on the box [N m], shape (N, H), or (H,) for all states; None: the scene's drive acts for ``steps``.
        dt: duration of a step [s], > 0.
        time: at which all start [s], or each row, shape (N,).
        fields: of the scene, to differentiate by, at fixed torques in N m: any of gravity, box_mass, box_inertia,
            jack_mass, jack_inertia, jack_arm, box_half_width, restitution. An inertia that the scene derives follows
            its mass and length; one that you set stays. By restitution 1 the derivative is one-sided, from below.
        repeat: steps that each torque is repeated for; H is then the number of all steps.
        steps: H, if ``torques`` is None.
        num_threads: None: as many as the machine has. Results do not depend on it.

    Raises:
        TypeError, ValueError: unusable values.
        JackLostError: a jack moves too fast to be followed.
    """
    scenes, several = scenes_of(scene)
    repeat = check.whole("repeat", repeat, at_least=1, at_most=1_000_000)
    dt = check.real("dt", dt, above=0.0)
    several_times = isinstance(time, list | tuple) or (isinstance(time, np.ndarray) and time.ndim > 0)
    each: Any = time if several_times else [time]
    times = [check.real("time", one, at_least=-LATEST_TIME, at_most=LATEST_TIME) for one in each]
    driven = torques is None
    if torques is None:
        if repeat != 1:
            raise ValueError(f"repeat must be 1 if torques is None, got {repeat}")
        torques = np.zeros(check.whole("steps", steps, at_least=0, at_most=10_000_000))
    elif steps is not None:
        raise TypeError(f"steps must be None if there are torques, got {steps}")
    starts, rows = sequences(scenes, several, states, torques)
    if several_times and len(times) != len(starts):
        raise ValueError(f"time must be one number or {len(starts)}, as many as rows, got {check.shown(time)}")
    if len(times) > len(scenes):
        scenes = scenes * len(times)
    seeds = np.array([_seeds(one, fields) for one in scenes])
    tape = Tape()
    options = RolloutOptions(impacts=True, repeat=repeat, whole=True, num_threads=num_threads, drives_turn=driven)
    trajectories = run_rollouts(scenes, starts, rows, dt, np.array(times), options, tape).trajectories
    kinds = np.array([drive_kind(one.drive, held=not driven) for one in scenes])
    return Linearization(scenes, dt, rows, kinds, seeds, trajectories, tape, num_threads)


@cache
def ensure_compiled() -> None:
    """Compile all derivatives, or load them."""
    linearization = linearize(None, np.zeros(12), np.zeros(1), 0.02)
    linearization.vjp(linearization.trajectories)
    _ = linearization.A


def _seeds(scene: Scene, fields: Sequence[str]) -> Array:
    """Derivatives of the numbers of ``tangents.FIELDS`` by each field, shape (F, 8): a derived inertia follows."""
    if isinstance(fields, str) or not isinstance(fields, Sequence):
        raise TypeError(f"fields must be a tuple of names, got {check.shown(fields)}")
    seeds = np.zeros((len(fields), len(tangents.FIELDS)))
    for row, name in zip(seeds, fields, strict=True):
        row[tangents.FIELDS.index(check.choice("a field", name, tangents.FIELDS))] = 1.0
        for inertia, mass, length in _INERTIAS:
            if inertia in scene.derived and name in (mass, length):
                m, r = getattr(scene, mass), getattr(scene, length)
                row[tangents.FIELDS.index(inertia)] = r * r if name == mass else 2.0 * m * r
    return seeds


_INERTIAS = ("box_inertia", "box_mass", "box_half_width"), ("jack_inertia", "jack_mass", "jack_arm")


def _lock(*arrays: NDArray[Any]) -> None:
    """Make arrays read-only that later results depend on."""
    for one in arrays:
        one.flags.writeable = False


def _floats(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """An argument as an array of the one type for which the code is compiled."""
    numbers = np.require(check.array(name, values, "be numbers"), np.float64, ("C", "A", "W"))
    if numbers.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {numbers.shape}")
    return numbers
