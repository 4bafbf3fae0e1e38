"""Export of training runs as plain arrays, for ``scripts/export.py`` and the shipped networks."""

from __future__ import annotations

from pathlib import Path

from agents.policies.network import NetworkPolicy, write_with_layers
from agents.policies.registry import policy_of_run
from agents.runs import EVALUATIONS, SETTINGS, TIME, run_folder
from jackbox_env.tools.files import write_bytes
from jackbox_env.tools.user_code import CODE


def export_policy(run: Path, folder: Path, trust: bool = False) -> None:
    """Write the policy of a run, its settings, its learning curve and its times into a folder, as plain arrays.

    Args:
        run: run folder, or a model file in one.
        folder: of the new files, see :mod:`agents.policies.network`.
        trust: as of :func:`agents.policies.registry.policy_of_run`.

    Raises:
        FileNotFoundError, ValueError: as ``policy_of_run``; or the policy observes pictures.
    """
    policy = policy_of_run(run, trust).policy
    if not isinstance(policy, NetworkPolicy):
        raise ValueError(f"{run} observes pixels, and only networks of numbers can be exported")
    write_with_layers(folder, SETTINGS, policy.settings, policy.layers)
    source = run_folder(run) or run
    for name in (CODE, EVALUATIONS, TIME):
        if (source / name).is_file():
            write_bytes(folder / name, (source / name).read_bytes())
