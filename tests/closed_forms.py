"""Closed forms with many digits that several tests compare with."""

from __future__ import annotations

from flint import arb, ctx

from jackbox_env.model.scene import Chirp
from tests.proof import chirp_turn


def chirp_motion(chirp: Chirp, box_inertia: float, time: float, dt: float) -> tuple[float, float]:
    """Change of omega_box [rad/s] and of theta_box [rad] from rest over a step under a chirp."""
    with ctx.workprec(256):
        turned, spun = chirp_turn(chirp, arb(box_inertia), arb(time), arb(0)).gain(arb(dt))
    return float(spun), float(turned)
