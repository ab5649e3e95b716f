"""Methods by name, whatever they make; what their budgets count."""

from __future__ import annotations

import pytest

from etendue import methods
from etendue.core import Method, OptionError
from etendue.engine import Budget
from etendue.products import FACTORS, PARTICLES, SOLUTIONS, budget_of, chosen, find, limits_of, table
from etendue.products.patches import FactorRun, SolutionRun
from etendue.radiosity import HierarchicalCasting, HierarchicalMultipath, LineCasting

#: What the budget of a method that makes no picture counts.
COUNTS = {
    "lines": "bundles",
    "spheres": "bundles",
    "multipath": "points",
    "boxes": "passes",
    "particles": "paths",
    "metropolis_particles": "paths",
}


def test_every_method_is_found_by_its_name():
    known = table()
    assert list(known)[: len(methods.table())] == list(methods.table())
    assert known.keys() - methods.table().keys() == COUNTS.keys() == {*FACTORS, *SOLUTIONS, *PARTICLES}
    for name, kind in known.items():
        assert find(name) is kind and kind.name == name and issubclass(kind, Method)
        assert kind.counts == COUNTS.get(name, "spp")


def test_earlier_names():
    for name, kind in (
        ("global-lines", LineCasting),
        ("hierarchical-lines", HierarchicalCasting),
        ("hierarchical-multipath", HierarchicalMultipath),
    ):
        assert find(name) is kind and name not in table()
    for run in (FactorRun(source="cornell-box", method="hierarchical-lines"), SolutionRun(source="cornell-box")):
        assert run.task().method is (HierarchicalCasting if isinstance(run, FactorRun) else LineCasting)
    boxes = SolutionRun(source="cornell-box", method="hierarchical-multipath", limits={"passes": 2}).task()
    assert boxes.method is HierarchicalMultipath and boxes.budget == Budget(iterations=2)


@pytest.mark.parametrize(
    ("name", "text"), [("multipth", "did you mean 'multipath'"), ("vcn", "did you mean 'vcm'"), ("x", "no method 'x'")]
)
def test_an_unknown_name_is_refused_with_the_nearest(name, text):
    with pytest.raises(OptionError, match=text):
        find(name)


def test_a_method_that_makes_something_else_is_refused():
    assert chosen("global-lines", FACTORS, "form factors") is LineCasting
    for name in ("multipath", "path", "lins"):
        with pytest.raises(OptionError, match=f"no method '{name}' for form factors; .*'?lines"):
            chosen(name, FACTORS, "form factors")


@pytest.mark.parametrize("name", [*COUNTS, "path"])
def test_a_budget_counts_what_the_method_counts(name):
    method, count = find(name), COUNTS.get(name, "spp")
    expected = Budget(2.0, iterations=5) if count == "passes" else Budget(2.0, 5)
    budget = budget_of(method, {count: 5, "seconds": 2.0, "error": None})
    assert budget == expected and limits_of(budget, count) == {count: 5, "seconds": 2.0}
    for other in {*COUNTS.values(), "spp", "samples"} - {count}:
        with pytest.raises(OptionError) as refused:
            budget_of(method, {other: 5})
        assert str(refused.value) == f"method '{name}' counts {count}: give {count} in place of {other}"
    for wrong in (0, -1, 1.5, True, "4"):
        with pytest.raises(OptionError, match=f"{count} must be a whole number of at least 1, not "):
            budget_of(method, {count: wrong})


def test_an_error_is_a_standard_error():
    """The engine ends at its square, the variance."""
    for name in ("path", "lines", "multipath", "boxes"):
        budget = budget_of(find(name), {"error": 0.1})
        assert budget.error == pytest.approx(0.01) and limits_of(budget) == {"error": 0.1}
    for wrong in (0, -0.1, True, "1", float("nan")):
        with pytest.raises(OptionError, match="a budget in error must be a number above 0, not"):
            budget_of(find("path"), {"error": wrong})
    with pytest.raises(OptionError, match="particles have no error: limit the paths, the particles or the seconds"):
        budget_of(find("particles"), {"error": 0.1})
