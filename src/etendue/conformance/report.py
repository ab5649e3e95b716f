"""Findings of a check: one for each component and test."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from etendue.core import InNotebooks, describe

Verdict = Literal["pass", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """The outcome of one test of one component."""

    component: str  #: name in the scene, such as ``material 'Glass' of type 'dielectric'``
    test: str  #: ``range``, ``energy``, ``reciprocity``, ``sampler`` and so on
    verdict: Verdict
    figure: float  #: the measured value; NaN if there is none
    limit: float  #: the largest value that passes
    meaning: str  #: description of the value; for a warning or failure its consequence and a remedy

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, which has no NaN and no infinity."""
        values = asdict(self)
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


@dataclass(frozen=True)
class Report(InNotebooks):
    """All findings about one scene; in a notebook a table of them by component."""

    source: str  #: path or name of the scene
    findings: tuple[Finding, ...]
    seconds: float  #: duration of the check

    @property
    def ok(self) -> bool:
        """Whether nothing failed; warnings are allowed."""
        return not self.failures

    @property
    def failures(self) -> tuple[Finding, ...]:
        """Findings that failed."""
        return tuple(f for f in self.findings if f.verdict == "fail")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that warn."""
        return tuple(f for f in self.findings if f.verdict == "warn")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        findings = [f.to_dict() for f in self.findings]
        return {"source": self.source, "ok": self.ok, "seconds": round(self.seconds, 3), "findings": findings}


@dataclass
class Findings:
    """Collects the findings about one component."""

    component: str
    known: Callable[[str], str] = lambda test: ""  #: known reason why this component fails a test, or ""
    rows: list[Finding] = field(default_factory=list)

    def judge(
        self, test: str, figure: float, limit: float, good: str, bad: str, *, failed: bool | None = None
    ) -> Verdict:
        """Add a row. The test fails if the value is above the limit, or if ``failed``; a known failure is a warning."""
        wrong = not figure <= limit if failed is None else failed
        verdict: Verdict = "fail" if wrong else "pass"
        meaning = bad if wrong else good
        if wrong and (reason := self.known(test)):
            verdict, meaning = "warn", f"{bad}; known: {reason}"
        self.rows.append(Finding(self.component, test, verdict, figure, limit, meaning))
        return verdict

    def warn(self, test: str, figure: float, limit: float, meaning: str) -> None:
        """Add a warning."""
        self.rows.append(Finding(self.component, test, "warn", figure, limit, meaning))

    @contextmanager
    def trying(self, test: str, *, required: bool = True) -> Iterator[None]:
        """Convert an exception in the block to a failure, or ignore it if the function is not ``required``."""
        try:
            yield
        except Exception as error:
            if required:
                text = describe(error)[:200]
                meaning = f"it raises an error in a function that all methods call ({text}); repair the plugin"
                self.rows.append(Finding(self.component, test, "fail", math.nan, 0.0, meaning))
