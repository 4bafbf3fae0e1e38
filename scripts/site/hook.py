"""Puts the page of `jackbox play` into each wheel; hatchling runs it. An editable install builds the page later."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class PageHook(BuildHookInterface[Any]):
    """Builds the page in a process of its own, unless it is up to date, and includes a copy."""

    _scratch: TemporaryDirectory[str] | None = None

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Include the page unless the ``version`` to build is "editable"; end the build if there can be no page."""
        if version == "editable":
            return
        if find_spec("numba") is None:
            self.app.display_warning("This wheel has no page of `jackbox play`: there is no numba for this Python.")
            return
        self._scratch = TemporaryDirectory()
        page = Path(self._scratch.name, "play.html")
        command = [sys.executable, "-m", "scripts.play", "--out", str(page)]
        if subprocess.run(command, cwd=self.root, stdout=subprocess.DEVNULL, check=False).returncode:
            self._scratch.cleanup()
            self.app.abort(
                "This wheel cannot be built, because the page of `jackbox play` cannot: the reason is above."
            )
        build_data["force_include"][str(page)] = "jackbox_env/recording/web/play.html"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the copy."""
        if self._scratch is not None:
            self._scratch.cleanup()
