"""Simulate the scene under its own drive: the command `jackbox simulate`."""

from __future__ import annotations

from jackbox_env.commands.simulate import main

if __name__ == "__main__":
    main()
