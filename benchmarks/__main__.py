"""``python -m benchmarks [COMMAND]``; alone, all of them. The command ``list`` shows those of all programs."""

from .registry import main

if __name__ == "__main__":
    main("benchmarks")
