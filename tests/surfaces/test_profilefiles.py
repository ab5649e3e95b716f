"""Profiles of surfaces of revolution as files."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.surfaces import PatchError, read_patches

FURNACE = """# a closed can
name,r1,z1,r2,z2,emissivity,temperature
floor,0,0,1,0,0.8,300
wall,1,0,1,1,0.5,400

wall,1,1,1,2,0.6,500
roof,1,2,0,2,0.9,600
"""


def read(folder, text, **options):
    path = folder / "can.csv"
    path.write_text(text)
    return read_patches(path, **options)


def test_rings_with_their_names_and_values(tmp_path):
    patches = read(tmp_path, FURNACE, temperature="temperature")
    np.testing.assert_allclose(patches.areas, np.pi * np.array([1, 2, 2, 1]))
    assert patches.names.tolist() == ["floor", "wall", "wall", "roof"]
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.2, 0.5, 0.4, 0.1])
    np.testing.assert_allclose(patches.emission[3, 0], 0.9 * 5.670374419e-8 * 600**4)
    walls = read(tmp_path, FURNACE, ids="name")
    np.testing.assert_allclose(walls.areas, np.pi * np.array([1, 4, 1]))
    # Fronts are inside: their normals point to the middle.
    inward = -(patches.vertices[patches.faces].mean(axis=1) - [0, 0, 1]) * [1, 1, 0.5]
    assert ((patches.face_normals * inward).sum(axis=1) > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("r2", "r3"), "no column 'r2'"),
        (("emissivity", "emisivity"), "unknown column 'emisivity'; .*emissivity"),
        (("temperature", "z1"), "the column 'z1' twice"),
        (("floor,0,", "floor,-1,"), "line 3: 'floor' .* radius below zero"),
        (("roof,1,2,0,2", "roof,0,1,0,2"), "line 7: 'roof' .* on the axis"),
        (("roof,1,2", "roof,one,2"), "line 7: r1 is a number, not 'one'"),
        (("0.9,600", "0.9"), "line 7: there are 6 cells for 7 columns"),
        (("0.5,400", "1.5,400"), "line 4: 'wall' has the emissivity 1.5"),
        (("1,1,1,2", "1,0.5,1,2"), "line 4: 'wall' .* and .*line 6: 'wall' lie on each other"),
    ],
)
def test_files_that_are_refused(tmp_path, change, message):
    assert change[0] in FURNACE
    with pytest.raises(PatchError, match=message) as error:
        read(tmp_path, FURNACE.replace(*change))
    assert "\n" not in str(error.value)


def test_options_that_a_profile_refuses(tmp_path):
    with pytest.raises(PatchError, match="has no rings"):
        read(tmp_path, FURNACE.split("floor")[0])
    for options in ({"periodic": (4, 4)}, {"orient": "inward"}, {"more": [tmp_path / "can.csv"]}):
        with pytest.raises(PatchError, match="takes no further files, no period and no orientation"):
            read(tmp_path, FURNACE, **options)
