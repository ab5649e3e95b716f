"""The command line: `etendue render`, `compare`, `resume`, `demo`, `methods`, `scenes`, `doctor`, `cite`."""
