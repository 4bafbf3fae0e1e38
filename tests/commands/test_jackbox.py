"""The command ``jackbox`` in a checkout."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jackbox_env.simulators.base import StepResult
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.tools.command_line import bar, command_line
from jackbox_env.tools.files import new_file
from tests.script import jackbox


def test_it_names_its_commands_and_refuses_another(tmp_path: Path) -> None:
    refused = jackbox("juggle", cwd=tmp_path, status=2).stderr
    assert "'juggle'" in refused
    for arguments in ([], ["--help"]):
        out = jackbox(*arguments, cwd=tmp_path).stdout
        for name in ("simulate", "play", "check", "demo", "train", "evaluate", "export"):
            assert f"\n  {name} " in out
            assert name in refused
    assert "usage: jackbox evaluate" in jackbox("evaluate", "--help", cwd=tmp_path).stdout


@pytest.mark.parametrize(("leads", "status"), [("| true", 141), (">/dev/full", 2)])
def test_files_are_written_wherever_the_output_leads(tmp_path: Path, leads: str, status: int) -> None:
    simulate = f"{sys.executable} -m jackbox_env simulate --seconds 0.1 --no-plots --folder run --fidelity coarse"
    command = ["bash", "-c", f"{simulate} {leads}; exit ${{PIPESTATUS[0]}}"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == status, done.stderr
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["impacts.csv", "scene.json", "states.csv"]
    lines = [line for line in done.stderr.splitlines() if line.strip() and "step/s" not in line]
    assert lines == ["standard output, or a file, cannot be used: No space left on device"] * (status == 2)


def test_check_passes_here(tmp_path: Path) -> None:
    out = jackbox("check", cwd=tmp_path).stdout
    assert out.count("ok      ") == 6
    assert "derivatives: ready after" in out
    extras = [line.split()[1] for line in out.splitlines() if line.startswith("  extra")]
    assert extras == ["gpu:", "notebooks:", "scale:", "train:", "video:"]
    assert "over 3 impacts energy and work agree" in out


def test_check_sees_another_law_of_impact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stepped = ExactSimulator.stepped

    def other(self: ExactSimulator, dt: float, torque: float | None) -> StepResult:
        result = stepped(self, dt, torque)
        wrong = np.asarray(result.state) * np.where(np.arange(12) == 10, 1.0 + 1e-6, 1.0)
        return result._replace(state=wrong) if result.impacts else result

    monkeypatch.setattr(ExactSimulator, "stepped", other)
    out = jackbox("check", cwd=tmp_path, status=1).stdout
    assert re.search("FAILED  exact model, law: RuntimeError: over 3 impacts .* differ by .*e-0[678] ", out)
    assert out.count("ok      ") == 5


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (KeyboardInterrupt(), 130, ""),
        (BrokenPipeError(), 141, ""),
        (ImportError("no engine"), 2, "no engine; this command needs more packages"),
        (OSError(28, "No space left on device"), 2, "cannot be used: No space left on device"),
        (ValueError("dt must be"), 2, "dt must be"),
        (MemoryError(), 2, "there is not enough memory"),
    ],
)
def test_every_end_of_a_command_has_its_status_and_at_most_one_sentence(
    error: BaseException, status: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    @command_line
    def main() -> None:
        raise error

    with pytest.raises(SystemExit) as ended:
        main()
    stderr = capsys.readouterr().err
    assert ended.value.code == status
    assert said in stderr
    assert stderr.count("\n") == bool(said)


def test_a_command_that_is_terminated_leaves_no_partial_file(tmp_path: Path) -> None:
    @command_line
    def main() -> None:
        with new_file(tmp_path / "film.gif") as partial:
            partial.write_bytes(b"GIF89a")
            signal.raise_signal(signal.SIGTERM)

    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # Ray leaves a handler of its own in a process
    with pytest.raises(SystemExit, match="143"):
        main()
    assert list(tmp_path.iterdir()) == []


def test_a_bar_needs_no_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)  # as in Windows' pythonw
    with bar(2, True) as moving:
        moving.update(1)
