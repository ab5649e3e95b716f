"""Where a browser on another machine reaches a viewer."""

import pytest

from etendue.core import OptionError
from etendue.viewer import Asked, Viewer
from etendue.viewer.access.addresses import VARIABLE, given_address


@pytest.fixture
def opened(monkeypatch):
    """Opens viewers without a scene; they are closed at the end."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr("etendue.viewer.opening.ViewerSession.start", lambda session: None)
    monkeypatch.setattr("etendue.viewer.opening._open", set())  # a session that has not started is not closed
    viewers = []

    def make(**options):
        viewers.append(Viewer(Asked(), **options))
        return viewers[-1], viewers[-1]._server

    yield make
    for viewer in viewers:
        viewer._server.close()


def test_the_frame_is_at_the_address_that_is_given(opened, monkeypatch):
    viewer, server = opened()
    assert viewer.url == server.url == f"http://127.0.0.1:{server.port}/{server.token}/"
    viewer, server = opened(address="/user/me/proxy/{port}/")
    assert viewer.url == f"/user/me/proxy/{server.port}/{server.token}/"
    assert f'data="{viewer.url}"' in viewer._repr_html_()
    assert not server.trusted.host("hub.example.org")
    monkeypatch.setenv(VARIABLE, "https://hub.example.org/user/me/proxy/{port}")
    viewer, server = opened()
    assert viewer.url == f"https://hub.example.org/user/me/proxy/{server.port}/{server.token}/"
    assert server.trusted.origin("https://hub.example.org", "hub.example.org")
    viewer, server = opened(address="http://desk:{port}")
    assert viewer.url == f"http://desk:{server.port}/{server.token}/"
    assert server.trusted.host(f"desk:{server.port}") and not server.trusted.host("hub.example.org")


def test_a_browser_of_this_machine_is_sent_to_the_server_itself(opened, monkeypatch):
    sent = []
    monkeypatch.setattr("webbrowser.open", lambda url: sent.append(url) or True)
    viewer, server = opened(address="/user/me/proxy/{port}")
    assert viewer.show() and sent == [server.url]


@pytest.mark.parametrize(
    "wrong", ["", "hub.example.org", "//hub", "ftp://hub", "https://", "https://hub:x", "http://a?b", 3]
)
def test_an_address_that_is_none_is_one_line(wrong, monkeypatch):
    with pytest.raises(OptionError, match=r"^address is where a browser") as error:
        given_address(wrong)
    assert "\n" not in str(error.value)
    monkeypatch.setenv(VARIABLE, "hub")
    with pytest.raises(OptionError, match=r"^the variable ETENDUE_VIEW_ADDRESS is where"):
        given_address(None)
