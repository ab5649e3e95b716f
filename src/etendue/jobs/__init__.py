"""Jobs: what is asked for, what runs, and what it leaves behind. So far for lines through patches."""

from .lines import LinesJob, LinesTask

__all__ = ["LinesJob", "LinesTask"]
