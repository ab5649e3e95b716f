"""Photometric files: closed forms of flux and intensity, every symmetry of both formats, and what is refused."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from scipy import integrate
from support.luminaires import GAMMA, STORED, eulumdat, ies, lambertian, lopsided, values

from etendue.lighting import LightingError, PhotometricWeb, read_photometry

RANDOM = np.random.default_rng(4)
DIRECTIONS = RANDOM.normal(size=(500, 3))
FINE = np.arange(0.0, 181.0, 1.0)


def isotropic(c, gamma):
    return np.full(np.broadcast(c, gamma).shape, 80.0)


def quadrants(c, gamma):
    """An intensity with the symmetry of all others, but for rotation."""
    return 50.0 + 20.0 * np.cos(gamma) + 30.0 * np.sin(gamma) ** 2 * np.cos(2 * c)


def read(tmp_path, text, name="lamp.ies", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return read_photometry(path)


def angles_of(directions):
    x, y, z = directions.T
    return np.arctan2(y, x), np.arctan2(np.hypot(x, y), -z)


def test_flux_of_an_isotropic_and_of_a_lambertian_luminaire(tmp_path):
    assert read(tmp_path, ies(isotropic)).flux == pytest.approx(4 * np.pi * 80.0, rel=1e-9)
    assert read(tmp_path, eulumdat(isotropic)).flux == pytest.approx(4 * np.pi * 80.0, rel=1e-6)
    # Linear interpolation of a cosine over steps of h loses about h^2 / 12 of it.
    for text in (ies(lambertian, gamma=FINE), eulumdat(lambertian, gamma=FINE)):
        assert read(tmp_path, text).flux == pytest.approx(np.pi * 200.0, rel=np.deg2rad(1.0) ** 2 / 8)


def test_flux_is_the_integral_of_the_intensity(tmp_path):
    """By adaptive quadrature within the cells of the web, of which the planes and angles are uneven."""
    c, gamma = np.array([0.0, 20.0, 95.0, 200.0, 360.0]), np.array([0.0, 10.0, 50.0, 90.0])
    web = PhotometricWeb(c, gamma, RANDOM.random((5, 4)))

    def integrand(g, a):
        return web.intensity([np.sin(g) * np.cos(a), np.sin(g) * np.sin(a), -np.cos(g)]) * np.sin(g)

    zones = [
        sum(
            integrate.dblquad(integrand, a, b, low, high, epsabs=1e-10)[0]
            for a, b in zip(np.deg2rad(c), np.deg2rad(c[1:]), strict=False)
        )
        for low, high in zip(np.deg2rad(gamma), np.deg2rad(gamma[1:]), strict=False)
    ]
    np.testing.assert_allclose(web.zonal_flux, zones, rtol=1e-7)
    assert web.subdivided(3.0).flux == pytest.approx(web.flux, rel=1e-12)
    np.testing.assert_allclose(web.subdivided(3.0).intensity(DIRECTIONS), web.intensity(DIRECTIONS), atol=1e-12)


@pytest.mark.parametrize("symmetry", [0, 2, 3, 4])
def test_symmetries_of_eulumdat(symmetry, tmp_path):
    shape = {0: lopsided, 2: lambda c, g: lopsided(c + np.pi / 6, g), 3: lambda c, g: lopsided(c - np.pi / 3, g)}
    intensity = shape.get(symmetry, quadrants)
    web = read(tmp_path, eulumdat(intensity, symmetry), "lamp.ldt")
    planes = np.arange(0.0, 361.0, 15.0)
    np.testing.assert_allclose(web.c, planes)
    np.testing.assert_allclose(web.candela, values(intensity, planes, GAMMA), atol=2e-6)


@pytest.mark.parametrize("last", [90, 180, 270, 360])
def test_symmetries_of_ies(last, tmp_path):
    shape = {360: lopsided, 180: lambda c, g: lopsided(c + np.pi / 6, g), 270: lambda c, g: lopsided(c - np.pi / 3, g)}
    intensity = shape.get(last, quadrants)
    web = read(tmp_path, ies(intensity, np.arange(90.0 if last == 270 else 0.0, last + 1, 15.0)))
    planes = np.arange(0.0, 361.0, 15.0)
    np.testing.assert_allclose(web.c, planes)
    np.testing.assert_allclose(web.candela, values(intensity, planes, GAMMA), atol=2e-6)


def test_one_luminaire_in_all_files(tmp_path):
    """With planes every 15 degrees and angles every 5, read from every symmetry that fits it."""
    texts = [eulumdat(quadrants, symmetry) for symmetry in (0, 2, 3, 4)]
    texts += [
        ies(quadrants, np.arange(low, high + 1.0, 15.0)) for low, high in ((0, 90), (0, 180), (0, 360), (90, 270))
    ]
    webs = [read(tmp_path, text) for text in texts]
    for web in webs[1:]:
        np.testing.assert_allclose(web.intensity(DIRECTIONS), webs[0].intensity(DIRECTIONS), rtol=1e-5)
        assert web.flux == pytest.approx(webs[0].flux, rel=1e-6)
    # Between the planes, interpolation over h loses up to h^2 / 8 of the second derivative.
    exact = quadrants(*angles_of(DIRECTIONS))
    np.testing.assert_allclose(webs[0].intensity(DIRECTIONS), exact, atol=np.deg2rad(15.0) ** 2 / 8 * 120 + 0.1)
    turning = [read(tmp_path, text) for text in (ies(lambertian), eulumdat(lambertian), eulumdat(lambertian, 0))]
    for web in turning[1:]:
        np.testing.assert_allclose(web.intensity(DIRECTIONS), turning[0].intensity(DIRECTIONS), atol=1e-5)


def test_axis_and_planes(tmp_path):
    """The nadir is -z, C = 0 is +x, and C = 90 is +y."""
    for text in (ies(lopsided, np.arange(0.0, 361.0, 15.0)), eulumdat(lopsided, 0)):
        web = read(tmp_path, text)
        near = web.intensity([[0, 0, -1], [0, 0, 2], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -3, 0]])
        c = np.deg2rad([0, 90, 180, 270])
        np.testing.assert_allclose(near[:2], [90, 30], atol=1e-4)
        np.testing.assert_allclose(near[2:], lopsided(c, np.full(4, np.pi / 2)), atol=1e-4)


def test_downward_files_end_at_the_horizon(tmp_path):
    web = read(tmp_path, ies(isotropic, gamma=np.arange(0.0, 91.0, 10.0)))
    np.testing.assert_allclose(web.intensity([[1, 0, -1e-3], [1, 0, 1e-3]]), [80.0, 0.0])
    assert web.flux == pytest.approx(2 * np.pi * 80.0, rel=1e-9)


@pytest.mark.parametrize(
    ("options", "factor", "lamps"),
    [
        ({"lamps": "2 500 3"}, 3.0, 1000.0),
        ({"lamps": "1 -1 1"}, 1.0, None),
        ({"ballast": "0.9 1.1 40"}, 0.9, 1000.0),  # not a factor since 1995: the way in which a file of 2019 was made
        ({"ballast": "0.9 1.1 40", "head": "IES:LM-63-2019\n"}, 0.9, 1000.0),
        ({"ballast": "0.9 0.5 40", "head": "IESNA91\n"}, 0.45, 1000.0),
        ({"ballast": "0.9 0.5 40", "head": "IESNA:LM-63-1991\n"}, 0.45, 1000.0),
        ({"ballast": "0.9 0.5 40", "head": "some company\nsome lamp\n"}, 0.45, 1000.0),
        ({"ballast": "0.9 0.5 40", "head": "IESNA:LM-63-1995\n"}, 0.9, 1000.0),
        ({"tilt": "TILT = none\n"}, 1.0, 1000.0),
        ({"tilt": "tilt=NONE\n"}, 1.0, 1000.0),
        ({"tilt": ""}, 1.0, 1000.0),
        ({"tilt": "TILT=INCLUDE\n1\n3\n0 45 90\n1 1 1\n"}, 1.0, 1000.0),
    ],
)
def test_headers_of_ies(options, factor, lamps, tmp_path):
    web = read(tmp_path, ies(isotropic, **options))
    assert web.flux == pytest.approx(4 * np.pi * 80.0 * factor, rel=1e-9)
    assert web.lamp_flux == lamps
    assert web.power == 40.0


def turned(degrees, about):
    """The vertical in the coordinates of a luminaire that is turned about one of its own axes."""
    angle, axis = np.deg2rad(degrees), {"x": [0, -1], "y": [1, 0]}[about]
    return [-axis[0] * np.sin(angle), -axis[1] * np.sin(angle), np.cos(angle)]


@pytest.mark.parametrize(
    ("geometry", "degrees", "about", "factor"),
    [
        (1, 0, "x", 1.0),
        (1, 30, "x", 0.9),  # between the angles
        (1, 45, "y", 0.85),
        (1, 180, "x", 1.0),  # base up, base down
        (1, 120, "y", 0.8),
        (2, 30, "y", 1.0),  # the lamp lies along y: it turns about its axis
        (2, 30, "x", 0.9),
        (3, 30, "x", 1.0),
        (3, 30, "y", 0.9),
    ],
)
def test_tilt_factors(geometry, degrees, about, factor, tmp_path):
    """They are kept apart from the intensities, which are those of a luminaire that is aimed at the nadir."""
    text = ies(isotropic, tilt=f"TILT=INCLUDE\n{geometry}\n3\n0 60 90\n1 .8 .8\n")
    web = read(tmp_path, text)
    assert web.flux == pytest.approx(4 * np.pi * 80.0, rel=1e-9)
    assert web.tilt.factor(turned(degrees, about)) == pytest.approx(factor, abs=1e-6)


def test_tilt_beyond_the_horizontal(tmp_path):
    """With angles to 180 degrees, base up and base down differ; a tilt without factors is refused."""
    web = read(tmp_path, ies(isotropic, tilt="TILT=INCLUDE\n1\n2\n0 180\n1 .8\n"))
    assert web.tilt.factor([0.0, 0.0, -1.0]) == pytest.approx(0.8)
    web = read(tmp_path, ies(isotropic, tilt="TILT=INCLUDE\n1\n2\n0 45\n1 .8\n"))
    with pytest.raises(LightingError, match="tilted by 60 degrees, and its file has factors from 0 to 45 degrees"):
        web.tilt.factor(turned(60, "x"))


def test_opening(tmp_path):
    """The length of an IES file is along C = 0, that of EULUMDAT along C = 90."""
    web = read(tmp_path, ies(isotropic))
    assert (web.opening, web.is_round, web.name) == ((1.2, 0.3, 0.1), False, "A lamp")
    web = read(tmp_path, ies(isotropic, shape="1 1 -2 -2 0"))
    assert web.opening == pytest.approx((0.6096, 0.6096, 0.0))
    assert web.is_round
    web = read(tmp_path, eulumdat(isotropic))
    assert (web.opening, web.is_round, web.name) == ((0.3, 1.2, 0.1), False, "A lamp")


def mangled(text: str, how: str) -> bytes:
    """Forms in which files are found."""
    match how:
        case "bom":
            return text.encode("utf-8-sig")
        case "utf-16":
            return text.encode("utf-16")
        case "latin-1":
            return text.replace("A lamp", "Lüster").encode("latin-1")
        case "crlf":
            return text.replace("\r\n", "\n").replace("\n", "\r\n").encode()
        case "end":
            return text.rstrip().encode() + b"\r\n\x1a"
        case "commas":  # between the numbers of IES, in the numbers of EULUMDAT
            return (text.replace(" ", " , ") if "TILT" in text else text.replace(".", ",")).encode()
        case "lines":
            head, _, numbers = text.partition("TILT=NONE\n")
            numbers = numbers.replace(" ", "\n")
            return f"{head}TILT=NONE\n{numbers}".encode() if numbers else text.encode()
    raise ValueError(how)


@pytest.mark.parametrize("how", ["bom", "utf-16", "latin-1", "crlf", "end", "commas", "lines"])
@pytest.mark.parametrize("kind", ["ies", "ldt"])
def test_forms_of_files(kind, how, tmp_path):
    text = ies(quadrants, STORED[4]) if kind == "ies" else eulumdat(quadrants, 4)
    reference = read(tmp_path, text)
    path = tmp_path / "file.dat"  # the content decides
    path.write_bytes(mangled(text, how))
    web = read_photometry(path)
    np.testing.assert_array_equal(web.candela, reference.candela)
    if how == "latin-1":
        assert web.name == "Lüster"


def test_lamps_of_eulumdat(tmp_path, caplog):
    """Intensities are per 1000 lm of a set, the first unless another is chosen, or of all; with a negative number of
    lamps, photometry is absolute."""
    text = eulumdat(isotropic, lamps=[(2, 3000.0, 30.0), (1, 1000.0, 12.0)])  # 80 cd with all of them
    path = tmp_path / "lamp.ldt"
    path.write_bytes(text.encode())
    with caplog.at_level(logging.WARNING, "etendue"):
        assert read_photometry(path).lamp_flux == 3000.0
    assert "2 sets of lamps (1 of 3000 lm, 2 of 1000 lm), of which the first is used" in caplog.text
    caplog.clear()
    for lamp_set, flux, power in ((0, 4000.0, 42.0), (1, 3000.0, 30.0), (2, 1000.0, 12.0)):
        web = read_photometry(path, lamp_set)
        assert web.flux == pytest.approx(4 * np.pi * 80.0 * flux / 4000.0, rel=1e-6)
        assert (web.lamp_flux, web.power) == (flux, power)
    assert not caplog.text
    assert read(tmp_path, eulumdat(isotropic, lamps=[(-1, 1000.0, 12.0)])).lamp_flux is None
    for lamp_set, message in ((3, "no set of lamps 3 among 2"), (-1, "not -1"), (1.5, "not 1.5"), (True, "not True")):
        with pytest.raises(LightingError, match=message):
            read_photometry(path, lamp_set)
    path.write_text(ies(isotropic))
    with pytest.raises(LightingError, match="no sets of lamps"):
        read_photometry(path, 1)


def test_light_output_ratio_is_compared(tmp_path, caplog):
    ratio = 4 * np.pi * 80.0 / 2000.0
    with caplog.at_level(logging.WARNING, "etendue"):
        read(tmp_path, eulumdat(isotropic, lamps=[(1, 2000.0, 0.0)], lorl=f"{100 * ratio:.1f}"))
    assert not caplog.text
    with caplog.at_level(logging.WARNING, "etendue"):
        read(tmp_path, eulumdat(isotropic, lamps=[(1, 2000.0, 0.0)], lorl="80"))
    assert "80% of 2000 lm" in caplog.text


BAD_IES = {
    "no planes": (lambda: ies(isotropic).replace(" 37 1 1 2", " 37 0 1 2"), "number of horizontal angles is 0"),
    "no angles": (lambda: ies(isotropic).replace(" 37 1 1 2", " 0 1 1 2"), "number of vertical angles is 0"),
    "cut off": (lambda: ies(isotropic)[:-60], r"intensities: there are \d+ of 37 numbers"),
    "empty": (lambda: "IESNA91\nTILT=NONE\n", "lamp data: there are 0 of 3"),
    "too many": (lambda: ies(isotropic) + "80 80", "2 more numbers"),
    "a word": (lambda: ies(isotropic).replace("80.000000", "x80", 1), "'x80' is not a number"),
    "a long word": (lambda: ies(isotropic).replace("80.000000", "x" * 99, 1), f"'{'x' * 24}' is not a number"),
    "symmetry": (lambda: ies(isotropic, np.arange(0.0, 121.0, 30.0)), "from 0 to 120 degrees, which is no symmetry"),
    "not closed": (lambda: ies(isotropic, np.arange(0.0, 346.0, 15.0)), "from 0 to 345 degrees, which is no symmetry"),
    "planes fall": (
        lambda: ies(isotropic, np.array([0.0, 60.0, 30.0, 90.0])),
        "C angles do not ascend: 30 .* after 60",
    ),
    "angles fall": (lambda: ies(isotropic, gamma=np.array([0.0, 90.0, 45.0])), "vertical angles do not ascend"),
    "range": (lambda: ies(isotropic, gamma=np.arange(0.0, 71.0, 10.0)), "above gamma = 70 degrees are missing"),
    "start": (lambda: ies(isotropic, gamma=np.arange(10.0, 91.0, 10.0)), "below gamma = 10 degrees are missing"),
    "negative": (lambda: ies(lambda c, g: 50 - 60 * np.cos(g)), "an intensity is -10"),
    "nan": (lambda: ies(lambda c, g: 50 + np.where(g > 2, np.nan, 0)), "an intensity is nan"),
    "infinite": (lambda: ies(lambda c, g: 50 + np.where(g > 2, np.inf, 0)), "an intensity is inf"),
    "no lumens": (lambda: ies(isotropic, lamps="1 0 1"), "1 lamps have 0 lumens each"),
    "no lamps": (lambda: ies(isotropic, lamps="0 1000 1"), "0 lamps have 1000 lumens"),
    "no factor": (lambda: ies(isotropic, lamps="1 1000 0"), "multiplied by 0"),
    "dark": (lambda: ies(lambda c, g: 0 * c), "all intensities are 0"),
    "type B": (lambda: ies(isotropic, shape="2 2 0 0 0"), "type B, which is not supported; convert it to type C"),
    "type A": (lambda: ies(isotropic, shape="3 2 0 0 0"), "type A"),
    "no type": (lambda: ies(isotropic, shape="4 2 0 0 0"), "photometric type is 4"),
    "units": (lambda: ies(isotropic, shape="1 3 0 0 0"), "type of units is 3"),
    "tilt file": (lambda: ies(isotropic, tilt="TILT=lamp.tlt\n"), "TILT=lamp.tlt: .* write TILT=INCLUDE"),
    "tilt geometry": (lambda: ies(isotropic, tilt="TILT=INCLUDE\n4\n2\n0 90\n1 .8\n"), "geometry is 4; it is 1"),
    "tilt angles": (lambda: ies(isotropic, tilt="TILT=INCLUDE\n1\n2\n90 0\n1 .8\n"), "tilt angles do not ascend"),
    "tilt range": (lambda: ies(isotropic, tilt="TILT=INCLUDE\n1\n2\n0 270\n1 .8\n"), "go from 0 to 270 degrees"),
    "tilt factors": (lambda: ies(isotropic, tilt="TILT=INCLUDE\n1\n2\n0 90\n1 -1\n"), "factor is negative"),
}
BAD_EULUMDAT = {
    "cut off": (lambda: eulumdat(isotropic)[:-40], r"intensities: there are \d+ of 37 numbers"),
    "no angles": (lambda: "\n".join(eulumdat(isotropic).splitlines()[:50]), "C angles: there are 8 of 24"),
    "no data": (lambda: "\n" * 12, "12 lines, too few; this is no IES or EULUMDAT file"),
    "no symmetry": (lambda: changed(eulumdat(isotropic), 3, "7"), "symmetry .line 3. is 7; it is one of"),
    "symmetry of others": (lambda: changed(eulumdat(lopsided, 0), 3, "4"), "more numbers than the intensities of 7"),
    "planes": (
        lambda: changed(eulumdat(quadrants, 4), 4, "22", without=(64, 66)),
        "C planes .line 4. have none at 0 or 90 degrees",
    ),
    "no planes": (lambda: changed(eulumdat(isotropic), 4, "0"), "number of C planes .line 4. is 0"),
    "a word": (lambda: changed(eulumdat(isotropic), 6, "many"), "line 6. is 'many', no number"),
    "another file": (
        lambda: "\n".join(["x" * 500] * 30),
        f"is '{'x' * 24}', no number; is this an IES or EULUMDAT file",
    ),
    "no lumens": (lambda: eulumdat(isotropic, lamps=[(1, 0.0, 10.0)]), "the lamps have 0 lm"),
    "no lamps": (lambda: changed(eulumdat(isotropic), 26, "0"), "sets of lamps .line 26. is 0"),
    "negative": (lambda: eulumdat(lambda c, g: 50 - 60 * np.cos(g)), "an intensity is -10"),
    "planes fall": (lambda: changed(eulumdat(isotropic), 45, "1"), "C angles do not ascend"),
    "angles fall": (lambda: changed(eulumdat(isotropic), 70, "1"), "gamma angles do not ascend"),
    "dark": (lambda: eulumdat(lambda c, g: 0 * c), "all intensities are 0"),
}


def changed(text: str, line: int, value: str, without: tuple[int, int] = (0, 0)) -> str:
    """A file with another line, without some lines, the last of which is counted as the format counts."""
    lines = text.splitlines()
    lines[line - 1] = value
    del lines[slice(*without)]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("make", "message"),
    [*BAD_IES.values(), *BAD_EULUMDAT.values()],
    ids=[*(f"ies {name}" for name in BAD_IES), *(f"ldt {name}" for name in BAD_EULUMDAT)],
)
def test_bad_files_are_refused_in_one_line(make, message, tmp_path):
    with pytest.raises(LightingError, match=message) as caught:
        read(tmp_path, make(), "bad.ies")
    assert str(caught.value).startswith(str(tmp_path / "bad.ies"))
    assert "\n" not in str(caught.value)


def test_a_missing_file(tmp_path):
    with pytest.raises(LightingError, match=r"none\.ies cannot be read: No such file"):
        read_photometry(tmp_path / "none.ies")
