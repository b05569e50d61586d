"""Serves the page on 127.0.0.1, and what is on the board over websockets; takes what pages ask for.

Each page has two connections: `/events` for all but one thing, and `/stop` for that. A stop never waits: it has a connection of its
own, nothing comes before it there, and it is handed on at once, by the thread that reads it. A page that shows a camera's pictures
has a third one, `/pictures`: they are large, and hold up nothing else there.
"""

import asyncio
import errno
import http
import logging
import secrets
import threading
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from stressbot_msgs.wording import sentence
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from stressbot_planner.errors import ErrorCode, StressbotError
from stressbot_planner.view import asks, page
from stressbot_planner.view.board import Board, compact

HOST, HOSTS = "127.0.0.1", ("127.0.0.1", "localhost")
EVENTS, STOP, PICTURES = "/events", "/stop", "/pictures"
MOST_CONNECTIONS = 64
CLOSED_WITHIN = 0.5
"""s that pages may take to say good-bye when the server ends"""

GREETING_WITHIN = 10.0
"""s"""
APART = 0.02
"""s from one message of a kind to the next to one page, at least"""

TAKE_APART = 0.015
"""s from one message of a page that is taken to the next: who floods is read slowly, and holds up itself alone"""

WRONG_TOKEN = 4403
"""Code with which a connection is closed; page/link.js says what to do."""

FIRST = ("status", "role", "scene")
"""Kinds that are sent before others that wait."""


class Desk(ABC):
    """Takes what pages ask for, on the server's thread: it must return at once."""

    @abstractmethod
    def stop(self) -> None:
        """Bring the output to rest."""

    @abstractmethod
    def ask(self, word: str, data: dict[str, Any]) -> None:
        """Begin what is asked for; raise StressbotError if it is refused now."""

    @abstractmethod
    def watch(self, is_watched: bool) -> None:
        """Begin to hand pictures to the server, or cease."""


class ReadOnlyDesk(Desk):
    """That of a plan or a recording."""

    def stop(self) -> None:
        """Nothing moves."""

    def ask(self, word: str, data: dict[str, Any]) -> None:
        """Refuse."""
        raise StressbotError(ErrorCode.UNSUPPORTED, word, "cannot be: this page shows a file, and no swarm is there")

    def watch(self, is_watched: bool) -> None:
        """There are none."""


class PageServer:
    """A server on a thread of its own. Use it as a context manager.

    Attributes:
        address: of the page, for those who may do everything; without the part from # on, for guests.
    """

    def __init__(self, board: Board, desk: Desk, port: int = 0, read_only: bool = False):
        """Begin to serve.

        Args:
            board: what pages are told.
            desk: what they may ask of.
            port: 0: any that is free.
            read_only: whether nobody may ask for anything but a stop.

        Raises:
            StressbotError: the port is taken.
        """
        self._board, self._desk, self._port = board, desk, port
        self._token = None if read_only else secrets.token_urlsafe(24)
        self._html = page.live()
        self._connections = self._watching = 0
        self._picture, self._shown = b"", 0  # the newest, and how many there were
        self._loop = asyncio.new_event_loop()
        self._ready, self._failure = threading.Event(), None
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._failure is not None:
            raise self._failure
        self.address = f"http://{HOST}:{self._port}/" + (f"#{self._token}" if self._token else "")

    def __enter__(self) -> "PageServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all connections; those that answer nothing end later, or with the process."""
        with suppress(RuntimeError):  # closed already
            self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(CLOSED_WITHIN)

    def show(self, picture: bytes) -> None:
        """Send a picture to the pages that watch; one that is slow misses those before the newest. Any thread may call this."""
        with suppress(RuntimeError):  # the server is closing
            self._loop.call_soon_threadsafe(self._pictured, picture)

    def _pictured(self, picture: bytes) -> None:
        self._picture = picture
        self._shown += 1
        come, self._come = self._come, asyncio.Event()
        come.set()

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        self._ended, self._come = asyncio.Event(), asyncio.Event()
        logger = logging.getLogger("stressbot.page")
        logger.setLevel(logging.CRITICAL + 1)  # what strangers send is no news
        try:
            server: Server = await serve(
                self._connected, HOST, self._port, process_request=self._request, max_size=asks.LARGEST_MESSAGE,
                compression=None, server_header=None, logger=logger, close_timeout=CLOSED_WITHIN,
            )
        except OSError as error:
            taken = error.errno == errno.EADDRINUSE
            reason = "is taken: give another, or 0 for one that is free" if taken else f"cannot be used ({error.strerror})"
            self._failure = StressbotError(ErrorCode.OUT_OF_RANGE, "--port", f"{self._port} {reason}")
            self._ready.set()
            return
        self._port = next(iter(server.sockets)).getsockname()[1]
        self._ready.set()
        async with server:
            await self._ended.wait()

    # HTTP

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request for the page, refuse what comes from elsewhere, or let a websocket open."""
        host = request.headers.get("Host", "")
        if urlsplit(f"//{host}").hostname not in HOSTS:
            return _response(http.HTTPStatus.FORBIDDEN, "this page answers to 127.0.0.1 and localhost alone\n")
        path = urlsplit(request.path).path
        if request.headers.get("Upgrade", "").lower() == "websocket":
            if request.headers.get("Origin") != f"http://{host}":
                return _response(http.HTTPStatus.FORBIDDEN, "only this page itself may connect\n")
            if path not in (EVENTS, STOP, PICTURES):
                return _response(http.HTTPStatus.NOT_FOUND, "there is no such connection\n")
            if self._connections >= MOST_CONNECTIONS:
                return _response(http.HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open: close some\n")
            return None
        if path != "/":
            return _response(http.HTTPStatus.NOT_FOUND, "there is one page alone: /\n")
        return _response(http.HTTPStatus.OK, self._html, "text/html", {"Content-Security-Policy": page.policy(self._html)})

    # Websockets

    async def _connected(self, connection: ServerConnection) -> None:
        self._connections += 1
        try:
            assert connection.request is not None
            path = urlsplit(connection.request.path).path
            if path == STOP:
                await self._hear_stops(connection)
            elif path == PICTURES:
                await self._send_pictures(connection)
            else:
                await self._talk(connection)
        except (ConnectionClosed, TimeoutError):
            pass
        finally:
            self._connections -= 1

    async def _hear_stops(self, connection: ServerConnection) -> None:
        """Whoever sees the page may stop; whatever is said here means that."""
        async for _ in connection:
            self._desk.stop()
            await asyncio.sleep(TAKE_APART)

    async def _send_pictures(self, connection: ServerConnection) -> None:
        """Whoever sees the page may see what the camera sees."""
        self._watching += 1
        if self._watching == 1:
            self._desk.watch(True)

        async def send() -> None:
            sent = self._shown
            while True:
                while sent == self._shown:
                    await self._come.wait()
                sent = self._shown
                await connection.send(self._picture)

        sending = asyncio.create_task(send())
        try:
            async for _ in connection:
                await asyncio.sleep(TAKE_APART)
        finally:
            self._watching -= 1
            if self._watching == 0:
                self._desk.watch(False)
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending

    async def _talk(self, connection: ServerConnection) -> None:
        given = await self._greeted(connection)
        if given is None:
            return
        is_operator = self._token is not None and secrets.compare_digest(given.encode(), self._token.encode())
        if given and not is_operator and self._token is not None:
            await connection.close(WRONG_TOKEN, "wrong token")
            return
        await connection.send(f'{{"kind":"role","is":{{"operator":{"true" if is_operator else "false"}}}}}')
        outbox = _Outbox(self._board, self._loop)
        sending = asyncio.create_task(outbox.send_to(connection))
        try:
            async for text in connection:
                refusal = self._answer(text, is_operator)
                if refusal:
                    await connection.send(f'{{"kind":"refused","is":{compact(refusal)}}}')
                if self._ended.is_set():  # who has flooded is not read to the end
                    return
                await asyncio.sleep(TAKE_APART)
        finally:
            outbox.close()
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionClosed):
                await sending

    async def _greeted(self, connection: ServerConnection) -> str | None:
        """Return the token of the first message, empty for a guest; None if it is none."""
        first = await asyncio.wait_for(connection.recv(), GREETING_WITHIN)
        try:
            return asks.token(asks.read(first))
        except StressbotError as error:
            await connection.send(f'{{"kind":"refused","is":{compact(sentence(str(error)))}}}')
            await connection.close(1008, "no greeting")
            return None

    def _answer(self, text: str | bytes, is_operator: bool) -> str:
        """Hand on what is asked for; return why it is refused, or nothing."""
        try:
            data = asks.read(text)
            word = asks.word(data)
            if word == "stop":
                self._desk.stop()
                return ""
            if not is_operator:
                raise asks.READ_ONLY
            self._desk.ask(word, data)
        except StressbotError as error:
            return sentence(str(error))
        return ""


class _Outbox:
    """The kinds that one page has not been told yet: however slow it is, no more wait for it than there are kinds."""

    def __init__(self, board: Board, loop: asyncio.AbstractEventLoop):
        self._board, self._loop = board, loop
        self._waiting: dict[str, None] = dict.fromkeys(sorted(board.kinds(), key=_priority))
        self._news = asyncio.Event()
        self._news.set()
        board.listen(self._heard)

    def close(self) -> None:
        self._board.forget(self._heard)

    def _heard(self, kind: str) -> None:
        with suppress(RuntimeError):  # the server is closing
            self._loop.call_soon_threadsafe(self._note, kind)

    def _note(self, kind: str) -> None:
        self._waiting[kind] = None
        self._news.set()

    async def send_to(self, connection: ServerConnection) -> None:
        """Send until the connection ends."""
        while True:
            await self._news.wait()
            self._news.clear()
            while self._waiting:
                kind = min(self._waiting, key=_priority)
                del self._waiting[kind]
                await connection.send(self._board.text(kind))
            await asyncio.sleep(APART)


def _priority(kind: str) -> int:
    return FIRST.index(kind) if kind in FIRST else len(FIRST)


def _response(
    status: http.HTTPStatus, body: str, kind: str = "text/plain", more: dict[str, str] | None = None
) -> Response:
    content = body.encode("utf-8")
    headers = Headers(
        {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(content)),
            "Connection": "close",
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Referrer-Policy": "no-referrer",
            **(more or {}),
        }
    )
    return Response(status.value, status.phrase, headers, content)
