"""The command line `etendue`: a module per command or group of commands, and `main` with their options."""
