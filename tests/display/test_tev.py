"""Pictures in tev: what a display makes of the packets."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from support.tev import fake_tev

from etendue.core import OptionError, Result
from etendue.display import TevDisplay
from etendue.display.tev import parse_address, picture_packets


def test_layers_arrive_and_a_known_layout_is_not_made_again() -> None:
    rng = np.random.default_rng(3)
    layers = {
        "image": rng.random((700, 600, 3), np.float32),  # two packets
        "normal": rng.random((700, 600, 3), np.float32),
        "depth": rng.random((700, 600, 1), np.float32),
    }
    with fake_tev() as server, TevDisplay(server.address, "room", pytest.fail) as display:
        display.offer(lambda: Result(layers))
    shown = server.images["room"]
    expected = ["R", "G", "B", "normal.X", "normal.Y", "normal.Z", "depth.Z"]
    assert list(shown) == expected
    sent = np.concatenate(list(layers.values()), axis=2)
    for index, name in enumerate(expected):
        np.testing.assert_array_equal(shown[name], sent[..., index])
    assert server.kinds == [2, 4, 6, 6, 6, 6, 6]
    packets, layout = picture_packets("room", Result(layers))
    assert len(picture_packets("room", Result(layers), layout)[0]) == len(packets) - 2
    assert picture_packets("room", Result({"image": layers["image"]}), layout)[0][0][4] == 2  # closes the image


def test_bands_of_wavelengths_have_their_names() -> None:
    result = Result({"image": np.ones((4, 5, 2), np.float32)}, metadata={"bands": ["low", "high"]})
    with fake_tev() as server, TevDisplay(server.address, "prism", pytest.fail) as display:
        display.offer(lambda: result)
    assert list(server.images["prism"]) == ["low", "high"]


def test_a_display_that_is_missing_or_goes_away_is_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        address = f"127.0.0.1:{unused.getsockname()[1]}"
    told: list[str] = []
    with TevDisplay(address, "room", told.append) as display:
        display.offer(lambda: pytest.fail("developed for nobody"))
    assert len(told) == 1 and address in told[0] and "\n" not in told[0]

    with socket.create_server(("127.0.0.1", 0)) as listener:
        display = TevDisplay(f"127.0.0.1:{listener.getsockname()[1]}", "room", told.append)
        assert display.connect()
        listener.accept()[0].close()
        picture = {"image": np.zeros((2000, 2000, 3), np.float32)}
        display.offer(lambda: Result(picture))
        display.close()
    assert len(told) == 2 and "has gone" in told[1]


@pytest.mark.parametrize("text", ["", "host:", "host:0", "host:70000", "host:x"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(OptionError, match="HOST:PORT"):
        parse_address(text)


def test_addresses() -> None:
    assert parse_address("other:9") == ("other", 9)
    assert parse_address("other") == ("other", 14158)
    assert parse_address(":9") == ("localhost", 9)
    assert parse_address("[::1]:9") == ("::1", 9)
    assert parse_address("::1") == ("::1", 14158)
