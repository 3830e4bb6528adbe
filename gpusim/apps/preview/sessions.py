"""Sessions of all clients of the preview, and the memory that they use."""

import asyncio
import gc
import secrets
import time
from collections.abc import Callable
from contextlib import contextmanager

from gpusim.apps.preview.memory import free_memory
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.session import Session, compute
from gpusim.apps.preview.state import State
from gpusim.domain.errors import Conflict

AWAY = 5.0  # [s] without a stream after which a session's scene leaves the device
LEFT = 600.0  # [s] that the settings of a session without a stream are kept
UNSEEN = 60.0  # [s] likewise, of a session that has never had one
MOST_STREAMS = 16  # each holds its scene on the device
MOST_SESSIONS = 256  # with and without a stream; without one it is only settings
MOST_UNSEEN = 20  # sessions that have never had a stream; a page of one takes 4 MiB
MOST_WAITING = 1  # sessions without a stream that keep their memory for AWAY
FORGOTTEN = 12.0  # [s] after which NiceGUI has forgotten a page whose session was removed
LOOK = 1.0  # [s] between looks for sessions that were left


class Sessions:
    """Sessions of all clients by their tokens.

    A session with a stream is never removed. One without gives back its memory soon, and is removed later, or when
    there are too many: first those that have never had a stream.

    Args:
        made: Makes a Producer.
        first: First State.
    """

    def __init__(self, made: Callable[[], Producer], first: State):
        self._made, self._first, self._device = made, first, made().device
        self._known: dict[str, Session] = {}
        self._has_garbage = False  # elements of pages, which refer to one another

    @property
    def streams(self) -> int:
        """Number of streams of all sessions."""
        return sum(session.streams for session in self._known.values())

    def of(self, token: str, link: str = "") -> tuple[str, Session]:
        """Return the session of a token, or a new one, with the settings of a link.

        Raises:
            BadData: The link is wrong.
            Conflict: There are too many streams for another one.
        """
        self._remove_old()
        if token in self._known:
            self._known[token].touch_page()
            return token, self._known[token]
        if self.streams >= MOST_STREAMS:
            reason = f"{MOST_STREAMS} pages of this preview are open"
            raise Conflict("this page", reason, "close one of them and load this page again")
        state = State.of_link(link, self._first.camera) if link else self._first
        self._make_room()
        token = secrets.token_urlsafe(16)
        self._known[token] = Session(self._made(), state)
        return token, self._known[token]

    def find(self, token: str) -> Session | None:
        """Return the session of a token, or None."""
        return self._known.get(token)

    @contextmanager
    def streaming(self, session: Session):
        """Count a stream of a session inside the block. The value is False if there are too many."""
        if self.streams >= MOST_STREAMS:
            yield False
            return
        session.streams += 1
        session.was_seen = True
        try:
            yield True
        finally:
            session.streams -= 1
            session.touch_page()

    async def watch(self) -> None:
        """Free the memory of sessions that were left, again and again."""
        again_at = None
        while True:
            await asyncio.sleep(LOOK)
            if self._has_garbage:
                self._has_garbage = False
                gc.collect()
            left, gone = await self.release_left(), self._remove_old()
            now = time.monotonic()
            if left or gone:  # the pages are forgotten a little later
                again_at = now + FORGOTTEN
            if left or (again_at is not None and now > again_at):
                again_at = again_at if left or gone else None
                await compute(free_memory, self._device, not self.streams)

    async def release_left(self) -> list[Session]:
        """Release sessions that have had no stream for a while, and all but the last MOST_WAITING. Return them."""
        now = time.monotonic()
        idle = [one for one in self._known.values() if one.holds_memory and not one.streams]
        idle.sort(key=lambda session: session.used)
        last = max(len(idle) - MOST_WAITING, 0)
        left = idle[:last] + [one for one in idle[last:] if now - one.used > AWAY]
        for session in left:
            await session.release()
        return left

    def _remove_old(self) -> list[str]:
        """Remove sessions without a stream that were left long ago, and hold no memory. Return their tokens."""
        now, old = time.monotonic(), []
        for name, session in self._known.items():
            most = LEFT if session.was_seen else UNSEEN
            if not session.streams and not session.holds_memory and now - session.used > most:
                old.append(name)
        for name in old:
            self._remove(name)
        return old

    def _make_room(self):
        """Remove sessions without a stream until there may be another one: first the oldest ones never seen."""
        idle = [name for name, session in self._known.items() if not session.streams]
        idle.sort(key=lambda name: (self._known[name].was_seen, self._known[name].used))
        unseen = sum(not self._known[name].was_seen for name in idle)
        for name in idle[: max(unseen - MOST_UNSEEN, len(self._known) - MOST_SESSIONS, -1) + 1]:
            self._remove(name)

    def _remove(self, name):
        """Remove a session, and its pages of NiceGUI."""
        for forget in [*self._known.pop(name).pages.values()]:
            forget()
            self._has_garbage = True
