"""The exact contact model, with rewards, observations and restarts in its loop: the code that numba compiles.

``run.py`` steps rows of jacks, each by ``step.py``: detect -> evolve -> resolve -> record.

- detect: ``search.py`` isolates the next impact, with the bounds of the motion in ``bounds.py``.
- evolve: ``flight.py`` flies there under the drive. ``rest.py`` and ``constrained.py`` move feet at rest.
- resolve: ``contact.py`` applies the impact law and records the impact.
- record: ``run.py`` fills in the results, ``score.py`` torques of actions, observations and rewards.

``geometry.py`` has frames and gaps. ``glide.py`` moves rows in free flight together, and ``pcg64.py`` draws scenes and
starts. ``late.py`` has what is compiled when a step first needs it, and ``threads.py`` shares rows out. ``tangents.py``
differentiates a step, ``derivatives.py`` a rollout. ``workspace.py`` has the memory and the arguments of a call. The
projection of simultaneous contacts on a cone is in ``model/complementarity.py``. For derivatives, ``step.record_state``
adds the state at each impact to a wide log.

In all files a gap is gap = L - n . (r + o) [m]: L is half the box's width, n a wall's outward normal, r the jack's
centre from the box's, o a foot from the jack's centre, |o| = l the jack's arm. K [m/s^2] bounds |gap''|, and v0 is
the scene's speed scale. "With loss" means that the restitution e is below 1, "without loss" that it is 1. The rates of
a state are its six velocities.
"""
