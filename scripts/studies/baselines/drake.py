"""Drake 1.51: an event-driven system, integrated by Runge-Kutta with a witness function for each gap.

Law: smooth Lagrangian dynamics by the Runge-Kutta pair of order 3(2) with error control. A witness function for each
    wall and foot isolates the time at which a gap falls through 0. Its update applies the Lagrangian impact map.
Order: 3 in flight; a witness is isolated to 0.01 of the ``accuracy`` [s].
Cost: in docs/accuracy.md; Drake calls Python for each derivative and witness.
Fails: a foot that goes in and out again within a step of the integrator, at most ``longest`` [s], is missed.
Reference: Drake's documentation of ``Simulator`` and ``WitnessFunction``; its example of the bouncing ball.

``MultibodyPlant`` is not scored, as it has no restitution. At dissipation 0 a ball that falls 1 m keeps 85 % of its
speed in discrete steps of 0.3 ms by TAMSI, "similar" or "lagged", 0.1 % by SAP. Its continuous ones are springs.
"""

from __future__ import annotations

from functools import partial
from typing import Any, cast

from pydrake.systems import analysis, framework  # type: ignore[import-not-found,unused-ignore]

from jackbox_env.mechanics import impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES
from jackbox_env.simulators.base import Impact
from scripts.studies.baselines.base import Baseline, Pair, Trace
from scripts.studies.baselines.solve_ivp import event, slope


class Jack(framework.LeafSystem):  # type: ignore[misc,unused-ignore]
    """Box and jack as a system of 12 continuous states; its user sets ``torque``, and ``impacts``."""

    def __init__(self, scene: Scene) -> None:
        super().__init__()
        self.DeclareContinuousState(RATES, RATES, 0)
        self._scene, self._witnesses, self.impacts = scene, list[Any](), list[Impact]()
        self.torque: float | None = None
        falls = framework.WitnessFunctionDirection.kPositiveThenNonPositive
        for pair in (divmod(number, 4) for number in range(16)):
            gap, strike = partial(self._gap, event(scene, *pair)), partial(self._strike, pair)
            update = framework.UnrestrictedUpdateEvent(strike)
            self._witnesses.append(self.MakeWitnessFunction(f"gap {pair}", falls, gap, update))

    def DoGetWitnessFunctions(self, context: Any) -> list[Any]:  # noqa: D102, N802
        return self._witnesses

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:  # noqa: D102, N802
        state = context.get_continuous_state_vector().CopyToVector()
        derivatives.get_mutable_vector().SetFromVector(slope(self._scene, self.torque, context.get_time(), state))

    def _gap(self, gap: Any, context: Any) -> float:
        return float(gap(0.0, context.get_continuous_state_vector().CopyToVector()))

    def _strike(self, pair: Pair, context: Any, update: Any, state: Any) -> None:
        """Apply the impact map, unless an earlier update at this time has turned the foot."""
        vector = state.get_mutable_continuous_state().get_mutable_vector()
        after, impulse = impact_map(self._scene, vector.CopyToVector(), *pair)
        if impulse > 0.0:
            vector.SetFromVector(after)
            self.impacts.append(Impact(context.get_time(), *pair, impulse))


class Model(Baseline):
    """Drake, see the module's docstring."""

    def __init__(self, scene: Scene, accuracy: float, scheme: str, longest: float) -> None:
        super().__init__(scene, 1)
        self._simulator = analysis.Simulator(system := Jack(scene))
        self._system, self._context = system, cast(Any, self._simulator.get_mutable_context())
        analysis.ResetIntegratorFromFlags(self._simulator, scheme, longest).set_target_accuracy(accuracy)
        self._context.SetAccuracy(accuracy)

    def _simulate(
        self, state: list[float], time: float, h: float, torque: float | None, impacts: Any, trace: Trace | None = None
    ) -> tuple[list[float], float]:
        self._context.SetTimeAndContinuousState(time, state)
        self._system.torque, self._system.impacts = torque, []
        self._simulator.Initialize()
        self._simulator.AdvanceTo(time + h)
        impacts += [(hit, False) for hit in self._system.impacts]
        return self._context.get_continuous_state_vector().CopyToVector().tolist(), self._torque(time, h, torque)
