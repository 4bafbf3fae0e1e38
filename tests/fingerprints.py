"""Digests of results of simulators, environments, batches and rollouts: ``python -m tests.fingerprints exact pymunk``.

Equal digests mean results that are equal to the last bit. The drives' functions use no C library.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
from numba.core.registry import cpu_target

from jackbox_env import Chirp, Drive, Scene, make_simulator, rollout
from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.exact.geometry import cos_sin
from jackbox_env.simulators.contacts import iterations_for

Digests = dict[str, str]


def wave(time: float) -> float:
    """Smooth."""
    return 3e4 * float(cos_sin(9.0 * time)[0])


def bent(time: float) -> float:
    """Arcs, whose slope jumps."""
    share = 1.7 * time % 1.0
    return 3e5 * share * (1.0 - share) * (0.5 - share)


def square(time: float) -> float:
    """A square wave."""
    return 6e4 if time % 0.31 < 0.17 else -5e4


DRIVES = {
    "no drive": None,
    "chirp": Chirp(),
    "smooth functions": Drive(torque=wave, force_x=bent),
    "bent functions": Drive(torque=bent, force_x=wave, force_y=bent),
    "functions that jump": Drive(torque=square, force_x=square),
}
FREE = [0.0] * 9 + [3.0, -2.0, 4.0]
RESTING = [0.0] * 4 + [-5.0] + [0.0] * 4 + [0.3, 0.0, 0.0]
TURNED = [0.0, 0.0, 3e6, 0.0, 1.0, 2.3e9, 0.0, 0.0, 1.0, 1.0, 1.0, 20.0]


def digest(parts: Iterable[Any]) -> str:
    """Digest of the bits of numbers and arrays."""
    hashed = hashlib.sha256()
    for part in parts:
        array = np.ascontiguousarray(part)
        assert array.dtype != object, f"the bits of {part} are an address"
        hashed.update(array.tobytes())
    return hashed.hexdigest()[:16]


def simulated(contact: str, scene: Scene, start: list[float], steps: int, held: bool) -> str:
    """States and impacts of a simulator, under held torques or the drive."""
    simulator, rng = make_simulator(scene, contact), np.random.default_rng(3)
    simulator.reset(start)
    parts: list[Any] = []
    for torque in rng.uniform(-1.0, 1.0, steps).tolist():
        simulator.step(0.02, torque * scene.torque_limit if held else None)
        parts += [simulator.state, simulator.torque, *map(np.array, simulator.impacts)]
    return digest(parts)


def played(contact: str, scene: Scene, task: str, steps: int) -> str:
    """Digest of the results of an environment."""
    env = JackInBoxEnv(contact=contact, scene=scene, task=task)
    observation, info = env.reset(seed=1)
    parts: list[Any] = [observation]
    for number in range(steps):
        observation, reward, _, _, info = env.step(None if number % 40 < 20 else 0.7)
        parts += [observation, reward, *(info[name] for name in info if name != "duration")]
    return digest(parts)


def batched(contact: str, scene: Scene, task: str, count: int, steps: int) -> str:
    """Digest of the results of a batch of environments."""
    env = JackInBoxVectorEnv(
        count, contact=contact, scene=scene, task=task, with_infos=True, max_episode_steps=70,
        autoreset_mode="SAME_STEP",
    )  # fmt: skip
    rng = np.random.default_rng(1)
    parts: list[Any] = [env.reset(seed=5)[0]]
    for number in range(steps):
        actions = rng.uniform(-1.0, 1.0, (count, 1))
        observations, rewards, _, truncations, infos = env.step(None if number % 40 < 20 else actions)
        parts += [observations, rewards, truncations, env.states, env.times, infos["torque"], infos["impulse"]]
    return digest(parts)


def pictured(contact: str, scene: Scene) -> str:
    """Digest of the pictures that single environments and a batch observe, of every size and at every angle."""
    parts: list[Any] = []
    for name in ("pixels", "pixels-36x50x3"):
        env = JackInBoxEnv(contact=contact, scene=scene, observation=name)
        parts.append(env.reset(seed=2)[0])
        parts += [env.step(None)[0] for _ in range(20)]
    batch = JackInBoxVectorEnv(5, contact=contact, scene=scene, observation="pixels-48x48x2", action_repeat=2)
    parts.append(batch.reset(seed=5)[0])
    return digest([*parts, *(batch.step(np.full((5, 1), 0.3))[0] for _ in range(10))])


def rolled(scene: Scene) -> str:
    """Digest of rollouts."""
    rng = np.random.default_rng(0)
    states = np.tile(FREE, (5, 1))
    states[:, 9:] += rng.normal(size=(5, 3))
    torques = rng.uniform(-9e4, 9e4, (5, 150))
    return digest(rollout(scene, states, torques, 0.02, energy=True, impacts=True, rewards="rattle")[:5])


def of_contact_model(contact: str, steps: int) -> Digests:
    """Digests of a contact model under every kind of drive."""
    digests: Digests = {}
    for (name, drive), task in zip(DRIVES.items(), ("juggle", "spin", "rattle", "juggle", "rattle"), strict=True):
        scene = Scene(drive=drive)
        digests[f"{contact}, simulator, {name}"] = simulated(contact, scene, FREE, steps, held=False)
        digests[f"{contact}, simulator, {name}, held torques"] = simulated(contact, scene, FREE, steps, held=True)
        digests[f"{contact}, {task}, {name}"] = played(contact, scene, task, steps)
        count = 33 if contact == "exact" else 2
        digests[f"{contact}, batch, {task}, {name}"] = batched(contact, scene, task, count, steps)
        if contact == "exact":
            digests[f"rollout, {name}"] = rolled(scene)
    odd = Scene(box_half_width=3.7391, jack_arm=0.61237, box_mass=211.3, jack_mass=5.31, torque_limit=2e4, drive=None)
    digests[f"{contact}, an odd scene"] = simulated(contact, odd, FREE, steps, held=True)
    digests[f"{contact}, pictures"] = pictured(contact, odd)
    digests[f"{contact}, at rest"] = simulated(contact, Scene(drive=None), RESTING, 10, held=False)
    digests[f"{contact}, with loss"] = simulated(contact, Scene(restitution=0.5, drive=None), FREE, steps, held=True)
    digests[f"{contact}, many turns"] = simulated(contact, Scene(drive=None), TURNED, steps, held=True)
    return digests


def of_scenes() -> Digests:
    """Digests of quantities derived from scenes, and of cosines of large angles."""
    rng = np.random.default_rng(0)
    sizes = rng.uniform([1.0, 0.1], [9.0, 1.4], (10_000, 2)).tolist()
    scenes = [Scene(box_half_width=width, jack_arm=arm) for width, arm in sizes]
    inertias = [(scene.box_inertia, scene.jack_inertia) for scene in scenes]
    light = [  # jacks that couple their feet, and get wedged
        Scene(box_half_width=scene.box_half_width, jack_arm=1.1 * scene.box_half_width, jack_inertia=share)
        for scene, share in zip(scenes, rng.uniform(0.5, 5.0, 200).tolist(), strict=False)
    ]
    cosines = map(cos_sin, np.ldexp(rng.uniform(1.0, 2.0, 4000), rng.integers(20, 52, 4000)).tolist())
    return {
        "inertias": digest(inertias),
        "iterations": digest(map(iterations_for, light)),
        "cosines of many turns": digest(cosines),
    }


def of_libraries() -> Digests:
    """Digests of other libraries' results. They may differ between machines: this shows that a setting took effect."""
    rng = np.random.default_rng(0)
    angles, matrix = rng.uniform(-30.0, 30.0, 100_000), rng.normal(size=(13, 13))
    return {
        "C": digest(map(math.cos, angles.tolist())),
        "NumPy": digest([np.exp(angles)]),
        "BLAS": digest([np.linalg.inv(matrix)]),
        "numba": digest([np.array(repr(cpu_target.target_context.codegen().magic_tuple()))]),
    }


def fingerprints(kinds: Iterable[str]) -> Digests:
    """The digests of these kinds: ``exact``, ``pymunk``, ``scenes``, ``libraries``."""
    digests: Digests = {}
    for kind in kinds:
        if kind in ("exact", "pymunk"):
            digests |= of_contact_model(kind, 150 if kind == "exact" else 60)
        else:
            digests |= of_scenes() if kind == "scenes" else of_libraries()
    return digests


if __name__ == "__main__":
    print(json.dumps(fingerprints(sys.argv[1:])))
