"""Proofs of what the exact model computes: rigorous enclosures of all impacts and states, by interval arithmetic.

Every number is an Arb ball, a midpoint and a radius that contain the true value (Johansson 2017, "Arb: efficient
arbitrary-precision midpoint-radius interval arithmetic"). A float64 state, torque or time is a ball of radius 0, so
the enclosed motion is that of exactly these numbers. Of the package only the numbers of a :class:`Scene` are used: no
bound, no cosine and no tolerance of the simulators.

Flight: the jack's centre falls, its spin is constant, the box's centre moves uniformly, because a lift carries the box.
    The box's angle is the double integral of the torque: a polynomial if held, Fresnel integrals under a chirp.
Gaps: the 16 functions gap_ki(t) = L - n_k . (r + o_i) of wall k and foot i. On a time interval with midpoint m a gap
    is enclosed by its Taylor form gap(m) + gap'(m) s + gap''([interval]) s^2 / 2, and its rate likewise. Power series
    give the derivatives (Moore 1979, "Methods and applications of interval analysis"; Tucker 2011).
Search: an interval is free of impacts of a foot if its gap is positive there, or if its rate is. So a foot that has
    just struck needs no special case. Other intervals are bisected until all feet left approach throughout: then each
    whose gap ends negative has one root, and the interval Newton operator encloses it.
Order: the first impact is proven if its root's enclosure ends before any other begins.
Law: M (qdot+ - qdot-) = J^T lambda with 0 <= lambda _|_ J qdot+ + e J qdot- >= 0, for all feet whose gap is
    proven to be at most ``together`` at the first root. The active set is proven by strict inequalities.

If a comparison of balls is undecided, all is repeated with twice the bits, in the end given up with a reason. Out of
reach are exact tangency, rest, bounces that pile up, impacts without restitution, impacts at the very end of a step,
corners with four dependent contacts, feet that start inside a wall and approach it, and drives of functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

from flint import arb, arb_mat, arb_series, ctx

from jackbox_env.model.scene import Chirp, Drive, Scene

Pair = tuple[int, int]  # wall and foot
EVERY_PAIR: Sequence[Pair] = [(wall, foot) for wall in range(4) for foot in range(4)]
SPLIT = arb(0.4921875)  # where an interval is cut: in a symmetric scene a root may be exactly in the middle


class Impact(NamedTuple):
    """One foot's impact on one wall, as proven."""

    time: arb  # [s]
    wall: int
    foot: int
    impulse: arb  # [N s]
    rate: arb  # of the gap before it [m/s]


class Proof(NamedTuple):
    """The result of :func:`prove`."""

    impacts: list[Impact]  # in their proven order
    states: list[list[arb]]  # (steps + 1, 12) [SI units] at the start and after each step
    decided: bool
    why: str  # the reason if not decided, else empty
    bits: int  # of precision


class UndecidedError(Exception):
    """A comparison of balls is undecided; ``final`` if more bits would not help."""

    def __init__(self, why: str, final: bool = False) -> None:
        super().__init__(why)
        self.final = final


def prove(
    scene: Scene, state: Sequence[arb | float], torques: Sequence[float | None], dt: float, *, time: float = 0.0,
    bits: int = 128, most_bits: int = 4096, together: float = 0.0, radius: float = 1e-20,
) -> Proof:  # fmt: skip
    """Enclose the impacts and states of a motion.

    Args:
        scene: the scene.
        state: the 12 numbers of the start [SI units], exact.
        torques: held on the box, one for each step [N m]; None for the scene's drive.
        dt: duration of each step [s], exact.
        time: of the start [s], exact.
        bits: of precision at first; doubled until all is decided.
        most_bits: precision beyond which the motion is given up as undecided.
        together: gap within which other feet strike at the moment of the first [m].
        radius: largest radius of a state's balls [SI units]; more bits are used until they are smaller.
    """
    precision, length = ctx.prec, ctx.cap
    try:
        while True:
            ctx.prec, ctx.cap = bits, 3  # series up to the second derivative
            motion = Motion(scene, state, time, together, radius)
            try:
                for torque in torques:
                    motion.step(torque, arb(dt))
            except UndecidedError as error:
                if error.final or 2 * bits > most_bits:
                    return Proof(motion.impacts, motion.states, False, str(error), bits)
                bits *= 2
            else:
                return Proof(motion.impacts, motion.states, True, "", bits)
    finally:
        ctx.prec, ctx.cap = precision, length


class Motion:
    """A motion enclosed step by step, at one precision."""

    def __init__(self, scene: Scene, state: Sequence[arb | float], time: float, together: float, radius: float) -> None:
        self.scene, self.time, self.together, self.radius = scene, arb(time), arb(together), arb(radius)
        self.impacts: list[Impact] = []
        self.states = [[arb(number) for number in state]]

    def step(self, torque: float | None, dt: arb) -> None:
        """Enclose a step of ``dt`` [s] under a held torque [N m] or the drive: flights and impacts in turn."""
        since = arb(0)
        flight = FreeFlight(self.scene, self.states[-1], turn_of(self.scene, torque, self.time, since))
        while first := flight.first_impact(dt - since):
            root, pairs = first
            since += root
            state = self.impact(flight.state_at(root), self.touching(flight, root, pairs), self.time + since)
            flight = FreeFlight(self.scene, state, turn_of(self.scene, torque, self.time, since))
        self.states.append(self.known(flight.state_at(dt - since)))
        self.time += dt

    def known(self, state: list[arb]) -> list[arb]:
        """Return the state; raise UndecidedError if a ball is wider than ``radius``."""
        if not all(number.rad() <= self.radius for number in state):
            raise UndecidedError("more impacts than the bits follow")
        return state

    def touching(self, flight: FreeFlight, root: arb, first: list[Pair]) -> list[Pair]:
        """The pairs that strike at the time ``root`` of the first [s]: those within ``together``."""
        gaps = {pair: form.gap for pair, form in flight.forms(root, EVERY_PAIR).items() if [pair] != first}
        if not all(gap > self.together or gap <= self.together for gap in gaps.values()):
            raise UndecidedError("feet at the limit of striking together")
        return [pair for pair in EVERY_PAIR if [pair] == first or gaps[pair] <= self.together]

    def impact(self, state: list[arb], pairs: list[Pair], time: arb) -> list[arb]:
        """Apply the law to the pairs, note the impacts, and return the state after them."""
        scene = self.scene
        masses = [scene.box_mass] * 2 + [scene.box_inertia] + [scene.jack_mass] * 2 + [scene.jack_inertia]
        rows = [gradient(scene, state, *pair) for pair in pairs]
        rates = [sum((j * rate for j, rate in zip(row, state[6:], strict=True)), arb(0)) for row in rows]
        yielding = [
            [sum((a * b / mass for a, b, mass in zip(one, other, masses, strict=True)), arb(0)) for other in rows]
            for one in rows
        ]
        pushes = complementary(yielding, [(1 + arb(scene.restitution)) * rate for rate in rates])
        for row, rate, push, (wall, foot) in zip(rows, rates, pushes, pairs, strict=True):
            if push > 0:
                self.impacts.append(Impact(time, wall, foot, push, rate))
                kicks = [j * push / mass for j, mass in zip(row, masses, strict=True)]
                state = state[:6] + [old + kick for old, kick in zip(state[6:], kicks, strict=True)]
        if scene.restitution == 0.0:
            raise UndecidedError("an impact without restitution", final=True)
        return self.known(state)


# -- the law of impact -------------------------------------------------------------------------------------------------


def gradient(scene: Scene, state: list[arb], wall: int, foot: int) -> list[arb]:
    """J = d gap / d q, shape (6,), of gap = L - n . (r + o)."""
    n_x, n_y = quarter_turns(state[2].cos(), state[2].sin(), wall)
    o_x, o_y = quarter_turns(scene.jack_arm * state[5].cos(), scene.jack_arm * state[5].sin(), foot)
    p_x, p_y = state[3] - state[0] + o_x, state[4] - state[1] + o_y
    # With the box's angle n turns by n^perp = (-n_y, n_x), with the jack's o turns by o^perp = (-o_y, o_x).
    return [n_x, n_y, n_y * p_x - n_x * p_y, -n_x, -n_y, n_x * o_y - n_y * o_x]


def quarter_turns(x: arb, y: arb, number: int) -> tuple[arb, arb]:
    """A vector turned by quarter turns."""
    return [(x, y), (-y, x), (-x, -y), (y, -x)][number]


def complementary(matrix: list[list[arb]], vector: list[arb]) -> list[arb]:
    """Solve 0 <= lambda _|_ A lambda + b >= 0 by trying all sets of up to three pushes, with strict inequalities.

    A is J M^-1 J^T, so a solution's velocities are those of every solution.
    """
    count = len(vector)
    for active in (chosen for size in (1, 2, 3) for chosen in combinations(range(count), min(size, count))):
        pushes = [arb(0)] * count
        try:
            solved = arb_mat([[matrix[i][j] for j in active] for i in active]).solve(
                arb_mat([[-vector[i]] for i in active])
            )
        except ZeroDivisionError:
            continue
        for row, i in enumerate(active):
            pushes[i] = solved[row, 0]
        others = [i for i in range(count) if i not in active]
        freed = [sum((matrix[i][j] * pushes[j] for j in active), vector[i]) for i in others]
        if all(pushes[i] > 0 for i in active) and all(rate > 0 for rate in freed):
            return pushes
    raise UndecidedError("which of several feet are pushed")


# -- the drive ---------------------------------------------------------------------------------------------------------


class Turn(NamedTuple):
    """The effect of a torque on the box, as functions of the time since a flight's start [s]."""

    gain: Callable[[arb], tuple[arb, arb]]  # of its angle beyond uniform rotation [rad], and of its rate [rad/s]
    acceleration: Callable[[arb], arb]  # [rad/s^2]


def turn_of(scene: Scene, torque: float | None, start: arb, since: arb) -> Turn:
    """The box's rotation by a held torque [N m] or by the drive, in a flight from ``since`` [s] after ``start`` [s]."""
    if isinstance(scene.drive, Drive) and (torque is None or scene.drive.force_bound > 0.0):
        raise UndecidedError("a drive of functions", final=True)
    if torque is None and isinstance(scene.drive, Chirp):
        return chirp_turn(scene.drive, arb(scene.box_inertia), start, since)
    alpha = arb(torque or 0.0) / scene.box_inertia
    return Turn(lambda s: (alpha * s * s / 2, alpha * s), lambda s: alpha)


def chirp_turn(chirp: Chirp, inertia: arb, start: arb, since: arb) -> Turn:
    """The rotation by a chirp: differences of closed integrals, as Taylor forms in the time after an exact start."""
    size, f0, k = arb(chirp.amplitude) / inertia, arb(chirp.start_frequency), arb(chirp.rate)
    if chirp.rate < 0.0:  # sin(2 pi (f0 t + k t^2 / 2)) is odd in (f0, k)
        size, f0, k = -size, -f0, -k
    with ctx.extraprec(32):  # the differences are small
        integrals = fresnel_integrals(f0, k) if chirp.rate else sine_integrals(f0)
        twice_start, once_start = integrals(start)

    def acceleration(u: arb) -> arb:
        return size * ((2 * f0 + k * (start + u)) * (start + u)).sin_pi()

    def gain(u: arb) -> tuple[arb, arb]:
        middle = u.mid()
        with ctx.extraprec(32):
            twice, once = integrals(start + middle)
            angle, rate = twice - twice_start - once_start * middle, once - once_start
        angle, rate, rest, alpha = size * angle, size * rate, u - middle, acceleration(u)
        return angle + rate * rest + alpha * rest * rest / 2, rate + alpha * rest

    angle_since, rate_since = gain(since)

    def gain_since(s: arb) -> tuple[arb, arb]:
        angle, rate = gain(since + s)
        return angle - angle_since - rate_since * s, rate - rate_since

    return Turn(gain_since, lambda s: acceleration(since + s))


def fresnel_integrals(f0: arb, k: arb) -> Callable[[arb], tuple[arb, arb]]:
    """Second and first integral of sin(2 pi (f0 t + k t^2 / 2)) for k > 0, by Fresnel's S and C.

    With z = sqrt(2 k) (t + f0 / k) and p = pi f0^2 / k the first is (cos p S(z) - sin p C(z)) / sqrt(2 k). The second
    follows from int S = z S + cos(pi z^2 / 2) / pi and int C = z C - sin(pi z^2 / 2) / pi (Abramowitz and Stegun 7.3).
    """
    root, (sine, cosine) = (2 * k).sqrt(), (f0 * f0 / k).sin_cos_pi()

    def integrals(t: arb) -> tuple[arb, arb]:
        z = root * (t + f0 / k)
        s, c = z.fresnel_s(), z.fresnel_c()
        wave, cowave = (z * z / 2).sin_cos_pi()
        twice = cosine * (z * s + cowave / arb.pi()) - sine * (z * c - wave / arb.pi())
        return twice / (2 * k), (cosine * s - sine * c) / root

    return integrals


def sine_integrals(f0: arb) -> Callable[[arb], tuple[arb, arb]]:
    """Second and first integral of sin(2 pi f0 t)."""
    if f0 == 0:
        return lambda t: (arb(0), arb(0))
    turning = 2 * arb.pi() * f0
    return lambda t: (-(2 * f0 * t).sin_pi() / (turning * turning), -(2 * f0 * t).cos_pi() / turning)


# -- flight and search -------------------------------------------------------------------------------------------------


class Form(NamedTuple):
    """A gap on an interval of times, by its Taylor form."""

    middle: arb  # the gap at the interval's midpoint [m]
    gap: arb  # [m]
    rate: arb  # [m/s]


class FreeFlight:
    """A motion without impacts, from a state on."""

    def __init__(self, scene: Scene, state: list[arb], turn: Turn) -> None:
        self.scene, self.state, self.turn = scene, state, turn

    def state_at(self, s: arb) -> list[arb]:
        """The state ``s`` [s] into the flight."""
        x, y, angle, x_jack, y_jack, angle_jack, vx, vy, omega, vx_jack, vy_jack, omega_jack = self.state
        turned, spun = self.turn.gain(s)
        fall = self.scene.gravity * s
        return [
            x + vx * s, y + vy * s, angle + omega * s + turned,
            x_jack + vx_jack * s, y_jack + (vy_jack - fall / 2) * s, angle_jack + omega_jack * s,
            vx, vy, omega + spun, vx_jack, vy_jack - fall, omega_jack,
        ]  # fmt: skip

    def is_clear(self, end: arb) -> bool:
        """Whether the jack's centre stays so near the box's until ``end`` [s] that no foot can reach a wall."""
        room = arb(self.scene.box_half_width) - self.scene.jack_arm
        s = arb(0).union(end)
        middle = s.mid()
        (x, vx), (y, vy) = ((self.state[i + 3] - self.state[i], self.state[i + 9] - self.state[i + 6]) for i in (0, 1))
        fall = self.scene.gravity * middle / 2
        x, y = x + vx * s, y + (vy - fall) * s + self.scene.gravity * (middle - s) * s / 2
        return bool(room > 0 and x * x + y * y < room * room)

    def forms(self, times: arb, pairs: Sequence[Pair]) -> dict[Pair, Form]:
        """Taylor forms of the gaps of some pairs, on an interval of times since the flight's start [s]."""
        middle = times.mid()
        s, state = times - middle, self.state_at(middle)
        half_square = (s * s).abs_upper() / 2
        square = arb(half_square, half_square)  # s^2 is not negative
        point = self.coefficients(state, arb(0), arb(0), arb(0))
        whole = self.coefficients(state, s, square, self.turn.acceleration(times))
        forms = {}
        for wall, foot in pairs:
            toe = 4 + (foot - wall) % 4
            gap = self.scene.box_half_width - point[wall][0] - point[toe][0]
            rate = -point[wall][1] - point[toe][1]
            half_second = -whole[wall][2] - whole[toe][2]
            forms[wall, foot] = Form(gap, gap + rate * s + half_second * square, rate + 2 * half_second * s)
        return forms

    def coefficients(self, state: list[arb], s: arb, square: arb, alpha: arb) -> list[arb_series]:
        """Power series, up to the second order, of the parts of the gaps at times about a midpoint.

        Args:
            state: at the midpoint.
            s: times since then [s].
            square: their squares [s^2].
            alpha: the box's acceleration at these times [rad/s^2].

        Returns:
            How far the jack's centre is from the box's towards walls 0 to 3, then a foot from the jack's centre whose
            angle is 0 to 3 quarter turns more than that of the wall's normal [m].
        """
        x, y, angle, x_jack, y_jack, angle_jack, vx, vy, omega, vx_jack, vy_jack, omega_jack = state
        g, half_alpha, vx, vy = arb(self.scene.gravity), alpha / 2, vx_jack - vx, vy_jack - vy
        across = arb_series([x_jack - x + vx * s, vx])
        up = arb_series([y_jack - y + vy * s - g * square / 2, vy - g * s, -g / 2])
        box = arb_series([angle + omega * s + half_alpha * square, omega + alpha * s, half_alpha])
        jack, arm = arb_series([angle_jack + omega_jack * s, omega_jack]), arb_series([arb(self.scene.jack_arm)])
        sine, cosine = box.sin_cos()
        beside, along = ((arm * part) for part in (jack - box).sin_cos())
        ahead, aside = cosine * across + sine * up, cosine * up - sine * across
        return [ahead, aside, -ahead, -aside, along, -beside, -along, beside]

    def first_impact(self, until: arb) -> tuple[arb, list[Pair]] | None:
        """The time of the first impact within ``until`` [s], and the pairs that may be the first; None without any.

        Raises:
            UndecidedError: it is not proven whether there is an impact, or where.
        """
        end = until.upper()
        if self.is_clear(end):
            return None
        shortest = end * arb(2) ** (-ctx.prec // 2)
        waiting: list[tuple[arb, arb, Sequence[Pair]]] = [(arb(0), end, EVERY_PAIR)]
        while waiting:
            start, stop, pairs = waiting.pop()
            forms = self.forms(start.union(stop), pairs)
            feet = [pair for pair, form in forms.items() if not (form.gap > 0 or form.rate > 0)]
            if all(forms[pair].rate < 0 for pair in feet):
                at_stop = self.forms(stop, feet) if feet else {}
                crossing = [pair for pair in feet if at_stop[pair].gap < 0]
                if all(at_stop[pair].gap > 0 for pair in feet if pair not in crossing):
                    if crossing:
                        return self.first_root(start, stop, until, crossing)
                    continue
            if stop - start < shortest:
                raise UndecidedError("an impact at a step's very end" if stop == end else "a tangency or rest")
            cut = (start + (stop - start) * SPLIT).mid()
            waiting += [(cut, stop, feet), (start, cut, feet)]
        return None

    def first_root(self, start: arb, stop: arb, until: arb, pairs: list[Pair]) -> tuple[arb, list[Pair]] | None:
        """The first root within ``until`` of falling gaps that end negative and its possible pairs, else None."""
        if not all(form.gap > 0 for form in self.forms(start, pairs).values()):
            raise UndecidedError("a foot that approaches from within a wall")
        roots = {pair: self.root(pair, start.union(stop)) for pair in pairs}
        last = min(root.upper() for root in roots.values())
        first = [pair for pair, root in roots.items() if not root > last]
        time = min(roots[pair].lower() for pair in first).union(last)
        if time > until:
            return None
        if not time < until:
            raise UndecidedError("an impact at a step's very end")
        return time, first

    def root(self, pair: Pair, times: arb) -> arb:
        """Enclose the only root of a falling gap by the interval Newton operator, as well as the bits allow."""
        while True:
            form = self.forms(times, [pair])[pair]
            narrower = times.intersection(times.mid() - form.middle / form.rate)
            if not 2 * narrower.rad() < times.rad():
                return narrower
            times = narrower
