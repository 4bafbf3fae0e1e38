"""Samples of a motion between its stored states: the moments of its impacts, and points in flight.

A stored state is the end of a control step, and impacts happen within steps. Here each step is replayed
(:mod:`jackbox_env.simulators.replay`) by flight in closed form and the recorded impulses. There is a sample just before
and just after each impact, so the animated page draws impacts without a contact model.

Exactness: rounding with ``fidelity="exact"``. With pymunk an impact is where the engine resolved it, at the end of a
substep, with the foot inside the wall. A step in which a foot rests on a wall has samples at its impacts alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import THETA_BOX, X_BOX, X_JACK, Y_BOX, Y_JACK, Array
from jackbox_env.recording.motion import Motion
from jackbox_env.simulators import Impact
from jackbox_env.simulators.replay import Moment, box_energy, flown, replayed

SPACING = 0.005  # between samples in flight, at most [s]
_REPLAY_TOLERANCE = 1e-6  # over L; a replay that ends further off had a foot at rest


class Samples(NamedTuple):
    """A motion between its stored states, in time order; two samples have one time where there is an impact."""

    times: Array  # [s], (n,)
    states: Array  # SI units, (n, 12)
    torques: Array  # on the box [N m], (n,)
    energies: Array  # kinetic energy and m_j g y_jack [J], (n,)
    work: Array  # of torque and side forces on the box since the start [J], (n,)


class _Sample(NamedTuple):
    time: float
    state: list[float]
    work: float  # since the step's start


class _Step(NamedTuple):
    """One step of a motion."""

    start: float  # [s]
    end: float  # [s]
    before: list[float]
    after: list[float]
    impacts: list[Impact]
    torque: float | None  # constant [N m]; None: the drive's

    def _between(self, scene: Scene, state: list[float], start: float, end: float, done: float) -> Iterator[_Sample]:
        """Points of a flight from a state, without its ends; ``done`` is the work at its start."""
        points = math.ceil((end - start) / SPACING - 1e-6)
        for number in range(1, points):
            since = (end - start) * number / points
            flying = flown(scene, state, start, since, self.torque)
            yield _Sample(start + since, flying, done + box_energy(scene, flying) - box_energy(scene, state))

    def samples(self, scene: Scene) -> Iterator[_Sample]:
        """The moments of impacts, points between them, and the step's end, with the work since its start."""
        replay = replayed(scene, self.before, self.start, self.impacts, self.end, self.torque)
        resting = any(self._rests(scene, moment) for moment in replay.moments)
        start, state, done = self.start, self.before, 0.0
        for moment in [*replay.moments, None]:
            time = self.end if moment is None else min(moment.time, self.end)
            if not resting:
                yield from self._between(scene, state, start, time, done)
            if moment is None or self._rests(scene, moment):
                break
            yield _Sample(time, moment.before, moment.work)
            if moment.time < self.end:
                yield _Sample(time, moment.after, moment.work)
            start, state, done = time, moment.after, moment.work
        yield _Sample(self.end, self.after, replay.work + self._missed_work(scene, replay.state))

    def _missed_work(self, scene: Scene, ended: list[float]) -> float:
        """The work that a replay misses if it ended elsewhere because resting feet fall in it.

        The difference of the box's rates grows evenly from 0, and its integral is that of the angles. Constant torques
        give the work to rounding, others to third order in the step.
        """
        drive, length = scene.drive or Drive(), self.end - self.start
        turning = drive.torque_means if self.torque is None else lambda *_: (self.torque, self.torque)
        averages = ((THETA_BOX, turning), *zip((X_BOX, Y_BOX), drive.force_means, strict=False))
        return sum(means(self.start, length)[1] * (self.after[axis] - ended[axis]) for axis, means in averages)

    def _rests(self, scene: Scene, moment: Moment) -> bool:
        """Whether the moment is the record of a foot at rest, at the step's end: that foot falls in the replay."""
        off = max(abs(moment.before[axis] - self.after[axis]) for axis in (X_JACK, Y_JACK))
        return moment.time >= self.end and off > _REPLAY_TOLERANCE * scene.box_half_width


def samples_of(motion: Motion) -> Samples:
    """The samples of a motion: all stored states, impacts, and flight at most 0.005 s apart."""
    scene, ends, states = motion.scene, motion.t.tolist(), motion.states.tolist()
    constant_torques = [None] * len(ends) if motion.torques is None else motion.torques.tolist()
    samples, impacts = [_Sample(ends[0], states[0], 0.0)], iter(motion.hits)
    for number, count in enumerate(motion.counts.tolist()):
        hits, done = list(islice(impacts, count)), samples[-1].work
        step = _Step(ends[number], ends[number + 1], states[number], states[number + 1], hits, constant_torques[number])
        samples += [one._replace(work=done + one.work) for one in step.samples(scene)]
    times, states, work = zip(*samples, strict=True)
    energies = [energy_of(scene, state) for state in states]
    return Samples(*map(np.array, (times, states, _torques(motion, times), energies, work)))


def _torques(motion: Motion, times: Sequence[float]) -> list[float]:
    """Torque at each sample [N m]: that of its step, or the drive's."""
    if motion.torques is not None:
        steps = np.searchsorted(motion.t[1:], times)
        return np.append(motion.torques, 0.0)[steps].tolist()  # type: ignore[no-any-return]
    torque = getattr(motion.scene.drive, "torque", None) or (lambda time: 0.0)
    return [float(torque(time)) for time in times]
