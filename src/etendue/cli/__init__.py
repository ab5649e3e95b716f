"""The command line: `etendue render`, `run`, `compare`, `resume`, `demo`, `methods`, `scenes`, `doctor`, `cite`."""
