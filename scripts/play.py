"""Play JackInBox-v0 with the keyboard: the command `jackbox play`."""

from __future__ import annotations

from jackbox_env.commands.play import main

if __name__ == "__main__":
    main()
