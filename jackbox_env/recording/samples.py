"""Samples of a motion for the animated page and for films: stored states, moments of impacts, and points in flight.

With ``fidelity="exact"`` there is a sample just before and just after each impact. pymunk stores no states between the
ends of control steps, so its samples are these, and the page draws a curve between them. Their work follows from a
replay of each step by its recorded impulses, which is off by a little while a foot rests on a wall.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.states import Array
from jackbox_env.recording.motion import Motion
from jackbox_env.simulators.replay import replayed

SPACING = 0.005  # between samples in flight, at most [s]


class Samples(NamedTuple):
    """A motion between its stored states, in time order; two samples have one time where there is an impact."""

    times: Array  # [s], (n,)
    states: Array  # SI units, (n, 12)
    torques: Array  # on the box [N m], (n,)
    energies: Array  # kinetic energy and m_j g y_jack [J], (n,)
    work: Array  # of torque and side forces on the box since the start [J], (n,)


def samples_of(motion: Motion) -> Samples:
    """The samples of a motion: all stored states, impacts, and flight at most 0.005 s apart."""
    if "resting" not in (motion.impacts.dtype.names or ()):
        return Samples(motion.t, motion.states, _torques(motion, motion.t), motion.energy(), _replayed_work(motion))
    struck = np.unique(motion.impacts["time"][~motion.impacts["resting"]])
    moments = np.unique(np.concatenate([motion.t, struck]))
    parts = np.maximum(1, np.ceil(np.diff(moments) / SPACING - 1e-6)).astype(int)
    spans = zip(pairwise(moments), parts.tolist(), strict=True)
    between = [np.linspace(start, end, count, endpoint=False) for (start, end), count in spans]
    times = np.sort(np.concatenate([*between, moments[-1:], struck]))
    states, (before,) = motion(times), np.nonzero(np.append(times[1:] == times[:-1], False))
    states[before] = motion(times[before], "before")
    energies = np.asarray(energy_of(motion.scene, states.T))
    return Samples(times, states, _torques(motion, times), energies, motion.work(times))


def _replayed_work(motion: Motion) -> Array:
    """The work since the start at each stored state [J], by a replay of each step from its recorded impulses."""
    ends, bounds, impacts = motion.t.tolist(), np.cumsum([0, *motion.counts]).tolist(), motion.hits
    torques = [None] * len(ends) if motion.torques is None else motion.torques.tolist()
    done = [0.0]
    for step, state in enumerate(motion.states[:-1].tolist()):
        hits = impacts[bounds[step] : bounds[step + 1]]
        replay = replayed(motion.scene, state, ends[step], hits, ends[step + 1], torques[step])
        done.append(done[-1] + replay.work)
    return np.array(done)


def _torques(motion: Motion, times: Array) -> Array:
    """Torque at each sample [N m]: that of its step, or the drive's."""
    if motion.torques is not None:
        steps = np.searchsorted(motion.t[1:], times)
        return np.append(motion.torques, 0.0)[steps]
    torque = getattr(motion.scene.drive, "torque", None) or (lambda time: 0.0)
    return np.array([float(torque(time)) for time in times.tolist()])
