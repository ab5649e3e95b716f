"""Settings check themselves, read what a user types, and survive JSON."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, dataclass

import pytest

from etendue.core import OptionError, Settings, setting


@dataclass(frozen=True)
class Example(Settings):
    max_depth: int = setting(-1, "longest path", minimum=-1)
    radius: float = setting(0.003, "merge radius", above=0.0)
    alpha: float = setting(0.75, "radius reduction", minimum=0.0, maximum=1.0)
    heuristic: str = setting("balance", "how techniques share", choices=("balance", "power"))
    merging: bool = setting(True, "merge vertices")


@pytest.mark.parametrize(
    ("name", "typed", "value"),
    [
        ("max_depth", "7", 7),
        ("max_depth", 7.0, 7),
        ("radius", "1e-2", 0.01),
        ("radius", 1, 1.0),
        ("heuristic", "power", "power"),
        ("merging", "false", False),
        ("merging", "Off", False),
        ("merging", "no", False),
        ("merging", "0", False),
        ("merging", "TRUE", True),
        ("merging", "yes", True),
        ("merging", 0, False),
    ],
)
def test_values_are_read_as_typed(name, typed, value):
    result = getattr(Example.from_mapping({name: typed}), name)
    assert result == value
    assert type(result) is type(value)


@pytest.mark.parametrize(
    ("name", "typed", "says"),
    [
        ("max_depth", "deep", "whole number"),
        ("max_depth", 2.5, "whole number"),
        ("max_depth", "99999999999999999999", "to 2147483647"),
        ("max_depth", 1e30, "to 2147483647"),
        ("max_depth", "2.5", "whole number"),
        ("max_depth", True, "whole number"),
        ("max_depth", None, "whole number"),
        ("max_depth", -2, "at least -1"),
        ("max_depth", float("nan"), "whole number"),
        ("max_depth", float("inf"), "whole number"),
        ("radius", "wide", "a number"),
        ("radius", 0, "above 0"),
        ("radius", "nan", "finite"),
        ("radius", "inf", "finite"),
        ("radius", True, "a number"),
        ("alpha", 1.5, "at most 1"),
        ("alpha", -0.5, "at least 0"),
        ("heuristic", "median", "one of balance, power"),
        ("heuristic", 3, "one of balance, power"),
        ("merging", "maybe", "true or false"),
        ("merging", 2, "true or false"),
        ("merging", None, "true or false"),
    ],
)
def test_bad_values_are_refused_in_one_line(name, typed, says):
    with pytest.raises(OptionError) as caught:
        Example(**{name: typed})
    text = str(caught.value)
    assert f"'{name}'" in text
    assert says in text
    assert "\n" not in text


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(OptionError, match="no option 'radios'; did you mean 'radius'"):
        Example.from_mapping({"radios": 1}, "vcm")
    with pytest.raises(OptionError, match=r"vcm has no option 'zzz'; it has: max_depth, radius"):
        Example.from_mapping({"zzz": 1}, "vcm")


def test_json_round_trip_and_canonical_text():
    settings = Example(max_depth=5, radius=0.1, heuristic="power", merging=False)
    assert Example.from_json(settings.to_json()) == settings
    assert (
        Example.from_json(json.dumps(dict(reversed(list(settings.to_dict().items()))))).to_json() == settings.to_json()
    )
    # What is typed and what is computed give the same text, on which fingerprints rest.
    assert Example(radius=1).to_json() == Example(radius="1.0").to_json()


def test_json_that_is_no_settings_is_refused():
    for text in ("[1, 2]", "{", "3"):
        with pytest.raises(OptionError):
            Example.from_json(text)


def test_replace_checks_again_and_settings_are_frozen():
    settings = Example()
    assert settings.replace(alpha="0.5").alpha == 0.5
    with pytest.raises(OptionError):
        settings.replace(alpha=2)
    with pytest.raises(OptionError, match="no option 'alhpa'; did you mean 'alpha'"):
        settings.replace(alhpa=1)
    with pytest.raises(FrozenInstanceError):
        settings.alpha = 0.1


def test_describe_lists_every_option():
    assert Example.describe()[0] == ("max_depth", "int", -1, "longest path")
    assert Example.names() == tuple(row[0] for row in Example.describe())
    assert [row[1] for row in Example.describe()] == ["int", "float", "float", "balance|power", "bool"]


def test_inherited_options_come_first():
    @dataclass(frozen=True)
    class More(Example):
        light_paths: int = setting(1, "light paths per camera path", minimum=1)

    assert [row[0] for row in More.describe()][-1] == "light_paths"
    assert More.from_mapping({"light_paths": "3", "max_depth": "2"}).max_depth == 2
