"""Write docs/derivatives.md: uses of derivatives through impacts, with a picture of each, in about a minute."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from jackbox_env.tools.command_line import command_line
from scripts.studies import timing
from scripts.studies.derivatives import bounce, gradients, ilqr, lyapunov
from scripts.studies.pages import figure, table

PACKAGES = ("jackbox", "numpy", "numba", "torch")
Part = Literal["ilqr", "bounce", "lyapunov", "gradients"]
PICTURED = {"ilqr": ilqr, "bounce": bounce, "lyapunov": lyapunov}
MEASURES = {name: part.measure for name, part in PICTURED.items()} | {"gradients": gradients.measure}
PLANS = {"level": "PD controller", "planner": "planner's iCEM, 3 iterations", "longer": "iCEM, 50 iterations"}


@dataclass(frozen=True)
class Arguments:
    """Measure everything, and write the page."""

    parts: tuple[Part, ...] = ("ilqr", "bounce", "lyapunov", "gradients")
    """Parts of the page to measure; the others stay as stored. None: only write the page from stored results."""
    out: Path = Path("docs")
    """Folder of the page derivatives.md, its results derivatives.json and the folder of its pictures, derivatives."""


def spread(estimate: Mapping[str, float], digits: int = 1) -> str:
    """A mean with its 95 % interval."""
    return f"{estimate['mean']:.{digits}f} ± {estimate['half_width']:.{digits}f}"


def page(results: Mapping[str, Any]) -> str:
    """docs/derivatives.md."""
    rows = [
        [f"{row['horizon']:g} s", *(_norm(row[name]) for name in ("median", "low", "high"))]
        for row in results["gradients"]
    ]
    fields = {
        "rows": gradients.ROWS,
        "gradients": table(("horizon", "median", "5 %", "95 %"), rows),
        "ilqr": _ilqr(results["ilqr"]),
        "bounce": _bounce(results["bounce"]),
        "lyapunov": _lyapunov(results["lyapunov"]),
        "made": "\n".join(f"- `{part}`: {text}" for part, text in results["made"].items()),
    }
    return (Path(__file__).parent / "page.md").read_text().format(**fields)


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


@command_line
def main() -> None:
    """Parse, measure, draw, write."""
    import tyro

    from jackbox_env.tools.files import check_writable, write_json, write_text

    arguments = tyro.cli(Arguments, description=__doc__)
    pictures, path = arguments.out / "derivatives", arguments.out / "derivatives.json"
    check_writable(arguments.out)
    results: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {"made": {}}
    missing = [name for name in MEASURES if name not in {*arguments.parts, *results}]
    if missing:
        raise ValueError(f"parts must name {' and '.join(missing)} too: {path} has no such results yet")
    for measured in arguments.parts:
        before = timing.core_seconds()
        results[measured] = MEASURES[measured]()
        results["made"][measured] = f"{timing.measured_with(PACKAGES)}. {timing.busy_since(before)}"
        write_json(path, results)
    pictures.mkdir(exist_ok=True)
    for name, part in PICTURED.items():
        (pictures / f"{name}.png").unlink(missing_ok=True)
        part.draw(results[name], pictures / f"{name}.png")
    write_text(arguments.out / "derivatives.md", page(results))
    print(f"Written: {arguments.out / 'derivatives.md'}")


if __name__ == "__main__":
    main()
