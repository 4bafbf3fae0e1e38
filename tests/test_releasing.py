"""The command of docs/releasing.md that prepares the README for a package index."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ADDRESS = "https://example.org/jackbox"  # a reserved name, for tests
LINKS = re.compile(r'(!?)\[[^]]*\]\(([^)]*)\)|(?:src|href)="([^"]*)"')


def absolute(page: str, folder: Path) -> str:
    """The page after the command."""
    (command,) = re.findall(r"^sed .*$", (ROOT / "docs" / "releasing.md").read_text(), re.MULTILINE)
    (folder / "README.md").write_text(page)
    subprocess.run(command.replace("ADDRESS", ADDRESS), shell=True, cwd=folder, check=True)
    return (folder / "README.md").read_text()


@pytest.mark.skipif(sys.platform != "linux" or shutil.which("sed") is None, reason="the command is GNU sed's")
def test_the_readme_has_absolute_links_on_a_package_index(tmp_path: Path) -> None:
    page = (ROOT / "README.md").read_text()
    page += '[here](#limits) [there](https://farama.org) <a href="docs/a.md"><img src="docs/a.png"></a>\n'
    page += "[![p](docs/b.svg)](docs/b.md#part)\n"
    after = absolute(page, tmp_path)
    links = [link or other for _, link, other in LINKS.findall(after)]
    assert len(links) == len(LINKS.findall(page)) > 10
    assert [link for link in links if not link.startswith(("https://", "#"))] == []
    assert "](#limits) [there](https://farama.org)" in after
    assert f'<a href="{ADDRESS}/blob/HEAD/docs/a.md"><img src="{ADDRESS}/raw/HEAD/docs/a.png"></a>' in after
    assert f"[![p]({ADDRESS}/raw/HEAD/docs/b.svg)]({ADDRESS}/blob/HEAD/docs/b.md#part)" in after
    for path in re.findall(rf"{ADDRESS}/(?:blob|raw)/HEAD/([^)#\"]+)", after):
        assert (ROOT / path).exists() or path.startswith(("docs/a.", "docs/b.")), path
