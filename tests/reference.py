"""The reference of docs/reference.md: 40 motions with every impact and state proven. ``make reference`` writes it.

Each number of a case is the float64 nearest to the decimal in ``cases.json``, and control step k lasts from k dt to
(k + 1) dt exactly. ``tests.proof`` encloses the motion of these numbers. A time is written only if both ends of its
ball round to the same 30 digits, a state or an impulse only if its ball is within half a spacing of the float64.
A motion that the proof leaves undecided raises UndecidedError: then the case must change.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Iterator, Sequence
from decimal import Context, Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

from flint import arb, ctx

from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.model.states import STATE_NAMES
from jackbox_env.tools.files import write_text
from scripts.referee import scene_of
from tests.proof import Proof, UndecidedError, prove
from tests.states import load

FOLDER = Path(__file__).parents[1] / "docs" / "reference"
PAGE = FOLDER.with_suffix(".md")  # its table has the durations and the numbers of impacts too
DT = 0.02  # [s]
DIGITS = 30  # of an impact's time
FIELDS = (
    "box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia", "gravity", "restitution",
)  # fmt: skip
RADIUS = 1e-40  # largest radius of a proven number [SI units]
ZERO = 1e-25  # a ball around 0 within this is written as 0 [SI units]
ASIDE = 1e-30  # by which a start moves for a derivative [SI units]

Case = dict[str, Any]  # of cases.json


# -- rounding ----------------------------------------------------------------------------------------------------------


def fraction(exact: arb) -> Fraction:
    """A ball of radius 0 as a fraction."""
    mantissa, exponent = exact.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def digits(ball: arb) -> str:
    """The 30 significant digits on which both ends of a ball agree."""
    context = Context(prec=DIGITS)
    ends = [fraction(end) for end in (ball.lower(), ball.upper())]
    low, high = (context.divide(Decimal(end.numerator), Decimal(end.denominator)) for end in ends)
    if low != high:
        raise UndecidedError(f"a time of fewer than {DIGITS} digits")
    return f"{low:.{DIGITS - 1 - low.adjusted()}f}"


def nearest(ball: arb) -> float:
    """The float64 nearest to a proven number."""
    if ball.contains(0) and ball.abs_upper() < ZERO:
        return 0.0
    number = float(fraction(ball.mid()))
    if not abs(ball - number) <= math.ulp(number) * (0.5 + 1e-9):
        raise UndecidedError(f"a float64 next to {number}")
    return number


# -- a case ------------------------------------------------------------------------------------------------------------


def proof_of(case: Case, start: Sequence[arb | float], **precision: Any) -> Proof:
    """Enclose the motion of a case from a start."""
    steps = round(case["duration"] / case["dt"])
    proof = prove(scene_of(case), start, case["torque"].get("values", [None] * steps), case["dt"], **precision)
    if not proof.decided:
        raise UndecidedError(f"{case['name']}: {proof.why}")
    return proof


def proven(case: Case) -> Case:
    """Add impacts and states to a case."""
    proof, every = proof_of(case, case["start"], radius=RADIUS), round(0.1 / case["dt"])
    with ctx.workprec(proof.bits):
        impacts = [
            {"time": digits(hit.time), "wall": hit.wall, "foot": hit.foot, "impulse": nearest(hit.impulse)}
            for hit in proof.impacts
        ]
        states = [list(map(nearest, state)) for state in proof.states[every::every]]
    return case | {"impacts": impacts, "states": states}


def derivatives(case: Case) -> list[list[float]]:
    """Derivatives of the end (rows) by the start (columns): differences of proven ends.

    Starts twice as far aside give the same 40 digits.
    """
    columns = []
    for index in range(len(STATE_NAMES)):
        with ctx.workprec(1024):
            ends = []
            for aside in (ASIDE, -ASIDE, 2 * ASIDE, -2 * ASIDE):
                start = list(map(arb, case["start"]))
                start[index] += aside
                ends.append(proof_of(case, start, radius=1e-90, bits=512).states[-1])
            near = [(plus - minus) / (2 * arb(ASIDE)) for plus, minus in zip(*ends[:2], strict=True)]
            far = [(plus - minus) / (4 * arb(ASIDE)) for plus, minus in zip(*ends[2:], strict=True)]
            if not all(abs(one - other) <= RADIUS * (1 + abs(one)) for one, other in zip(near, far, strict=True)):
                raise UndecidedError(f"{case['name']}: no derivative by {STATE_NAMES[index]}")
            columns.append(list(map(nearest, near)))
    return [list(row) for row in zip(*columns, strict=True)]


# -- the 40 cases ------------------------------------------------------------------------------------------------------


def case_of(
    name: str, about: str, scene: Scene, start: Sequence[float], duration: float, torques: list[float] | None = None,
    dt: float = DT,
) -> Case:  # fmt: skip
    """A case without its results; the torque is the scene's chirp, ``torques`` if there are any, or none."""
    torque: dict[str, Any] = {"kind": "none"}
    if torques is not None:
        torque = {"kind": "held", "values": torques}
    elif isinstance(scene.drive, Chirp):
        torque = {"kind": "chirp"} | {
            part: getattr(scene.drive, part) for part in ("amplitude", "start_frequency", "rate")
        }
    numbers = {field: getattr(scene, field) for field in FIELDS}
    start = list(map(float, start))
    return {
        "name": name, "about": about, "scene": numbers, "start": start, "torque": torque, "dt": dt,
        "duration": float(duration),
    }  # fmt: skip


def trajectories() -> Iterator[Case]:
    """The 20 motions of tests/data that an independent program computed with 60 digits."""
    words = {"chirp": "under the chirp", "held": "under random torques, each held for a step", "none": "without torque"}
    for record in (*load("exact_trajectories"), *load("loss_trajectories"), *load("seed_scene")):
        drive, loss = record["drive"], record.get("restitution", 1.0)
        scene = Scene(gravity=record["gravity"], restitution=loss, drive=Chirp() if drive == "chirp" else None)
        torques = [90000.0 * action for action in record["actions"]] if drive == "held" else None
        about = f"{record['T']} s {words[drive]}" + (f", restitution {loss}" if loss < 1.0 else "")
        start = record["q"] + record["qdot"]
        yield case_of(record["name"], f"{about}.", scene, start, record["T"], torques)


def differentiated() -> Iterator[Case]:
    """The 12 scenes of tests/data that have derivatives."""
    for number, record in enumerate(load("derivatives")):
        scene = Scene(**record["scene"], drive=None)
        about = (
            f"A jack of {scene.jack_mass:g} kg, arms of {scene.jack_arm:g} m, restitution {scene.restitution:g}; with "
            "derivatives."
        )
        torques, start = list(map(float, record["torques"])), record["start"]
        yield case_of(f"derivatives-{number}", about, scene, start, record["T"], torques, record["control_dt"])


def composed() -> Iterator[Case]:
    """Eight motions, each with one difficulty."""
    still, weightless = Scene(drive=None), Scene(gravity=0.0, drive=None)
    heavy = Scene(box_mass=4.0, box_inertia=144.0, jack_mass=400.0, jack_inertia=400.0, gravity=0.0, drive=None)
    draw = random.Random(0)
    strong, gentle = ([float(draw.randint(-top, top)) for _ in range(150)] for top in (90000, 50))
    pose = [0.0, 0.0, 0.0]
    yield case_of(
        "flight", "Free flight under held torques: no impact.", still,
        [0.5, -0.25, 0.125, 0.0, 1.0, 0.3, 0.2, 0.1, 0.5, 1.0, 4.0, -2.0], 1.2, strong[:60],
    )  # fmt: skip
    yield case_of("bounce", "One bounce: a drop, off centre.", still, [*pose, 0.7, 1.0, 0.3, *6 * [0.0]], 2.0)
    yield case_of("spin", "A jack that spins at 40 rad/s, for 10 s.", still,
                  [*pose, 0.5, 1.0, 0.2, *pose, 3.0, 0.0, 40.0], 10.0)  # fmt: skip
    yield case_of("two-feet", "Two feet reach the floor at heights that differ by 1e-9 m.", still,
                  [*pose, 0.3, 0.0, math.pi / 4.0 + 1e-9 / math.sqrt(2.0), *6 * [0.0]], 2.0)  # fmt: skip
    for name, about, height in (
        ("graze-passes", "A spinning foot passes the floor at a height of 1e-9 m, then the jack hits a wall.", 1e-9),
        ("graze-hits", "The same, 2e-9 m lower: the foot hits the floor.", -1e-9),
    ):
        yield case_of(name, about, weightless, [*pose, 2.0, height - 5.0, -0.3, *pose, 2.0, 0.0, 1.0], 2.0)
    yield case_of("corner", "A foot falls into the corner of a box turned by 45 degrees.", still,
                  [0.0, 0.0, 0.7854, 0.05, 0.0, 0.02, *6 * [0.0]], 2.0)  # fmt: skip
    yield case_of("heavy-jack", "A jack of 400 kg in a box of 4 kg, weightless, under held torques.", heavy,
                  [*pose, 0.5, 0.3, 0.4, *pose, 6.0, 2.0, 3.0], 3.0, gentle)  # fmt: skip


def cases() -> Iterator[Case]:
    """All 40, without their results."""
    yield from composed()
    yield from trajectories()
    yield from differentiated()


def completed(case: Case) -> Case:
    """A case with all that is proven of it."""
    with_derivatives = {"derivatives": derivatives(case)} if case["name"].startswith("derivatives") else {}
    return proven(case) | with_derivatives


def text_of(written: list[Case]) -> str:
    """The file: one line for each case."""
    lines = ",\n".join(json.dumps(case) for case in written)
    return f'{{"version": 1, "state": {json.dumps(STATE_NAMES)}, "cases": [\n{lines}\n]}}\n'


def main() -> None:
    """Write the file."""
    written = [completed(case) for case in cases()]
    write_text(FOLDER / "cases.json", text_of(written))
    impacts = sum(len(case["impacts"]) for case in written)
    print(f"Wrote {FOLDER / 'cases.json'}: {len(written)} cases, {impacts} impacts")


if __name__ == "__main__":
    main()
