"""The result of a fit: a scene, its intervals, and the reasons not to trust them."""

from __future__ import annotations

from dataclasses import dataclass, field

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array


@dataclass(frozen=True)
class Fit:
    """A scene fitted to recordings.

    >>> import numpy as np
    >>> from jackbox_env import Recording, fit, rollout
    >>> still, torques = Scene(drive=None), np.zeros(150)  # only the ratio of the masses matters
    >>> states = rollout(still, 0.3 * np.eye(12)[5], torques, dt=0.02)[0]  # leaning by 0.3 rad
    >>> fit(Recording(states, torques, dt=0.02), ("box_mass", "jack_mass"), still).unidentified
    ('moving box_mass by +1 % and jack_mass by +1 % changes nothing that was observed',)

    Attributes:
        scene: the scene.
        intervals: 95 % interval of each field; (0, inf), of restitution (0, 1), if it is unidentifiable.
        residuals: (observed - fitted) over its expected standard deviation in held-out windows, shape (n,); about
            N(0, 1) if the model is right. The start of a held-out window is fitted to it.
        unidentified: the combinations of fields that the recordings leave open, each in a sentence. Masses are among
            them if nothing pushed the box: only their ratios are known then.
        noise: standard deviation of each number that was observed, by its name, and of "impacts" [s].
        motions: the fitted motion of each recording, shape (H + 1, 12), NaN where it was left out.
        left_out: steps that were left out because the jack is at rest there, or cannot be followed.
        problems: why the intervals are not to be trusted, each in a sentence without a full stop; empty if the search
            ended and identified a field, every window fits within the noise, the residuals are white, and no other
            value of what is not fitted would fit better.
        bad_rows: rows with a number that is more than 5 standard deviations off, and is discounted, each in a sentence:
            "row 133: x_jack is 0.05 m off". More than 5 % of a recording are a problem.
        unexplained: time of these steps in which the jack flies, but the scene does not explain how [s].
    """

    scene: Scene
    intervals: dict[str, tuple[float, float]]
    residuals: Array
    unidentified: tuple[str, ...]
    noise: dict[str, float] = field(default_factory=dict)
    motions: tuple[Array, ...] = ()
    left_out: int = 0
    problems: tuple[str, ...] = ()
    bad_rows: tuple[str, ...] = ()
    unexplained: float = 0.0

    @property
    def converged(self) -> bool:
        """Whether there are no problems."""
        return not self.problems
