"""Folders of compiled code, named after a hash of all source that it may come from."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


_MOST_FOLDERS = 8  # of compiled code, one for each version of the source


# Where in this package stored code comes from: no file there imports one from elsewhere.
HASHED = "tools/", "model/", "jit/", "exact/", "gpu/", "render/raster.py"


@cache
def folder_name(package: Path = PACKAGE) -> str:
    """Folder of compiled code, by a hash of all that it may come from: the code of a function includes its callees."""
    paths = {path.relative_to(package).as_posix(): path for path in package.rglob("*.py")}
    sources = (paths[name].read_bytes() for name in sorted(paths) if name.startswith(HASHED))
    return f"compiled-{hashlib.sha256(b''.join(sources)).hexdigest()[:16]}"


def _tidy(parent: Path) -> None:
    """Remove code that was compiled from old versions of the source."""
    with contextlib.suppress(OSError):  # another process may be tidying too
        for old in sorted(parent.glob("compiled-*"), key=lambda folder: folder.stat().st_mtime)[:-_MOST_FOLDERS]:
            shutil.rmtree(old, ignore_errors=True)


def cache_folders() -> list[Path]:
    """Folders to search for compiled code. It is saved in the last, the first that can be written."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    parents, folders = [os.environ.get("NUMBA_CACHE_DIR"), PACKAGE / "__pycache__", Path(home, "jackbox")], list[Path]()
    for parent in (Path(parent).absolute() for parent in parents if parent):  # the process may change its folder
        folder = parent / folder_name()
        with contextlib.suppress(OSError):
            if not folder.is_dir():
                folder.mkdir(parents=True, exist_ok=True)
                _tidy(parent)
            folders.append(folder)
            if os.access(folder, os.W_OK):
                break
    return folders or [folder]


def shipped_folder() -> Path:
    """Folder of the code that a wheel ships; it need not exist."""
    return PACKAGE / "exact" / "shipped" / folder_name()
