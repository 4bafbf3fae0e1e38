"""Whether a GPU computes the CPU's bits, and its steps a second, in two halves: where the project is, and on a card.

python scripts/studies/speed/gpu.py --prepare FOLDER   # anywhere: the kernel, rows and the CPU's results
python scripts/studies/speed/gpu.py --on-card FOLDER   # needs numpy, PyTorch and cuda-core alone; some minutes
python scripts/studies/speed/gpu.py --envs             # environments on a card; needs the whole package there
python scripts/recipes/with_cleanrl.py --landing --device cuda   # a training on juggle that stays on it
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

DT, REPEAT, STEPS = 0.02, 4, 200
TASK = "rattle"
CASES = {"elastic": (1.0, 0.0, 1.0), "loss": (0.7, 0.0, 5.0), "many turns": (1.0, 3e6, 5.0), "fast": (1.0, 0.0, 30.0)}
SIZES, BLOCKS, TIMED = (4096, 65536, 524288), (32, 64, 128), 100  # rows, threads in a block, steps
Arrays = dict[str, Any]


def rows_of(restitution: float, turned: float, factor: float, rows: int) -> tuple[Any, Arrays]:
    """A scene, and states and torques: angles from ``turned`` [rad] on, rates in multiples of ``factor``."""
    from jackbox_env import Scene

    rng, scene = np.random.default_rng(0), Scene(restitution=restitution)
    states = np.zeros((rows, 12))
    states[:, 3:5], states[:, 5] = rng.uniform(-1.0, 1.0, (rows, 2)), rng.uniform(-0.5, 0.5, rows)
    states[:, [2, 5]] += turned
    states[:, 8:] = factor * rng.normal(size=(rows, 4))
    torques = scene.torque_limit * rng.uniform(-1.0, 1.0, (rows, STEPS // REPEAT))
    return scene, {"values": np.array([scene.numbers], np.float64), "states": states, "torques": torques}


def prepare(folder: Path, rows: int = 1250) -> None:
    """Write the kernel, and ``rows`` of each case with the CPU's results."""
    from jackbox_env import rollout
    from jackbox_env.gpu.ptx import ptx_of

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "kernel.ptx").write_text(ptx_of(TASK))
    for name, case in CASES.items():
        scene, drawn = rows_of(*case, rows)
        played = rollout(
            scene, drawn["states"], drawn["torques"], DT, repeat=REPEAT, impacts=True, rewards=TASK, trajectories=False
        )
        results: Arrays = {"last": played.trajectories[:, 1], "hits": played.impacts, "rewards": played.rewards}
        np.savez_compressed(folder / f"{name}.npz", **drawn, **results)


def device_module() -> Any:
    """``jackbox_env/gpu/device.py`` without its package, which imports gymnasium."""
    sys.path.insert(0, str(Path(__file__).parents[3] / "jackbox_env" / "gpu"))
    return importlib.import_module("device")


def compared(folder: Path, device: Any, launch: Any, place: str) -> Iterator[tuple[str, int, int, int]]:
    """For each case: its name, rows with the CPU's bits, rows that were played, and rows left to the CPU."""
    for name in CASES:
        stored = np.load(folder / f"{name}.npz")
        played = run(device, launch, place, stored, device.Wanted(impacts=True, rewards=True))
        done, equal = played.ended.cpu().numpy() == 0, np.ones(len(stored["states"]), np.bool_)
        for field in ("last", "hits", "rewards"):
            got = np.ascontiguousarray(getattr(played, field).cpu().numpy())
            equal &= (got.view(np.int64) == stored[field].view(np.int64)).all(axis=1)
        yield name, int((done & equal).sum()), int(done.sum()), int((~done).sum())


def run(device: Any, launch: Any, place: str, arrays: Any, wanted: Any) -> Any:
    """Play rows from arrays by these names."""
    import torch

    values, states, torques = (torch.from_numpy(arrays[name]).to(place) for name in ("values", "states", "torques"))
    return device.play(launch, values, states, torques, DT, REPEAT, states.new_zeros(len(states)).long(), wanted)


def speeds(folder: Path, device: Any, ptx: str) -> Iterator[tuple[int, int, float, float]]:
    """Rows, threads in a block, steps a second, and the share of rows left to the CPU."""
    import torch

    stored, rng = np.load(folder / "elastic.npz"), np.random.default_rng(0)
    values, states = (torch.from_numpy(stored[name]).cuda() for name in ("values", "states"))
    for rows in SIZES:
        drawn = torch.from_numpy(rng.integers(0, len(states), rows)).cuda()
        torques = torch.from_numpy(stored["torques"]).cuda()[drawn, : TIMED // REPEAT]
        for block in BLOCKS:
            launch, best = device.launcher(ptx, block), math.inf
            for _ in range(3):
                ended = torch.zeros(rows, dtype=torch.int64, device="cuda")
                begin = time.perf_counter()
                device.play(launch, values, states[drawn], torques, DT, REPEAT, ended, device.Wanted())
                best = min(best, time.perf_counter() - begin)
            yield rows, block, rows * TIMED / best, ended.count_nonzero().item() / rows


def envs_on_card(place: str = "cuda", sizes: tuple[int, ...] = SIZES, steps: int = TIMED) -> int:
    """Print whether environments on the present GPU have the CPU's bits, and their speeds; 1 if a bit differs."""
    import gymnasium as gym
    import torch

    import jackbox_env  # noqa: F401  # registers JackInBox-v0

    keywords: Any = {"fidelity": "exact", "task": TASK, "episode_steps": 2 * steps // 3}
    wrong = 0
    card, cpu = (gym.make_vec("JackInBox-v0", 256, device=one, **keywords) for one in ("cuda", None))
    both = zip(card.reset(seed=0)[:1], cpu.reset(seed=0)[:1], strict=True)
    for _ in range(steps + 1):
        wrong += sum(not np.array_equal(one.cpu().numpy(), other) for one, other in both)
        actions = cpu.action_space.sample()
        both = zip(card.step(actions)[:4], cpu.step(actions)[:4], strict=True)
    print(f"{wrong} of {4 * steps + 1} arrays of 256 environments differ from the CPU's", flush=True)
    for rows in sizes:
        envs, actions = gym.make_vec("JackInBox-v0", rows, device="cuda", **keywords), torch.rand(rows, device=place)
        envs.reset(seed=0)
        begin = time.perf_counter()
        for _ in range(steps):
            envs.step(2.0 * actions - 1.0)
        print(f"{rows} environments: {rows * steps / (time.perf_counter() - begin):.3g} steps a second", flush=True)
    return 1 if wrong else 0


def on_card(folder: Path) -> int:
    """Print what the present GPU computes, and how fast; 1 if a bit differs."""
    import torch

    device, ptx, wrong = device_module(), (folder / "kernel.ptx").read_text(), 0
    begin = time.perf_counter()
    launch = device.launcher(ptx)
    print(f"{torch.cuda.get_device_name()}, kernel loaded in {time.perf_counter() - begin:.1f} s", flush=True)
    for name, equal, played, left in compared(folder, device, launch, "cuda"):
        wrong += played - equal
        print(f"{name}: {equal} of {played} rows of {STEPS} steps have the CPU's bits, {left} left to it", flush=True)
    for rows, block, rate, share in speeds(folder, device, ptx):
        print(
            f"{rows} rows, {block} threads a block: {rate:.3g} steps a second, {share:.2%} left to the CPU", flush=True
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    half = parser.add_mutually_exclusive_group(required=True)
    half.add_argument("--prepare", type=Path, metavar="FOLDER")
    half.add_argument("--on-card", type=Path, metavar="FOLDER")
    half.add_argument("--envs", action="store_true")
    arguments = parser.parse_args()
    if arguments.envs:
        sys.exit(envs_on_card())
    if arguments.on_card:
        sys.exit(on_card(arguments.on_card))
    prepare(arguments.prepare)
