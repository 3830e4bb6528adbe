"""Sessions of all clients of the preview."""

import secrets
import time
from collections.abc import Callable

from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.state import State

LEFT = 600.0  # [s] that a session without a page is kept
MOST_SESSIONS = 16  # each holds its scene on the device


class Sessions:
    """Sessions of all clients by their tokens; idle ones are removed.

    made: makes a Producer. first: first State.
    """

    def __init__(self, made: Callable[[], Producer], first: State):
        self._made, self._first = made, first
        self._known: dict[str, Session] = {}

    def of(self, token: str, link: str = "") -> tuple[str, Session]:
        """Return the session of a token, or a new one, with the settings of a link.

        Raises BadData.
        """
        now = time.monotonic()
        for name, session in list(self._known.items()):
            if now - session.used > LEFT:
                del self._known[name]
        if token in self._known:
            self._known[token].used = now
            return token, self._known[token]
        while len(self._known) >= MOST_SESSIONS:
            del self._known[min(self._known, key=lambda name: self._known[name].used)]
        state = State.of_link(link, self._first.camera) if link else self._first
        token = secrets.token_urlsafe(16)
        self._known[token] = Session(self._made(), state)
        return token, self._known[token]

    def find(self, token: str) -> Session | None:
        """Return the session of a token, or None."""
        return self._known.get(token)
