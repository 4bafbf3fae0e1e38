"""Export of training runs as plain arrays, for ``scripts/export.py`` and the shipped networks."""

from __future__ import annotations

from pathlib import Path

from stable_baselines3.common.preprocessing import is_image_space

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
        FileNotFoundError, ValueError: as :func:`load_model`; or the policy observes pictures.
    """
    model = load_model(run, trust)
    if is_image_space(model.observation_space):
        raise ValueError(f"{run} observes pixels, and only networks of numbers can be exported")
    layers = layers_of(model.get_parameters()["policy"])
    source = run_folder(run) or run
    write_with_layers(folder, SETTINGS, read_settings(source), layers)
    for name in (CODE, EVALUATIONS, TIME):
        if (source / name).is_file():
            write_bytes(folder / name, (source / name).read_bytes())
