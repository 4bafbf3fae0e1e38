"""The exact contact model: the code that numba compiles.

``run.py`` steps rows of jacks, each by ``step.py``: detect -> evolve -> resolve -> record.

- detect: ``search.py`` isolates the next impact, with the bounds of ``bounds.py``.
- evolve: ``flight.py`` flies there, under a drive in the polynomials of ``drives.py``. ``rest.py`` and
  ``constrained.py`` move feet at rest.
- resolve: ``contact.py`` applies the impact law and records the impact.
- record: ``run.py`` fills in the results, ``score.py`` observations and rewards.

``glide.py`` moves rows in free flight together, and ``restart.py`` starts episodes. ``tangents.py`` differentiates a
step, ``derivatives.py`` a rollout. ``workspace.py`` has the memory and the arguments of a call. ``compiler.py``
compiles all of it, and ``code_cache.py`` stores the machine code.
"""
