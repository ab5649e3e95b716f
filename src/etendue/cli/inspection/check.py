"""`etendue check`: reports implausible components of a scene."""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from etendue.conformance import Finding, Report, check
from etendue.core import format_seconds

from ..console import output_console, say

#: Further variants for the test of ray casting, if the scene has triangles.
_VARIANTS = ("scalar_rgb",)
_COLOUR = {"pass": "green", "warn": "yellow", "fail": "red"}


def show_check(scene: Any, *, quick: bool, as_json: bool, **options: Any) -> int:
    """Check with the ``options`` of :func:`etendue.conformance.check`, and print. Exit status 1 if something fails."""
    report = check(scene, quick=quick, variants=() if quick else _VARIANTS, **options)
    if as_json:
        say(json.dumps(report.to_dict(), indent=2, ensure_ascii=False))
    else:
        render(report, output_console())
    return 0 if report.ok else 1


def render(report: Report, console: Console) -> None:
    """Print a row for each component, then the warnings and failures."""
    table = Table(box=None, pad_edge=False)
    for heading, fixed in (("", True), ("component", False), ("passed", True), ("other than passed", False)):
        table.add_column(heading, no_wrap=fixed)
    by_component: dict[str, list[Finding]] = {}
    for finding in report.findings:
        by_component.setdefault(finding.component, []).append(finding)
    for component, findings in by_component.items():
        counts = Counter(f.verdict for f in findings)
        worst = next(v for v in ("fail", "warn", "pass") if counts[v])
        others = ", ".join(f"{f.test} {_number(f.figure)}" for f in findings if f.verdict != "pass")
        mark = f"[{_COLOUR[worst]}]{worst}[/]"
        table.add_row(mark, escape(component), f"{counts['pass']} of {len(findings)}", escape(others))
    console.print(table)
    for finding in (*report.failures, *report.warnings):
        head = f"\n[{_COLOUR[finding.verdict]}]{finding.verdict}[/] {escape(finding.component)}, {finding.test}: "
        console.print(head + escape(finding.meaning), soft_wrap=True)
    total = Counter(f.verdict for f in report.findings)
    summary = f"{total['pass']} tests passed, {total['warn']} warn, {total['fail']} failed"
    console.print(f"\n{escape(report.source)}: {summary}, in {format_seconds(report.seconds)}", soft_wrap=True)


def _number(figure: float) -> str:
    return "" if math.isnan(figure) else f"{figure:.3g}"
