"""`etendue view`: what is wrong is told in one line before anything is opened; Ctrl-C and a page end it."""

import asyncio
import socket
import threading

import pytest
from support.viewing import Page

from etendue.cli.inspection import viewing
from etendue.cli.main import main
from etendue.viewer import Viewer


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["nowhere"], 3, "no scene file 'nowhere'"),
        (["picture.exr"], 3, "there is no picture 'picture.exr'"),
        (["cornell-box", "-m", "vmc"], 2, "did you mean 'vcm'?"),
        (["cornell-box", "--set", "depth=3"], 2, "has no option 'depth'"),
        (["cornell-box", "--size", "0x4"], 2, "--size needs WIDTHxHEIGHT"),
        (["cornell-box", "--port", "70000"], 2, "--port"),
        (["cornell-box", "--time", "-1"], 2, "above 0"),
        (["cornell-box", "--allow-origin", "hub"], 2, "such as https://hub.example.org, not 'hub'"),
        (["cornell-box", "--address", "hub"], 2, "not 'hub'"),
        (["cornell-box", "--host", " "], 2, "--host is an address"),
        (["cornell-box", "--host", "no.such.host.invalid"], 2, "cannot listen at"),
    ],
)
def test_wrong_arguments(words, code, text, capsys):
    assert main(["view", *words, "--no-browser"]) == code
    error = capsys.readouterr().err.strip().splitlines()
    assert error[-1].startswith("error: ") and text in error[-1] and len(error) == 1


def test_a_port_that_is_taken(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["view", "cornell-box", "--port", str(port), "--no-browser"]) == 2
    assert f"port {port} is taken" in capsys.readouterr().err


def test_it_prints_the_address_and_ends_with_the_session(monkeypatch, capsys):
    """A page that knows the printed address ends the session; the command returns."""
    said, ready = [], threading.Event()

    def say(text):
        said.append(text)
        ready.set()

    async def end():
        page = await Page.open(said[0])
        page.send("quit")
        while await page.next() is not None:
            pass

    def visit():
        assert ready.wait(60)
        asyncio.run(end())

    visitor = threading.Thread(target=visit)
    visitor.start()
    monkeypatch.setattr(viewing, "say", say)
    assert main(["view", "cornell-box", "--size", "32x24", "--no-browser"]) == 0
    visitor.join(60)
    assert not visitor.is_alive() and said[0].startswith("http://127.0.0.1:")


def test_ctrl_c_ends_it(monkeypatch):
    def interrupted(viewer, timeout=None):
        raise KeyboardInterrupt

    monkeypatch.setattr(Viewer, "wait", interrupted)
    assert main(["view", "cornell-box", "--size", "32x24", "--no-browser"]) == 0
