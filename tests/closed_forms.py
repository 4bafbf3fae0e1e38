"""Closed forms with many digits that several tests compare with."""

from __future__ import annotations

from typing import Any

import mpmath as mp

from jackbox_env.scene import Chirp


def chirp_motion_by_fresnel(chirp: Chirp, box_inertia: float, time: float, dt: float) -> tuple[float, float]:
    """Change of omega_box [rad/s] and of theta_box [rad] from rest over a step under a chirp of positive rate.

    By Fresnel integrals (Abramowitz and Stegun 7.3) with 50 digits.
    """
    with mp.workdps(50):
        f0, k = mp.mpf(chirp.start_frequency), mp.mpf(chirp.rate)
        c, s, root = mp.cos(mp.pi * f0**2 / k), mp.sin(mp.pi * f0**2 / k), mp.sqrt(2 * k)

        def once(t: Any) -> Any:
            z = root * (t + f0 / k)
            return (c * mp.fresnels(z) - s * mp.fresnelc(z)) / root

        def twice(t: Any) -> Any:
            z = root * (t + f0 / k)
            part = c * (z * mp.fresnels(z) + mp.cos(mp.pi * z * z / 2) / mp.pi)
            return (part - s * (z * mp.fresnelc(z) - mp.sin(mp.pi * z * z / 2) / mp.pi)) / (2 * k)

        start, end, scale = mp.mpf(time), mp.mpf(time) + mp.mpf(dt), mp.mpf(chirp.amplitude) / mp.mpf(box_inertia)
        spun = scale * (once(end) - once(start))
        turned = scale * (twice(end) - twice(start) - once(start) * mp.mpf(dt))
        return float(spun), float(turned)
