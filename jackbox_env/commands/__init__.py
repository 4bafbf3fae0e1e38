"""What an installed wheel offers on the command line: simulate, play, check."""
