"""A layer's name says how its paths were made."""

import pytest

from etendue.film import Technique


@pytest.mark.parametrize(
    ("technique", "edges", "name"),
    [
        (Technique(False, 0, 2), 1, "s0_t2"),
        (Technique(False, 3, 2), 4, "s3_t2"),
        (Technique(True, 12, 3), 13, "m12_t3"),
    ],
)
def test_names_say_which_technique(technique, edges, name):
    assert technique.edges == edges
    assert technique.layer() == name
    assert Technique.of_layer(name) == (technique, True)
    assert Technique.of_layer(technique.layer(weighted=False)) == (technique, False)


@pytest.mark.parametrize("name", ["image", "longer", "splat", "s2", "s2_t3_x", "x2_t3", "as2_t3"])
def test_other_layers_are_of_no_technique(name):
    assert Technique.of_layer(name) is None
