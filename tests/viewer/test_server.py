"""The server: token, Origin, messages, slow pages. The session is a stand-in."""

import asyncio
import base64
import json
import socket
import threading
from urllib.parse import quote, urlsplit

import pytest
from support.viewing import Page, proxied
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


def answers(server, kind, **headers):
    """The status and the text of the answer to a request with these headers alone: for the page, an asset, the address
    without the slash, or the upgrade to a WebSocket."""
    path = {"page": "", "asset": "assets/viewer.js", "bare": None, "socket": "socket"}[kind]
    address = f"/{server.token}" if path is None else f"/{server.token}/{path}"
    if kind == "socket":
        key = base64.b64encode(bytes(16)).decode()
        headers |= {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Key": key}
        headers |= {"Sec-WebSocket-Version": "13"}
    else:
        headers |= {"Connection": "close"}
    lines = [f"GET {address} HTTP/1.1", *(f"{name.replace('_', '-')}: {value}" for name, value in headers.items())]
    with socket.create_connection(("127.0.0.1", server.port), timeout=10) as opened:
        opened.sendall("\r\n".join([*lines, "", ""]).encode())
        answer = opened.recv(65536).decode("utf-8", "replace")
    return int(answer.split()[1]), answer


KINDS = {"page": 200, "asset": 200, "bare": 302, "socket": 101}


@pytest.mark.parametrize("kind", KINDS)
def test_another_name_of_the_host_is_not_answered(server, kind):
    """A name that an attacker lets point to this machine (DNS rebinding). Host and Origin agree then, for which tornado
    6.6 asks no ``check_origin``."""
    port = server.port
    for name in (f"127.0.0.1:{port}", f"localhost:{port}", f"[::1]:{port}", "localhost", "localhost:8888"):
        for more in ({}, {"Origin": f"http://{name}"}, {"Origin": f"http://{name}", "Sec_Fetch_Site": "same-origin"}):
            assert answers(server, kind, Host=name, **more)[0] == KINDS[kind], (name, more)
    for name in ("hub.example.org", f"evil.example:{port}", f"127.0.0.1.evil.example:{port}", "[", "a:b", ""):
        for more in ({}, {"Origin": f"http://{name}"}, {"Origin": f"http://{name}", "Sec_Fetch_Site": "same-origin"}):
            assert answers(server, kind, Host=name, **more)[0] in (400, 403), (name, more)
    for origin in ("http://evil.example", f"http://127.0.0.1:{port + 1}", "null", "file://"):
        assert answers(server, kind, Host=f"127.0.0.1:{port}", Origin=origin)[0] == 403


@pytest.mark.parametrize("kind", KINDS)
def test_an_allowed_origin_is_answered(kind):
    server = Server(Stand(), origins=["https://hub.example.org", "http://Proxy.example:8000/"])
    try:
        for host, origin in (
            ("hub.example.org", "https://hub.example.org"),
            ("hub.example.org:443", "https://hub.example.org:443"),
            (f"127.0.0.1:{server.port}", "https://hub.example.org"),  # a proxy that sets Host anew
            ("proxy.example:8000", "http://proxy.example:8000"),
            ("proxy.example:8000", "http://PROXY.example:8000"),
        ):
            assert answers(server, kind, Host=host, Origin=origin)[0] == KINDS[kind], (host, origin)
        for host, origin in (
            ("hub.example.org:8443", "https://hub.example.org:8443"),
            ("sub.hub.example.org", "https://sub.hub.example.org"),
            ("proxy.example", "http://proxy.example"),
            (f"127.0.0.1:{server.port}", "http://hub.example.org"),
        ):
            assert answers(server, kind, Host=host, Origin=origin)[0] == 403, (host, origin)
    finally:
        server.close()


def test_a_refusal_says_what_to_do(server):
    told = answers(server, "page", Host="hub.example.org")[1]
    assert told.endswith("start the viewer with --allow-origin https://hub.example.org, in Python allow_origin=\n")
    told = answers(server, "socket", Host=f"localhost:{server.port}", Origin="http://hub.example.org:8000")[1]
    assert "--allow-origin http://hub.example.org:8000" in told
    assert "<" not in answers(server, "page", Host="<b>.example")[1].split("\r\n\r\n")[1]


@pytest.mark.parametrize("origin", ["hub.example.org", "https://", "ftp://a.example", "https://a.example/x", "*", 3])
def test_an_origin_that_is_none_is_one_line(origin):
    with pytest.raises(OptionError, match=r"such as https://hub\.example\.org"):
        Server(Stand(), origins=[origin])


def test_below_a_path_of_a_proxy(server):
    """The page's own addresses are relative, also that to which the address without the slash leads."""
    prefix = f"/user/me/proxy/{server.port}"

    async def visit():
        async with proxied(server.port, prefix) as port:
            base = f"http://127.0.0.1:{port}{prefix}/{server.token}"
            client = AsyncHTTPClient(force_instance=True)
            answer = await client.fetch(base)
            assert answer.effective_url == base + "/" and b"<title>" in answer.body
            assert b"class Stage" in (await client.fetch(base + "/assets/stage.js")).body
            page = await Page.open(base + "/")
            assert (await page.next())[0] == {"type": "state", "loaded": False}
            page.close()

    asyncio.run(visit())


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
        while len(sent) < 4:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)  # nothing else comes

    asyncio.run(asyncio.wait_for(talk(), 30))
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
