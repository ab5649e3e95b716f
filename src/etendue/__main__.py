"""``python -m etendue`` is the command ``etendue``."""

from etendue.cli.main import command

if __name__ == "__main__":
    command()
