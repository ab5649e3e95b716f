"""The server: token, Origin, messages, slow pages. The session is a stand-in."""

import asyncio
import json
import socket
import threading
from urllib.parse import quote, urlsplit

import pytest
from support.viewing import Page
from tornado.httpclient import AsyncHTTPClient, HTTPClientError

from etendue.core import OptionError
from etendue.viewer.clients import Client
from etendue.viewer.protocol import packed, parsed, unpacked
from etendue.viewer.server import Server


class Stand:
    """A session that records what it gets."""

    def __init__(self):
        self.clients, self.messages, self.got = [], [], threading.Event()

    def join(self, client):
        self.clients.append(client)
        client.send("state", loaded=False)

    def leave(self, client):
        self.clients.remove(client)

    def post(self, client, message):
        self.messages.append(message)
        self.got.set()

    def file(self, name):
        return b"saved" if name in ("view.png", "夕方 ä.png") else None


@pytest.fixture
def server():
    made = Server(Stand())
    yield made
    made.close()


def fetch(url, **options):
    async def get():
        return await AsyncHTTPClient(force_instance=True).fetch(url, **options)

    return asyncio.run(get())


def status(url, **options):
    with pytest.raises(HTTPClientError) as error:
        fetch(url, **options)
    return error.value.code


def test_nothing_is_answered_without_the_token(server):
    place = urlsplit(server.url)
    base, token = f"http://{place.netloc}", server.token
    assert len(token) >= 32 and place.hostname == "127.0.0.1"
    wrong = token[:-1] + ("a" if token[-1] != "a" else "b")
    for path in ("/", "/index.html", f"/{wrong}/", f"/{wrong}/assets/viewer.js", f"/{wrong}/files/view.png", "/ä/"):
        assert status(base + path.encode("ascii", "ignore").decode()) == 403
    assert b"<title>" in fetch(server.url).body
    assert fetch(base + f"/{token}").effective_url == server.url
    assert b"class Stage" in fetch(server.url + "assets/stage.js").body
    assert fetch(server.url + "files/view.png").body == b"saved"
    named = fetch(server.url + f"files/{quote('夕方 ä.png')}")
    assert named.body == b"saved" and quote("夕方 ä.png") in named.headers["Content-Disposition"]
    assert status(server.url + "files/other.png") == 404
    assert status(server.url + "assets/../server.py") in (403, 404)
    assert status(server.url + "assets/%2e%2e/server.py") in (403, 404)

    async def knock():
        with pytest.raises(HTTPClientError) as error:
            await Page.open(f"{base}/{wrong}/")
        return error.value.code

    assert asyncio.run(knock()) == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:1", "file://"])
def test_a_page_from_elsewhere_is_refused(server, origin):
    async def knock():
        with pytest.raises(HTTPClientError) as error:
            await Page.open(server.url, origin=origin)
        return error.value.code

    assert asyncio.run(knock()) == 403


def test_a_page_of_this_server_and_a_program_without_origin_are_let_in(server):
    async def talk():
        for origin in (None, ""):
            page = await Page.open(server.url, origin=origin)
            assert (await page.next())[0] == {"type": "state", "loaded": False}
            page.close()

    asyncio.run(talk())


def test_another_name_of_the_host_is_not_trusted(server):
    """A name that an attacker lets point to this machine (DNS rebinding)."""
    assert server.trusts(f"http://127.0.0.1:{server.port}", f"127.0.0.1:{server.port}")
    assert server.trusts(f"http://localhost:{server.port}", f"localhost:{server.port}")
    assert not server.trusts(f"http://evil.example:{server.port}", f"evil.example:{server.port}")
    assert not server.trusts(f"http://127.0.0.1:{server.port}", f"127.0.0.1:{server.port + 1}")


def test_bad_messages_are_told_and_the_connection_lives(server):
    bad = ["", "{", "[]", "3", '{"type": 3}', '{"x": 1}', '{"type": "pick", "x": NaN}', "[" * 100000]

    async def talk():
        page = await Page.open(server.url)
        for text in bad:
            page.socket.write_message(text)
            assert (await page.until("error"))[0]["text"]
        page.socket.write_message(b"\0\1", binary=True)
        assert "text" in (await page.until("error"))[0]["text"]
        page.send("pick", x=0.5)
        assert await asyncio.to_thread(server._session.got.wait, 10)
        page.close()

    asyncio.run(talk())
    assert server._session.messages == [{"type": "pick", "x": 0.5}]


def test_a_slow_page_gets_the_latest_picture_and_delays_nobody(server):
    """One page never reports a picture as drawn: it gets two, then nothing; the other one gets pictures all along, and
    of those that come faster than it draws, the last."""

    async def talk():
        slow, quick = await Page.open(server.url, draws=False), await Page.open(server.url)
        await slow.next()
        await quick.next()
        data = bytes(200_000)
        for frame in range(1, 101):
            message = packed("frame", data, frame=frame, side="a")
            for client in server._session.clients:
                client.send_frame("a", frame, message)
            if frame % 10 == 0:
                while not quick.frames or quick.frames[-1][1]["frame"] < frame:
                    await quick.next(10)
        assert quick.frames[-1][1]["frame"] == 100
        with pytest.raises(TimeoutError):
            while True:
                await slow.next(0.5)
        assert len(slow.frames) == 2
        slow.send("drawn", frame=slow.frames[-1][1]["frame"])
        await slow.until("frame")
        assert slow.frames[-1][1]["frame"] == 100
        numbers = [fields["frame"] for _, fields in quick.frames]
        assert numbers == sorted(numbers)

    asyncio.run(talk())


def test_of_states_that_wait_the_latest_is_sent_in_the_order_of_the_latest():
    """To a page that is slow to take messages: never a pose that is older than the state before it."""
    sent = []

    class Slow:
        async def write_message(self, message, binary=False):
            sent.append(unpacked(message)[0])
            await asyncio.sleep(0.01)

    async def talk():
        client = Client(Slow(), asyncio.get_running_loop())
        for kind, number in (("note", 0), ("camera", 1), ("state", 2), ("camera", 3), ("progress", 4), ("state", 5)):
            client.send(kind, number=number)
        await asyncio.sleep(0.1)

    asyncio.run(talk())
    assert [(m["type"], m["number"]) for m in sent] == [("note", 0), ("camera", 3), ("progress", 4), ("state", 5)]


def test_a_port_that_is_taken_is_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(OptionError, match=f"port {port} is taken; give another one by --port") as error:
            Server(Stand(), port=port)
    assert "\n" not in str(error.value)
    with pytest.raises(OptionError, match="cannot listen at"):
        Server(Stand(), host="no.such.host.invalid")


def test_messages_round_trip_and_have_no_nan():
    message = packed("frame", b"\1\2\3", value=float("nan"), list=[1.5, float("inf")])
    fields, data = unpacked(message)
    assert fields == {"type": "frame", "value": None, "list": [1.5, None]} and bytes(data) == b"\1\2\3"
    assert (len(message) - 3) % 8 == 0
    assert json.loads(packed("note", text="a")) == {"type": "note", "text": "a"}
    assert parsed('{"type": "pick"}') == {"type": "pick"}
