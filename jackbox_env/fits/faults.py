"""What may be wrong with a recording, though the scene is right: how it would look then, by how much.

:mod:`jackbox_env.fits.outcome` tests whether some of one would fit better.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jackbox_env.fits.observed import Recording
from jackbox_env.model.states import THETA_BOX, THETA_JACK, Array

_LENGTHS = np.array([1.0, 1.0, 0.0] * 4)  # of the 12 numbers, those that a camera scales
_ROLLED = np.kron(np.eye(4), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))  # over the angle
_TURNED = np.eye(12)[THETA_BOX] + np.eye(12)[THETA_JACK]
_OF_STATES: dict[str, Callable[[Array], Array]] = {  # the states' derivatives by it
    "the zero of theta_jack": lambda _: np.eye(12)[THETA_JACK],  # [rad]
    "the zero of theta_box": lambda _: np.eye(12)[THETA_BOX],  # [rad]
    "the scale of lengths": lambda states: states * _LENGTHS,  # relative
    "the camera's roll": lambda states: np.nan_to_num(states) @ _ROLLED.T + _TURNED,  # [rad]
}
GAIN, DELAY = "the torque's gain", "the torque's delay"  # relative, [s]
FAULTS = *_OF_STATES, GAIN, DELAY


def spoilt(recording: Recording, fault: str, size: float) -> Recording:
    """A recording with more of a fault; the same if it is one of torques and has none."""
    states, torques = recording.states, recording.torques
    if fault in _OF_STATES:
        states = states + size * _OF_STATES[fault](states)
    elif torques is not None and fault == GAIN:
        torques = (1.0 + size) * torques
    elif torques is not None:
        moments, acted = np.arange(torques.size + 1.0), np.append(0.0, np.cumsum(torques))
        late = moments - size * torques.size / (recording.dt * (len(states) - 1))
        torques = np.diff(np.interp(late, moments, acted)).reshape(torques.shape)
    return Recording(states, torques, recording.dt, recording.time, recording.impacts)
