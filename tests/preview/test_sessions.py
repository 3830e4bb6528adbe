"""Sessions of pages that come and go, and what pages of others can do: nothing."""

import asyncio
from functools import partial

import pytest

from gpusim.apps.preview import sessions as module
from gpusim.apps.preview.messages import is_sound
from gpusim.apps.preview.sessions import Sessions
from gpusim.apps.preview.state import State
from gpusim.backends import open_device
from gpusim.domain.errors import Conflict

STATE = State("phone", tolerance="exact")


class Made:
    """A producer that says whether it holds memory."""

    device, frames, period = open_device("numpy"), 2**32, 0.0

    def __init__(self):
        self.holds_memory = False

    def release(self):
        self.holds_memory = False


@pytest.fixture
def clock(monkeypatch):
    """Time that stands still until it is set."""
    now = [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def test_streams_stay_whatever_others_ask_for(clock):
    """1,000 requests without a stream: the one that streams keeps its session and its memory."""
    sessions = Sessions(Made, STATE)
    token, own = sessions.of("")
    with sessions.streaming(own) as is_let_in:
        own.producer.holds_memory = True
        assert is_let_in
        for _ in range(1000):
            clock[0] += 1
            sessions.of("")
            assert asyncio.run(sessions.release_left()) == []
        assert sessions.find(token) is own and own.holds_memory
        assert len(sessions._known) <= 1 + module.MOST_UNSEEN
    clock[0] += module.LEFT - 1
    assert sessions.of(token) == (token, own)
    clock[0] += module.LEFT + 1
    asyncio.run(sessions.release_left())
    assert sessions.of(token)[0] != token


def test_sessions_without_a_stream_are_few(clock):
    """At one instant 1,000 come: the first that go, with their pages, have never had a stream."""
    sessions = Sessions(Made, STATE)
    token, own = sessions.of("")
    with sessions.streaming(own):
        pass
    forgotten = []
    for number in range(1000):
        sessions.of("")[1].pages["client"] = partial(forgotten.append, number)
    assert len(sessions._known) == 1 + module.MOST_UNSEEN and sessions.find(token) is own
    assert forgotten == [*range(1000 - module.MOST_UNSEEN)]
    for _ in range(1000):
        with sessions.streaming(sessions.of("")[1]):
            pass
    assert len(sessions._known) == module.MOST_SESSIONS and sessions.find(token) is None


def test_memory_goes_after_the_page(clock):
    sessions = Sessions(Made, STATE)
    _, own = sessions.of("")
    with sessions.streaming(own):
        own.producer.holds_memory = True
        clock[0] += 3600
        assert asyncio.run(sessions.release_left()) == []
    clock[0] += module.AWAY - 1  # a page that is loaded again finds it
    assert asyncio.run(sessions.release_left()) == [] and own.holds_memory
    clock[0] += 2
    assert asyncio.run(sessions.release_left()) == [own] and not own.holds_memory
    several = [sessions.of("")[1] for _ in range(5)]
    for one in several:
        with sessions.streaming(one):
            one.producer.holds_memory = True
        clock[0] += 0.1
    assert asyncio.run(sessions.release_left()) == several[: -module.MOST_WAITING]


def test_too_many_streams_are_refused(clock):
    sessions = Sessions(Made, STATE)
    streams = [sessions.streaming(sessions.of("")[1]) for _ in range(module.MOST_STREAMS)]
    _, late = sessions.of("")
    assert all(stream.__enter__() for stream in streams)
    with sessions.streaming(late) as is_let_in:
        assert not is_let_in
    with pytest.raises(Conflict, match="close one of them"):
        sessions.of("")
    streams[0].__exit__(None, None, None)
    with sessions.streaming(late) as is_let_in:
        assert is_let_in


EVENT = '"client_id":"a","id":3,"listener_id":"b"'


@pytest.mark.parametrize(
    "message",
    [
        "3",
        "1",
        "41",
        "40",
        '40{"token":1}',
        f'42["event",{{{EVENT},"args":["1",null]}}]',
        f'42["event",{{{EVENT}}}]',
        '420["handshake",{"client_id":"a","tab_id":"b","document_id":"c","next_message_id":"0"}]',
        '42["handshake",{"client_id":"a","tab_id":"b","document_id":"c","old_tab_id":null}]',
        '42["ack",{"client_id":"a","next_message_id":7}]',
        '42["javascript_response",{"client_id":"a","request_id":"b","result":[1]}]',
        '42["log",{"client_id":"a","level":"error","message":"no"}]',
    ],
)
def test_messages_of_a_page_pass(message):
    assert is_sound(message)


@pytest.mark.parametrize(
    "message",
    [
        None,
        b"3",
        "",
        "x",
        "2",
        "4",
        "40/other,",
        "40[]",
        "42",
        "42[",
        "42{}",
        '42["event"]',
        '42["event",{},1]',
        '42[["event"],{}]',
        '42["disconnect",{"client_id":"a"}]',
        '42["event",{"client_id":3,"id":3,"listener_id":"b"}]',
        '42["event",{"client_id":"a","id":true,"listener_id":"b"}]',
        '42["event",{"client_id":"a","id":"3","listener_id":"b"}]',
        f'42["event",{{{EVENT},"args":"1"}}]',
        f'42["event",{{{EVENT},"args":[1]}}]',
        f'42["event",{{{EVENT},"args":["{{"]}}]',
        '42["handshake",{"client_id":"a","tab_id":"b","document_id":3}]',
        '42["handshake",{"client_id":"a","tab_id":"b","document_id":"c","next_message_id":"x"}]',
        '42["ack",{"client_id":"a","next_message_id":"7"}]',
        '42["ack",{"client_id":"a","next_message_id":1e999}]',
        '42["log",{"client_id":"a","level":"loud","message":"no"}]',
        '421234567890["ack",{"client_id":"a","next_message_id":7}]',
        '451-["event",{"_placeholder":true,"num":0}]',
        "43[]",
        "44{}",
        '42["event",' + "[" * 5000,
    ],
)
def test_other_messages_end_the_connection(message):
    assert not is_sound(message)
