"""``python -m benchmarks.particles [COMMAND]``; without a command all of them."""

from ..registry import main

if __name__ == "__main__":
    main("benchmarks.particles")
