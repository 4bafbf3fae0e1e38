"""``python -m jackbox_env`` is the command ``jackbox``."""

from __future__ import annotations

from jackbox_env.commands.main import main

if __name__ == "__main__":
    main()
