"""``python -m etendue`` is the command ``etendue``."""

import sys

from etendue.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
