"""MuJoCo 4.0: a stiff spring at each contact and semi-implicit Euler, tuned for elastic impacts as its manual advises.

Law: two free planar bodies. A foot inside a wall is pushed out with d2 gap/dt2 = -k gap, whatever the masses. Several
    such forces come from one convex problem, solved by Newton's method.
Order: first in h = dt / substeps: flight runs ahead by g h t / 2, and a bounce lasts two substeps, not none.
Cost: about 23 us per substep, a third of it in the engine.
Fails: feet go in by up to one substep's way at each impact. Restitution comes out as 1 only for a straight bounce; a
    jack that turns, or another contact in between, changes the gap's rate during the bounce. Elastic only.
Reference: MuJoCo documentation, "Modeling: Solver parameters" and "Computation: Soft contact model".

How it is tuned: for perfectly elastic collisions the manual recommends solref = (-stiffness, -damping) with damping 0.
The impedance is the highest accepted, 0.9999. Contacts are frictionless (condim 1). Newton's solver works to 1e-12,
without warm start so that the past does not act. The box's weight is compensated (gravcomp). Feet are spheres of radius
L / 10,000, and the walls, L / 2 thick, are set back by it.

The stiffness follows the substep: k = 2 / h^2. The manual recommends k h^2 <= 0.25 (a time constant of at least 2 h) to
keep springs stable. But semi-implicit Euler turns (gap, rate) by arccos(1 - k h^2 / 2) per substep: with k h^2 = 1 or 2
a bounce lasts exactly three or two, wherever in a substep the foot came in. Energy change of 100 single bounces at 3 to
10 m/s, jack turned by up to 0.3 rad, weightless, h = 5 ms, mean +- deviation in %:

    k h^2               0.0625        0.25          0.5           1              1.5          2              3
    Euler               -0.9 +- 1.5   -0.2 +- 2.6   +1.1 +- 6.9   -0.24 +- 0.32  +10 +- 26    -0.18 +- 0.32  +90 +- 110
    RK4 (4 times cost)  -1.1 +- 1.0   -0.7 +- 1.1   -1.4 +- 2.3   -3.8 +- 2.5    -8.5 +- 6.6  -13 +- 6       -19 +- 10

implicitfast equals Euler to all digits shown; in RK4 a contact begins within a step. Under the default chirp, at 1 to
64 substeps, feet go 2.2 to 2.8 times less deep with k h^2 = 2 than with 0.25, and the energy is kept better.

An impact begins with the first substep that starts with the foot in the wall. That is nearest to the time at which a
hard wall would have been hit; the deepest point comes half a bounce later. Its impulse is the sum over the bounce.
"""

from __future__ import annotations

import mujoco
import numpy as np

from jackbox_env.mechanics import gaps
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES
from scripts.studies.baselines.base import DIRECTIONS, Engine, Pair

_STIFFNESS = 2.0  # k h^2
_JOINTS = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>'


def model_xml(scene: Scene) -> str:
    """The scene as MuJoCo reads it: geoms 0 to 3 are the walls, 4 to 7 the feet."""
    half, radius = scene.box_half_width, 1e-4 * scene.box_half_width
    thick = 0.25 * half
    back, wide = half + radius + thick, half + 2.0 * thick
    walls = feet = ""
    for x, y in DIRECTIONS:
        size = (thick, wide) if x else (wide, thick)
        walls += (
            f'<geom type="box" pos="{x * back!r} {y * back!r} 0" size="{size[0]!r} {size[1]!r} {half!r}" '
            'contype="1" conaffinity="0"/>'
        )
        arm = scene.jack_arm
        feet += f'<geom type="sphere" pos="{x * arm!r} {y * arm!r} 0" size="{radius!r}" contype="0" conaffinity="1"/>'

    def inertial(mass: float, inertia: float) -> str:
        return f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'

    return f"""
    <mujoco>
      <compiler inertiafromgeom="false" angle="radian"/>
      <option gravity="0 {-scene.gravity!r} 0" integrator="Euler" solver="Newton" tolerance="1e-12">
        <flag warmstart="disable" island="disable" autoreset="disable"/>
      </option>
      <default><geom condim="1" mass="0" solref="-1 0" solimp="0.9999 0.9999 0.001 0.5 2"/></default>
      <worldbody>
        <body gravcomp="1">{_JOINTS}{inertial(scene.box_mass, scene.box_inertia)}{walls}</body>
        <body>{_JOINTS}{inertial(scene.jack_mass, scene.jack_inertia)}{feet}</body>
      </worldbody>
    </mujoco>"""


class Model(Engine):
    """MuJoCo, see the module's docstring."""

    def _build_unpickled(self) -> None:
        if self.scene.restitution != 1.0:
            raise ValueError(f"mujoco is tuned for elastic impacts only, got restitution {self.scene.restitution:g}")
        self._model = mujoco.MjModel.from_xml_string(model_xml(self.scene))
        self._data = mujoco.MjData(self._model)
        self._applied = self._data.qfrc_applied  # a view: asking for it anew costs a microsecond
        self._h = 0.0

    def _set_state(self, state: list[float], h: float) -> None:
        if h != self._h:
            self._model.opt.timestep = h
            self._model.geom_solref[:] = -_STIFFNESS / h**2, 0.0
            self._h = h
        self._data.qpos[:] = state[:RATES]
        self._data.qvel[:] = state[RATES:]

    def _substep(self, h: float, torque: float) -> dict[Pair, float]:
        data = self._data
        self._applied[2] = torque
        mujoco.mj_step(self._model, data)
        if data.ncon == 0:
            return {}
        pushes = {}
        for (one, other), row in zip(data.contact.geom.tolist(), data.contact.efc_address.tolist(), strict=True):
            wall, foot = min(one, other), max(one, other) - 4
            force = float(data.efc_force[row]) if row >= 0 else 0.0
            if force > 0.0:
                pushes[wall, foot] = force * h
        return pushes

    def _is_over(self, state: list[float], wall: int, foot: int) -> bool:
        """True when the foot is out of the wall."""
        return bool(gaps(self.scene, state)[wall, foot] > 0.0)

    def _read(self) -> list[float]:
        state: list[float] = np.concatenate([self._data.qpos, self._data.qvel]).tolist()
        return state
