"""Export of training runs as plain arrays, for ``scripts/export.py`` and the shipped networks."""

from __future__ import annotations

from pathlib import Path

from agents.policies.network import layers_of, write_with_layers
from agents.runs import CODE, EVALUATIONS, SETTINGS, TIME, read_settings, run_folder
from agents.training.models import load_model
from jackbox_env.tools.files import write_bytes


def export_policy(run: Path, folder: Path, trust: bool = False) -> None:
    """Write the policy of a run, its settings, its learning curve and its times into a folder, as plain arrays.

    Args:
        run: run folder, or a model file in one.
        folder: of the new files, see :mod:`agents.policies.network`.
        trust: as of :func:`load_model`.

    Raises:
        FileNotFoundError, ValueError: as :func:`load_model`.
    """
    layers = layers_of(load_model(run, trust).get_parameters()["policy"])
    source = run_folder(run) or run
    write_with_layers(folder, SETTINGS, read_settings(source), layers)
    for name in (CODE, EVALUATIONS, TIME):
        if (source / name).is_file():
            write_bytes(folder / name, (source / name).read_bytes())
