"""The preview's websocket with clients of our own: who is let in, what they may send, and one that stops reading."""

import os
import re
import socket
import struct
import time
from contextlib import contextmanager
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from browsers import serving
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from gpusim.apps.preview.sessions import MOST_STREAMS, MOST_UNSEEN


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with serving(
        "colorchecker",
        "--camera",
        "phone",
        "--size",
        "320x200",
        "--device",
        "opencl",
        folder=tmp_path_factory.mktemp("preview"),
    ) as (found, _):
        yield found


def opened(address, **options):
    """The websocket of a new page's picture."""
    with urlopen(address, timeout=30) as page:
        token = re.search(r"/picture/([\w-]+)", page.read().decode())[1]
    url = f"{address.replace('http', 'ws')}/picture/{token}"
    return connect(url, **{"origin": address, "max_size": 2**24} | options)


def received(client, count, acknowledge=True):
    """Numbers of frames."""
    found = []
    for _ in range(count):
        data = client.recv(timeout=30)
        found.append(struct.unpack("<III", data[:12])[0])
        if acknowledge:
            client.send("1")
    return found


def test_frames_are_live_and_numbered(address):
    with opened(address) as client:
        numbers = received(client, 20)
        assert numbers == [*range(numbers[0], numbers[0] + 20)]


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1"])
def test_pages_of_others_get_no_picture(address, origin):
    with pytest.raises(InvalidStatus) as refused:
        opened(address, origin=origin).close()
    assert refused.value.response.status_code == 403


def test_other_names_of_this_address_get_no_picture(address):
    """As a page does whose name was bound to 127.0.0.1 after it was loaded."""
    port = int(address.rpartition(":")[2])
    with pytest.raises(InvalidStatus) as refused:
        connect(
            f"ws://evil.example:{port}/picture/x",
            origin=f"http://evil.example:{port}",
            sock=socket.create_connection(("127.0.0.1", port)),
        )
    assert refused.value.response.status_code == 403


def test_an_unknown_token_gets_no_picture(address):
    with (
        pytest.raises((InvalidStatus, ConnectionClosed)),
        connect(f"{address.replace('http', 'ws')}/picture/unknown", origin=address) as client,
    ):
        client.recv(timeout=10)


def test_one_that_stops_reading_delays_nobody(address):
    with opened(address) as silent, opened(address) as client:
        received(client, 5)
        begun = time.perf_counter()
        received(silent, 1, acknowledge=False)  # and no more
        numbers = received(client, 60)
        rate = 60 / (time.perf_counter() - begun)
        assert numbers == [*range(numbers[0], numbers[0] + 60)]
        assert rate > 10
        with pytest.raises(TimeoutError):  # of live noise one frame alone is in flight
            silent.recv(timeout=0.5)
        silent.send("1")
        received(silent, 5)


def test_garbage_ends_a_connection_and_nothing_else(address):
    """10,000 messages: short ones count as acknowledgements at most, long ones end their sender."""
    random = np.random.default_rng(3)
    with opened(address) as steady:
        received(steady, 3)
        sent = ended = 0
        while sent < 10_000:
            with opened(address) as client:
                try:
                    for _ in range(2000):
                        low, high = (0, 17) if random.random() < 0.999 else (17, 2**17)
                        size = int(random.integers(low, high))
                        data = random.bytes(size)
                        client.send(
                            data if random.random() < 0.5 else data.decode("latin1")[: size // 2]
                        )
                        sent += 1
                except ConnectionClosed:
                    ended += 1
            received(steady, 1)
        assert ended >= 3
        received(steady, 20)
    with opened(address) as after:
        received(after, 5)


def test_bytes_that_are_no_http_end_themselves(address):
    host, port = address.removeprefix("http://").split(":")
    for _ in range(50):
        with socket.create_connection((host, int(port)), timeout=10) as raw:
            raw.sendall(os.urandom(200) + b"\r\n\r\n")
    with opened(address) as client:
        received(client, 5)


def test_pages_of_others_open_nothing(address):
    """An image, a frame, a script, at this port or another one: refused. A link, and the page itself, are let in."""
    for site, mode, destination, status in (
        ("cross-site", "no-cors", "image", 403),
        ("same-site", "no-cors", "script", 403),
        ("cross-site", "navigate", "iframe", 403),
        ("cross-site", "cors", "empty", 403),
        ("cross-site", "navigate", "document", 200),
        ("same-origin", "cors", "empty", 200),
        ("none", "navigate", "document", 200),
    ):
        heads = {"Site": site, "Mode": mode, "Dest": destination}
        request = Request(address, headers={f"Sec-Fetch-{key}": heads[key] for key in heads})
        try:
            with urlopen(request, timeout=30) as page:
                found, framed = page.status, page.headers["X-Frame-Options"]
                assert framed == "DENY" and "frame-ancestors 'none'" in page.headers.as_string()
        except HTTPError as error:
            found = error.code
        assert found == status, (site, mode, destination)


@pytest.mark.slow
def test_requests_without_a_stream_change_no_stream(address):
    """Pages without a browser, more than are kept: the stream that is open can open again."""
    with urlopen(address, timeout=30) as page:
        token = re.search(r"/picture/([\w-]+)", page.read().decode())[1]
    url = f"{address.replace('http', 'ws')}/picture/{token}"
    assert MOST_UNSEEN > MOST_STREAMS
    with connect(url, origin=address, max_size=2**24) as client:
        received(client, 3)
        for _ in range(MOST_UNSEEN + 4):
            urlopen(address, timeout=30).close()
        received(client, 3)
    with connect(url, origin=address, max_size=2**24) as client:
        received(client, 3)


@contextmanager
def messages_of(address):
    """A page's connection for messages, and the page's identity."""
    with urlopen(address, timeout=30) as page:
        client = re.search(r"""client_id["']:\s*["']([\w-]+)""", page.read().decode())[1]
    query = f"EIO=4&transport=websocket&client_id={client}&tab_id=a&document_id=b"
    query += "&implicit_handshake=true&next_message_id=0"
    url = f"{address.replace('http', 'ws')}/_nicegui_ws/socket.io/?{query}"
    with connect(url, origin=address) as messages:
        messages.recv(timeout=10)
        messages.send("40")
        assert messages.recv(timeout=10).startswith("40")
        yield messages, client


@pytest.mark.slow
def test_malformed_messages_leave_nothing_behind(tmp_path):
    """They end their connection, or are told in a line; SIGTERM then ends the process with all that is open."""
    with serving(
        "colorchecker",
        "--camera",
        "phone",
        "--size",
        "160x100",
        "--device",
        "opencl",
        folder=tmp_path,
    ) as (address, process):
        for bad in ("", "42", '42["event",3]', "451-[]", "9", '42["handshake",{}]', b"\x04"):
            with messages_of(address) as (client, _), pytest.raises(ConnectionClosed):
                client.send(bad)
                while True:
                    client.recv(timeout=10)
        with messages_of(address) as (client, identity), opened(address) as stream:
            received(stream, 2)
            for number in range(200):  # of elements, with a listener that none has
                content = (
                    f'{{"client_id":"{identity}","id":{number},"listener_id":"none","args":["1"]}}'
                )
                client.send(f'42["event",{content}]')
            received(stream, 2)
            begun = time.perf_counter()
            process.terminate()
            written, _ = process.communicate(timeout=20)
            assert time.perf_counter() - begun < 5  # on a busy machine
    assert "Traceback" not in written
