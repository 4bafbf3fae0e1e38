"""Solves the complementarity problem of simultaneous contacts, in coordinates v = M^1/2 qdot:

    0 <= x  _|_  W (v + W^T x) + bias >= 0,    W the rows of J M^-1/2, each at length 1.

Method: v + W^T x is the nearest point to v with W v + bias >= 0. Gradients of gaps have rank 3 at most, each being a
    combination of (n_x, n_y, n^perp . o). So all sets of one, two and three rows are tried. Each gives a point by
    projection, and the right one has no negative multiplier and closes no gap.
Exactness: rounding. The point is unique; if rows are dependent, x is one of several.
Fails: contacts whose rows are dependent and nearly parallel, as those of feet on opposite walls: multipliers then
    cancel, and rounding grows with them. A jack smaller than the box has no such contacts.
Cost: n^3 / 6 projections for n contacts; a jack and a box have four at most outside special poses.
Bits: the same on every processor, because the sums are written out. The functions are plain Python here, for
    :func:`jackbox_env.mechanics.simultaneous_impact_map`, and compiled for the exact contact model.

The functions work in ``contacts``, with fields of :class:`jackbox_env.exact.workspace.Contacts`: ``gradients``
(n, 6), ``units`` W (n, 6), ``lengths`` (n,), ``bias`` (n,), ``rates`` v (6,), ``projected`` (6,), ``multipliers`` (3,),
``best`` (3,), and ``basis`` (3 or 4, 6), ``triangle`` (3, 3), ``goals`` (3,) for Gram-Schmidt.
"""

from __future__ import annotations

import math
from typing import Any

from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import THETA_BOX, THETA_JACK, Array, add_numbers, copy_numbers

_DEPENDENT = 1e-13  # length of a unit row's part orthogonal to the others: below it, the row depends on them


def root_mass(scene: SceneNumbers, coordinate: int) -> float:
    """Square root of a diagonal element of M."""
    mass = (
        scene.box_mass if coordinate < THETA_BOX else scene.box_inertia if coordinate == THETA_BOX else scene.jack_mass
    )
    return math.sqrt(scene.jack_inertia if coordinate == THETA_JACK else mass)


def mass_scale(scene: SceneNumbers, contacts: Any, count: int, rates: Array) -> None:
    """Fill in v = M^1/2 ``rates``, the rows of J M^-1/2 scaled to length 1, and their lengths."""
    for index in range(6):
        root = root_mass(scene, index)
        contacts.rates[index] = root * rates[index]
        for i in range(count):
            contacts.units[i, index] = contacts.gradients[i, index] / root
    for i in range(count):
        contacts.lengths[i] = math.sqrt(dot(contacts.units[i], contacts.units[i]))
        for index in range(6):
            contacts.units[i, index] /= contacts.lengths[i]


def nearest(contacts: Any, count: int) -> tuple[int, int, int]:
    """The active contacts, -1 for none: their multipliers take v to the nearest point with w v + bias >= 0 everywhere.

    It tries all sets of one, two and three of ``count`` contacts. Those of the best set are in ``contacts.best``.
    """
    lowest = 0.0
    for i in range(count):
        lowest = min(lowest, dot(contacts.units[i], contacts.rates) + contacts.bias[i])
    if lowest >= 0.0:
        return -1, -1, -1  # nothing approaches
    least = math.inf
    one = two = three = -1
    for i in range(count):
        for j in range(i, count):
            for k in range(j, count):
                if k == j and j != i:
                    continue  # sets of one (i, i, i), two (i, i, k) and three (i, j, k)
                size = 1 if k == i else 2 if j == i else 3
                violation = violation_of(contacts, count, size, k, i, j)
                if violation < least:
                    least = violation
                    one, two, three = k, i if size > 1 else -1, j if size > 2 else -1
                    copy_numbers(3, contacts.multipliers, contacts.best)
    return one, two, three


def violation_of(contacts: Any, count: int, size: int, one: int, two: int, three: int) -> float:
    """The fastest closing of a gap by a set's projection; infinite if rows depend or a multiplier is negative."""
    if not project(contacts, size, one, two, three):
        return math.inf
    violation = 0.0
    for index in range(size):
        violation = math.inf if contacts.multipliers[index] < 0.0 else violation
    for other in range(count):
        violation = max(violation, -(dot(contacts.units[other], contacts.projected) + contacts.bias[other]))
    return violation


def dot(a: Array, b: Array) -> float:
    """Scalar product of six numbers."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


def project(contacts: Any, size: int, one: int, two: int, three: int) -> bool:
    """Project v on w v + bias = 0 of ``size`` rows: the point v + sum of multipliers times rows.

    Returns whether the rows are independent. By modified Gram-Schmidt, rows = triangle^T basis.
    """
    point, multipliers = contacts.projected, contacts.multipliers
    copy_numbers(6, contacts.rates, point)
    for a in range(size):
        picked = one if a == 0 else two if a == 1 else three
        copy_numbers(6, contacts.units[picked], contacts.basis[a])
        for turn in range(2):  # twice is enough to be orthogonal to rounding (Giraud et al. 2005)
            for b in range(a):
                share = dot(contacts.basis[b], contacts.basis[a])
                contacts.triangle[b, a] = share if turn == 0 else contacts.triangle[b, a] + share
                add_numbers(6, contacts.basis[a], -share, contacts.basis[b])
        length = math.sqrt(dot(contacts.basis[a], contacts.basis[a]))
        if length < _DEPENDENT:
            return False
        contacts.triangle[a, a] = length
        for index in range(6):
            contacts.basis[a, index] /= length
        goal = contacts.bias[picked]
        for b in range(a):
            goal += contacts.triangle[b, a] * contacts.goals[b]
        contacts.goals[a] = 0.0 - goal / length
        multipliers[a] = -(dot(contacts.basis[a], point) - contacts.goals[a])
        add_numbers(6, point, multipliers[a], contacts.basis[a])
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            multipliers[a] -= contacts.triangle[a, b] * multipliers[b]
        multipliers[a] /= contacts.triangle[a, a]
    return True
