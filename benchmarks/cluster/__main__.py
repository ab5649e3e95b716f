"""``python -m benchmarks.cluster [COMMAND]``; without a command all of them."""

from ..registry import main

if __name__ == "__main__":
    main("benchmarks.cluster")
