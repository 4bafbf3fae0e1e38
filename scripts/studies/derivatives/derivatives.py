"""Write docs/derivatives.md: uses of derivatives through impacts, with a picture of each, in about a minute."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scripts.studies import study
from scripts.studies.derivatives import bounce, gradients, ilqr, lyapunov
from scripts.studies.pages import figure, table

PICTURED = {"ilqr": ilqr, "bounce": bounce, "lyapunov": lyapunov}
PLANS = {"level": "PD controller", "planner": "planner's iCEM, 3 iterations", "longer": "iCEM, 50 iterations"}


def spread(estimate: Mapping[str, float], digits: int = 1) -> str:
    """A mean with its 95 % interval."""
    return f"{estimate['mean']:.{digits}f} ± {estimate['half_width']:.{digits}f}"


def filled(results: study.Record) -> dict[str, Any]:
    """The numbers of docs/derivatives.md."""
    rows = [
        [f"{row['horizon']:g} s", *(_norm(row[name]) for name in ("median", "low", "high"))]
        for row in results["gradients"]
    ]
    return {
        "rows": gradients.ROWS,
        "gradients": table(("horizon", "median", "5 %", "95 %"), rows),
        "ilqr": _ilqr(results["ilqr"]),
        "bounce": _bounce(results["bounce"]),
        "lyapunov": _lyapunov(results["lyapunov"]),
    }


def _norm(value: float) -> str:
    return f"{value:.0e}" if value > 1e4 else figure(float(f"{value:.2g}"))


def _ilqr(results: Mapping[str, Any]) -> dict[str, Any]:
    rows = [
        [PLANS[kind], spread(of["before"]), f"{of['planning']['mean']:.3f} s", spread(of["after"]),
         f"{of['seconds']['mean']:.3f} s", f"{of['iterations']['mean']:.0f}"]
        for kind, of in results.items()
    ]  # fmt: skip
    level, planner = results["level"], results["planner"]
    count = len(level["returns"])
    return {
        "problems": count,
        "level": {name: spread(level[name]) for name in ("before", "after")},
        "planner": {"gain": spread(planner["gain"]), "beyond": spread(planner["beyond_longer_icem"])},
        "table": table(("plan", "return", "its time", "after iLQR", "iLQR's time", "iterations"), rows),
        "clean": sum(count if of["rough"]["mean"] == 0.0 else 0 for of in results.values()),
        "all": count * len(results),
    }


def _bounce(results: Mapping[str, Any]) -> dict[str, Any]:
    at = results["spins"].index(bounce.SHOWN)
    shares = {name: f"{of_spins[at]:.0%}" for name, of_spins in results["share_held"].items()}
    return {
        "period": f"{bounce.PERIOD * bounce.DT:.2f}",
        "residuals": ", ".join(f"{value:.1g}" for value in results["residuals"][:5]),
        "largest": figure(math.hypot(*results["multipliers"][0])),
        "pairs": f"{max(abs(pair - 1.0) for pair in results['pairs']):.0e}",
        "seconds": f"{results['seconds']:g}",
        "starts": results["starts"],
        "spin": f"{bounce.SHOWN:g}",
        "upright": f"{bounce.UPRIGHT:g}",
        "held": shares["gains by phase"],
        "clock": shares["gains by clock"],
    }


def _lyapunov(results: Mapping[str, Any]) -> dict[str, Any]:
    ends = [of["forgotten_after_impacts"] for of in results.values()]
    factors = {policy: math.exp(of["log_per_impact"]["mean"]) for policy, of in results.items()}
    rows = [
        [f"`{policy}`", f"{spread(of['exponent'], 2)} / s", spread(of["impacts"]), figure(factors[policy]),
         f"{of['forgotten_after']:.0f} s", f"{of['forgotten_after_impacts']:.0f}"]
        for policy, of in results.items()
    ]  # fmt: skip
    heads = "torques of", "exponent", "impacts in 10 s", "growth per impact", "1e-16 is 0.1 after", "impacts"
    return {
        "starts": results["zero"]["starts"],
        "table": table(heads, rows),
        "growth": f"{min(factors.values()):.0f} to {max(factors.values()):.0f}",
        "ends": f"{min(ends):.0f} to {max(ends):.0f}",
    }


def draw(results: study.Record, folder: Path) -> None:
    """Draw the picture of each part that has one."""
    pictures = folder / "derivatives"
    pictures.mkdir(exist_ok=True)
    for name, part in PICTURED.items():
        (pictures / f"{name}.png").unlink(missing_ok=True)
        part.draw(results[name], pictures / f"{name}.png")


MEASURES = {
    "ilqr": ilqr.measure,
    "bounce": bounce.measure,
    "lyapunov": lyapunov.measure,
    "gradients": gradients.measure,
}
STUDY = study.Study(
    "derivatives",
    MEASURES,
    filled,
    alone=frozenset(MEASURES),
    packages=("jackbox", "numpy", "numba", "torch"),
    draw=draw,
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
