"""The page's server: who may connect, who may ask, and what strange messages do to it."""

import http.client
import json
import socket
import threading
import time
from contextlib import ExitStack, contextmanager, suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.view import asks
from stressbot_planner.view.board import Board
from stressbot_planner.view.server import WRONG_TOKEN, Desk, PageServer, ReadOnlyDesk

PATIENCE = 60.0


class Notes(Desk):
    """Writes down what is asked for."""

    def __init__(self):
        self.asked, self.stops, self.watches, self._news = [], 0, [], threading.Condition()

    def stop(self):
        with self._news:
            self.stops += 1
            self._news.notify_all()

    def ask(self, word, data):
        if word == "goal":
            asks.goal(data)
        with self._news:
            self.asked.append(word)
            self._news.notify_all()

    def watch(self, is_watched):
        with self._news:
            self.watches.append(is_watched)
            self._news.notify_all()

    def wait_for(self, condition):
        with self._news:
            assert self._news.wait_for(condition, PATIENCE)


@pytest.fixture(scope="module")
def desk():
    return Notes()


@pytest.fixture(scope="module")
def board():
    board = Board()
    board.put("status", {"state": "IDLE"})
    return board


@pytest.fixture(scope="module")
def server(board, desk):
    with PageServer(board, desk) as server:
        yield server


def where(server) -> str:
    return server.address.partition("#")[0].removeprefix("http://").strip("/")


@contextmanager
def joined(server, token=None, path="/events", **more):
    """A connection as the page makes it, which has greeted."""
    given = server.address.partition("#")[2] if token is None else token
    with connect(f"ws://{where(server)}{path}", origin=f"http://{where(server)}", **more) as connection:
        if path == "/events":
            connection.send(json.dumps({"hello": given}))
        yield connection


def heard(connection, kind):
    """The next content of a kind."""
    while True:
        message = json.loads(connection.recv(timeout=PATIENCE))
        if message["kind"] == kind:
            return message["is"]


def get(server, path="/", host=None):
    connection = http.client.HTTPConnection(where(server), timeout=PATIENCE)
    connection.request("GET", path, headers={"Host": host or where(server)})
    answer = connection.getresponse()
    return answer.status, dict(answer.headers), answer.read().decode()


def test_the_page_comes_with_a_policy_that_lets_nothing_in_from_outside(server):
    status, headers, text = get(server)
    assert status == 200 and text.startswith("<!DOCTYPE html>")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'; script-src 'sha256-")
    assert (headers["X-Frame-Options"], headers["Cache-Control"]) == ("DENY", "no-store")


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:80", "192.168.1.1", "[::ffff:7f00:1]"])
def test_another_host_is_refused(server, host):
    assert get(server, host=host)[0] == 403


def test_there_is_one_page_alone(server):
    assert [get(server, path)[0] for path in ("/x", "/../etc/passwd", "/events")] == [404, 404, 404]


def test_it_listens_on_this_machine_alone(server):
    assert server.address.startswith("http://127.0.0.1:")
    assert len(server.address.partition("#")[2]) >= 32


@pytest.mark.parametrize("path", ["/events", "/stop"])
@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "https://127.0.0.1", "file://"])
def test_another_origin_is_refused(server, desk, path, origin):
    before = desk.stops
    with pytest.raises(InvalidStatus) as caught:
        connect(f"ws://{where(server)}{path}", origin=origin)
    assert caught.value.response.status_code == 403 and desk.stops == before


def test_an_address_through_a_tunnel_has_its_own_name(server):
    port = where(server).partition(":")[2]
    with connect(f"ws://localhost:{port}/events", origin=f"http://localhost:{port}") as connection:
        connection.send('{"hello": ""}')
        assert heard(connection, "role") == {"operator": False}


def test_who_has_the_token_may_ask(server, desk):
    with joined(server) as connection:
        assert heard(connection, "role") == {"operator": True}
        connection.send('{"ask": "plan"}')
        desk.wait_for(lambda: "plan" in desk.asked)


def test_a_guest_sees_all_and_may_do_nothing_but_stop(server, desk):
    with joined(server, "") as connection:
        assert heard(connection, "role") == {"operator": False}
        assert heard(connection, "status") == {"state": "IDLE"}
        before, stops = list(desk.asked), desk.stops
        for word in set(asks.WORDS) - {"stop"}:
            connection.send(json.dumps({"ask": word, "robot": 1, "x": 0, "y": 0}))
            assert "read-only" in heard(connection, "refused")
        connection.send('{"ask": "stop"}')
        desk.wait_for(lambda: desk.stops > stops)
        assert desk.asked == before


def test_a_wrong_token_ends_the_connection(server):
    with joined(server, "wrong") as connection, pytest.raises(ConnectionClosed) as caught:
        heard(connection, "role")
    assert caught.value.rcvd.code == WRONG_TOKEN


def test_a_read_only_page_has_no_token_and_gives_nobody_a_right():
    desk = Notes()
    with PageServer(Board(), desk, read_only=True) as server:
        assert "#" not in server.address
        for token in ("", "guessed"):
            with joined(server, token) as connection:
                assert heard(connection, "role") == {"operator": False}
                connection.send('{"ask": "start"}')
                assert "read-only" in heard(connection, "refused")
        assert desk.asked == []


def test_a_file_has_nothing_to_ask():
    with pytest.raises(StressbotError, match="start: cannot be"):
        ReadOnlyDesk().ask("start", {})


def test_two_pages_are_told_the_same(server, board):
    with joined(server) as one, joined(server, "") as other:
        for k in range(3):
            board.put("goals", [[k, 0.5]])
            for connection in (one, other):
                while heard(connection, "goals") != [[k, 0.5]]:
                    pass
    with joined(server, "") as late:
        assert heard(late, "goals") == [[2, 0.5]]


def test_a_page_that_reads_nothing_costs_no_memory_and_holds_up_nobody(server, board):
    large = "x" * 100_000
    with joined(server, "", max_queue=1) as lazy, joined(server, "") as other:
        heard(lazy, "role")
        for k in range(400):
            board.put("frame", [k, large])
        while heard(other, "frame")[0] != 399:
            pass
        count = 0
        while heard(lazy, "frame")[0] != 399:
            count += 1
        assert count < 399


def test_a_stop_comes_first_whatever_waits(server, desk):
    """Its own connection is heard while another one is in the middle of a large message."""
    with joined(server) as busy, joined(server, path="/stop") as line:
        stops = desk.stops
        busy.socket.sendall(b"\x81\xfe\xff\xff")  # the head of a message of 65535 bytes, which never comes
        line.send("stop")
        desk.wait_for(lambda: desk.stops == stops + 1)
        busy.socket.close()


BAD = [
    ("", "no JSON object"), ("[]", "no JSON object"), ("[" * 60_000, "no JSON object"), ('{"ask": 1e999}', "ask: is 'inf'"),
    ("{}", "ask: is missing"), ('{"ask": "fly"}', "ask: is 'fly': use one of stop"), ('{"ask": ["stop"]}', "ask: is no such value"),
    ('{"ask": "goal"}', "robot: is missing"), ('{"ask": "goal", "robot": true}', "robot: is 'True'"),
    ('{"ask": "goal", "robot": 1, "x": 1e999, "y": 0}', "x: is 'inf'"),
    ('{"ask": "goal", "robot": 1, "x": 1e9, "y": 0}', "x: is '1000000000.0': give -1e+07 to 1e+07"),
    ('{"ask": "goal", "robot": 1, "x": ' + "9" * 4000 + ', "y": 0}', "x: is"),
]


@pytest.mark.parametrize(("text", "line"), BAD)
def test_a_bad_message_is_answered_by_one_line(server, text, line):
    with joined(server) as connection:
        connection.send(text)
        said = heard(connection, "refused")
        assert line in said and "\n" not in said


@settings(max_examples=60, deadline=None)
@given(st.one_of(st.text(), st.binary(), st.recursive(st.none() | st.booleans() | st.floats() | st.text(), lambda inner: (
    st.lists(inner) | st.dictionaries(st.sampled_from(["ask", "robot", "x", "y", "hello"]) | st.text(), inner))).map(json.dumps)))
def test_no_message_ends_the_server(server, message):
    for greeting in (False, True):
        where_ = where(server)
        with connect(f"ws://{where_}/events", origin=f"http://{where_}", close_timeout=1) as connection, suppress(ConnectionClosed):
            if greeting:
                connection.send('{"hello": ""}')
            connection.send(message)
    assert get(server)[0] == 200


def test_a_message_that_is_too_large_ends_its_connection_alone(server):
    with joined(server, "") as other:
        with joined(server, "") as connection, pytest.raises(ConnectionClosed) as caught:
            connection.send("x" * (asks.LARGEST_MESSAGE + 1))
            while True:
                connection.recv(timeout=PATIENCE)
        assert caught.value.rcvd.code == 1009
        other.send("{}")
        assert "ask: is missing" in heard(other, "refused")


def test_a_port_that_is_taken_is_said_in_one_line(server):
    port = int(where(server).partition(":")[2])
    with pytest.raises(StressbotError, match=f"--port: {port} is taken: give another") as caught:
        PageServer(Board(), ReadOnlyDesk(), port)
    assert caught.value.code == ErrorCode.OUT_OF_RANGE


CHOSEN = {
    "planner": "optimize", "objective": "time", "tolerance": 0, "time_limit": 5, "assign": False, "near": 30, "patience": 600,
}


def test_settings_are_read():
    chosen = asks.settings(CHOSEN)
    assert (chosen.planner, chosen.objective, chosen.near) == ("optimize", "time", 30.0)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"planner": "magic"}, "planner: is 'magic': use one of"), ({"planner": 3}, "planner: is '3'"),
        ({"objective": "cheap"}, "objective: is 'cheap'"), ({"objective": None}, "objective: is missing"),
        ({"tolerance": -1}, "tolerance: is '-1': give 0 to"), ({"tolerance": "1"}, "tolerance: is '1': give a number"),
        ({"time_limit": 0}, "time_limit: is '0': give 0.01 to 3600"), ({"time_limit": 1e9}, "time_limit: is '1000000000.0'"),
        ({"assign": 1}, "assign: is '1': give true or false"), ({"near": 0}, "near: is '0'"),
        ({"patience": 1e6}, "patience: is '1000000.0'"),
    ],
)
def test_settings_are_refused_by_field(change, line):
    with pytest.raises(StressbotError) as caught:
        asks.settings(CHOSEN | change)
    assert str(caught.value).startswith(line)


def test_who_floods_is_read_slowly_and_a_stop_is_heard_all_the_same(server, desk, board):
    """However much one page asks, few of it have been taken when a stop comes, and others are told what is new."""
    with joined(server) as busy, joined(server, path="/stop") as line, joined(server, "") as other:
        begin, stops = desk.asked.count("start"), desk.stops
        for _ in range(2000):
            busy.send('{"ask": "start"}')
        line.send("stop")
        desk.wait_for(lambda: desk.stops > stops)
        assert desk.asked.count("start") - begin < 2000
        board.put("motion", "new")
        while heard(other, "motion") != "new":
            pass


def test_who_has_flooded_does_not_hold_up_the_end(board):
    desk = Notes()
    with PageServer(board, desk) as server, joined(server, close_timeout=1) as busy:
        for _ in range(2000):
            busy.send('{"ask": "start"}')
        server.close()
    assert desk.asked.count("start") < 2000  # what has come would have been read for half a minute


def test_pictures_are_made_while_somebody_watches_and_come_alike_to_all(server, desk):
    desk.watches.clear()
    with joined(server, path="/pictures") as first, joined(server, path="/pictures") as second:
        desk.wait_for(lambda: desk.watches == [True])
        with joined(server) as events:  # which shows that the second one is there, too
            heard(events, "role")
        for picture in (b"one", b"two"):
            server.show(picture)
            assert [one.recv(timeout=PATIENCE) for one in (first, second)] == [picture, picture]
        first.close()
        server.show(b"three")
        assert second.recv(timeout=PATIENCE) == b"three"
        assert desk.watches == [True]
    desk.wait_for(lambda: desk.watches == [True, False])


@pytest.mark.timing
def test_who_answers_nothing_does_not_keep_the_server(board, desk):
    """By themselves websockets wait for ten seconds for each."""
    with ExitStack() as stack:
        server = PageServer(board, desk)
        place = where(server)
        more = f"Host: {place}\r\nOrigin: http://{place}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        more += "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        for path in ("/stop", "/events", "/pictures"):
            silent = stack.enter_context(socket.create_connection(place.split(":")))
            silent.sendall(f"GET {path} HTTP/1.1\r\n{more}".encode())
            assert silent.recv(1000).startswith(b"HTTP/1.1 101")
        stack.enter_context(socket.create_connection(place.split(":"))).sendall(b"GET / HT")
        begin = time.monotonic()
        server.close()
        assert time.monotonic() - begin < 8


def test_who_is_slow_misses_pictures_and_gets_the_newest(server, desk):
    desk.watches.clear()
    with joined(server, path="/pictures", max_queue=1) as slow:
        desk.wait_for(lambda: desk.watches == [True])
        for number in range(200):
            server.show(number.to_bytes(4, "big") + bytes(200_000))
        seen = []
        while not seen or seen[-1] != 199:
            seen.append(int.from_bytes(slow.recv(timeout=PATIENCE)[:4], "big"))
    assert seen == sorted(seen) and len(seen) < 200
