"""Files that survive kills: they are replaced as a whole and in the right order. One process locks a folder."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path

import pytest

from agents.runs import LOCK, FolderInUseError, locked
from jackbox_env.tools.files import new_file, new_folder, remove_partials, replacing, write_json, write_text
from tests.agents.killing import ended, start

# -- writing ----------------------------------------------------------------------------------------------------------


def fail(path: Path, error: BaseException, name: str | None = None) -> None:
    """Fail while a file is written. With ``name`` the unfinished file stays under it, as a kill does."""
    with replacing(path) as partial:
        partial.write_text("ne")
        if name is not None:
            partial.rename(path.with_name(name))
        raise error


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(OSError, match=r"No space left on device: '.*file.txt'"):
        fail(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    with pytest.raises(KeyboardInterrupt):
        fail(path, KeyboardInterrupt())
    with pytest.raises(TypeError, match="not JSON serializable"):
        write_json(path, object())
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.txt"]
    assert path.read_text() == "old"
    with pytest.raises(FileExistsError, match="file.txt exists, and is never overwritten"), new_file(path):
        pass
    path.unlink()
    with pytest.raises(FileExistsError, match="file.txt exists, and is never overwritten"), new_file(path):
        path.write_text("appeared meanwhile")
    assert path.read_text() == "appeared meanwhile"


def test_a_folder_appears_together_with_what_is_in_it(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "run"

    def fill(folder: Path) -> None:
        assert not path.exists()
        write_text(folder / "settings.json", "{}")

    def fails(folder: Path) -> None:
        write_text(folder / "settings.json", "{}")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        new_folder(path, "run", fails)
    assert list(path.parent.iterdir()) == []
    leftover = path.with_name(f".run.{os.getpid()}.partial")  # of a killed process that had this number
    leftover.mkdir()
    (leftover / "something").touch()
    new_folder(path, "run", fill)
    assert [entry.relative_to(tmp_path).as_posix() for entry in sorted(tmp_path.rglob("*"))] == [
        "runs",
        "runs/run",
        "runs/run/settings.json",
    ]


def test_partial_files_of_killed_processes_are_removed_and_nothing_else(tmp_path: Path) -> None:
    for name, partial in (("model.zip", ".model.zip.1.partial.zip"), ("no suffix", ".no suffix.22.partial")):
        with pytest.raises(KeyboardInterrupt):
            fail(tmp_path / name, KeyboardInterrupt(), partial)
    (tmp_path / ".run.3.partial").mkdir()
    (tmp_path / ".run.3.partial" / "settings.json").touch()
    assert len(list(tmp_path.iterdir())) == 3
    others = {".hidden", "model.partial.zip", "x.12.partial"}
    for name in others:
        (tmp_path / name).touch()
    (tmp_path / ".link.4.partial").symlink_to(tmp_path.parent, target_is_directory=True)
    remove_partials(tmp_path, tmp_path / "not there")
    assert {path.name for path in tmp_path.iterdir()} == others


# -- holding ----------------------------------------------------------------------------------------------------------


def hold(folder: Path, ready: Path) -> None:
    """Lock a folder for ever, in a separate process."""
    with locked(folder):
        ready.touch()
        time.sleep(60.0)


def test_a_folder_is_held_against_a_second_use_until_its_process_ends(tmp_path: Path) -> None:
    process, deadline = start(hold, tmp_path, tmp_path / "ready"), time.monotonic() + 60.0
    while not (tmp_path / "ready").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    with pytest.raises(FolderInUseError, match=f"^{tmp_path} is in use by another process: wait"), locked(tmp_path):
        pass
    process.kill()
    assert ended(process) == -9
    assert (tmp_path / LOCK).exists()  # it could not tidy up
    for _ in range(2):
        with locked(tmp_path):
            for _ in range(2):  # being refused has not let go of it
                with pytest.raises(FolderInUseError), locked(tmp_path):
                    pass
