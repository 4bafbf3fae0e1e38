"""Drake 1.51: an event-driven system, integrated by Runge-Kutta with a witness function for each gap.

Law: smooth Lagrangian dynamics by the Runge-Kutta pair of order 3(2) with error control. A witness function for each
    wall and foot isolates the time at which a gap falls through 0. Its update applies the Lagrangian impact map.
Order: 3 in flight; a witness is isolated to 0.01 of the ``accuracy`` [s].
Fails: a witness triggers on a change of sign over a step of the integrator, at most ``longest`` [s]. A foot that goes in
    and out again within one is missed. Drake calls Python for derivatives and witnesses, which takes its time.
Reference: Drake's documentation of ``Simulator`` and ``WitnessFunction``; its example of the bouncing ball.

``MultibodyPlant`` is not scored: its discrete contacts have no restitution, and at dissipation 0 they are springs.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import LeafSystem, UnrestrictedUpdateEvent, WitnessFunctionDirection

from jackbox_env.mechanics import impact_map
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import RATES
from jackbox_env.simulators.base import Impact
from scripts.studies.baselines.base import Baseline, Pair, Trace
from scripts.studies.baselines.solve_ivp import event


class Jack(LeafSystem):  # type: ignore[misc]
    """Box and jack as a system of 12 continuous states."""

    def __init__(self, scene: Scene) -> None:
        super().__init__()
        self.DeclareContinuousState(RATES, RATES, 0)
        self._scene, self.impacts, falls = scene, list[Impact](), WitnessFunctionDirection.kPositiveThenNonPositive
        self.torque: float | None = None
        self._witnesses = []
        for pair in (divmod(number, 4) for number in range(16)):
            gap, update = event(scene, *pair), UnrestrictedUpdateEvent(partial(self._strike, pair))
            self._witnesses.append(self.MakeWitnessFunction(f"gap {pair}", falls, partial(self._gap, gap), update))

    def DoGetWitnessFunctions(self, context: Any) -> list[Any]:  # noqa: D102, N802
        return self._witnesses

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:  # noqa: D102, N802
        drive = self._scene.drive or Drive()
        load = drive.torque(context.get_time()) if self.torque is None and drive.torque else self.torque or 0.0
        rates = context.get_continuous_state_vector().CopyToVector()[RATES:].tolist()
        turning, falling = load / self._scene.box_inertia, -self._scene.gravity
        derivatives.get_mutable_vector().SetFromVector([*rates, 0.0, 0.0, turning, 0.0, falling, 0.0])

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
        self._system = Jack(scene)
        self._simulator = Simulator(self._system)
        ResetIntegratorFromFlags(self._simulator, scheme, longest).set_target_accuracy(accuracy)
        self._simulator.get_mutable_context().SetAccuracy(accuracy)

    def _simulate(
        self, state: list[float], time: float, h: float, torque: float | None, impacts: Any, trace: Trace | None = None
    ) -> tuple[list[float], float]:
        context = self._simulator.get_mutable_context()
        context.SetTimeAndContinuousState(time, state)
        self._system.torque, self._system.impacts = torque, []
        self._simulator.Initialize()
        self._simulator.AdvanceTo(time + h)
        impacts += [(hit, False) for hit in self._system.impacts]
        return context.get_continuous_state_vector().CopyToVector().tolist(), self._torque(time, h, torque)
