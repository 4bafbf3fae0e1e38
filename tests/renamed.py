"""Runs code with a numba in which names are others: ``python -m tests.renamed NAME...``, each as in ``pipelines.py``.

It prints the error, or what compiled functions of a user return and how many names are lacking, then the warnings.
"""

from __future__ import annotations

import re
import sys
import warnings
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import CodeType
from typing import Any

# Where a name is not one of another library that numba uses too, nor a module's.
_WHERE = {
    "codegen": r"(?<!core\.)(?<!import )\bcodegen\b(?!\.[A-Z_]| import|,)",
    "finalize": r"(?:(?<=def )|(?<=\.)(?<!weakref\.))finalize\b", "overloads": r"(?<!import )\boverloads\b",
    "Dispatcher": r"(?<!_dispatcher\.)\bDispatcher\b", "dumps": r"(?<!pickle\.)\bdumps\b",
    "signature": r"(?<!inspect\.)(?<!inspect import )\bsignature\b",
}  # fmt: skip


class Loader(SourceFileLoader):
    """Loads a module whose source has another name."""

    pattern = ""

    def get_code(self, fullname: str) -> CodeType | None:
        """Compile the source with the other name; as ever if it does not have the name."""
        source = self.get_data(self.path).decode()
        renamed = re.sub(self.pattern, lambda name: f"{name[0]}_renamed", source)
        return super().get_code(fullname) if renamed == source else self.source_to_code(renamed.encode(), self.path)


class Finder(PathFinder):
    """Finds modules of numba and llvmlite."""

    @classmethod
    def find_spec(cls, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Find a module, with the loader above."""
        spec = super().find_spec(fullname, path) if fullname.split(".")[0] in ("numba", "llvmlite") else None
        if spec and isinstance(spec.loader, SourceFileLoader):
            spec.loader = Loader(fullname, spec.loader.path)
        return spec


def rename(names: list[str]) -> None:
    """Let numba and llvmlite, not imported yet, use other names instead of these."""
    words = (re.split(r"[:. ]", name)[-1] for name in names)
    Loader.pattern = "|".join(_WHERE.get(word, rf"\b{word}\b") for word in words)
    sys.meta_path.insert(0, Finder)


def judged() -> str:
    """What a user's functions of all kinds return, compiled, in 100 states."""
    import numpy as np
    from gymnasium.spaces import Box

    from jackbox_env import Action, Observation, Scene, Task, make_simulator
    from jackbox_env.simulators.agent_functions import CompiledFunctions
    from jackbox_env.simulators.plain_functions import Interface

    interface = Interface(
        Task(
            ("height", "share"), lambda scene, state, torque, impulse, by=3.0: (state[4] / by, torque / scene.gravity)
        ),
        Observation(("height",), -1e3, 1e3, lambda scene, state, time: (state[4] * time,)),
        Action(Box(-1.0, 1.0, (3,)), lambda scene, state, action, time, dt: action[0] * action[1] - action[2]),
    )
    functions, simulator, results = CompiledFunctions(Scene(), interface), make_simulator(contact="exact"), list[Any]()
    for state in np.random.default_rng(0).normal(size=(100, 12)):
        simulator.reset(state, 0.3)
        results += [*functions.step_and_score(simulator, 0.02, 2.0, True)[5:]]
        results.append(functions.share(state, state[:3], 0.0, 0.02))
    return repr(results)


if __name__ == "__main__":
    rename(sys.argv[1:])
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            print(judged())
            from jackbox_env.jit import pipelines

            print(len(pipelines.LACKING))
        except RuntimeError as error:
            print(error)
    for one in warned:
        print(one.message)
