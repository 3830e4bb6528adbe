"""Access to the preview: only pages of its own address."""

import logging
from urllib.parse import urlsplit

from gpusim.apps.preview.messages import is_sound
from gpusim.domain.errors import one_line

LOOPBACK = ("localhost", "127.0.0.1", "::1")
MESSAGES = "/_nicegui_ws/"  # path of NiceGUI's messages
# the headers of every page: pages of others cannot put it into a frame
UNFRAMED = (
    (b"x-frame-options", b"DENY"),
    (b"content-security-policy", b"frame-ancestors 'none'"),
)
LOGGERS = ("nicegui", "socketio.server", "engineio.server", "uvicorn.error", "asyncio")


class Guard:
    """Refuses requests of pages of others, other host names of this address, and malformed messages.

    A page of others may link to the preview. It cannot load it as an image, in a frame or by a script.

    Args:
        inner: The application.
        hosts: Allowed host names; any port, because it may be forwarded from another machine.
    """

    def __init__(self, inner, hosts=LOOPBACK):
        self._inner, self._hosts = inner, {*hosts}

    async def __call__(self, scope, receive, send):
        """Handle a request, as an ASGI application."""
        kind = scope["type"]
        if kind in ("http", "websocket") and not self._is_own(scope):
            if kind == "websocket":
                await send({"type": "websocket.close", "code": 1008})
                return
            headers = [(b"content-type", b"text/plain")]
            await send({"type": "http.response.start", "status": 403, "headers": headers})
            await send({"type": "http.response.body", "body": b"wrong Host, Origin or Sec-Fetch"})
            return
        if kind == "websocket" and scope["path"].startswith(MESSAGES):
            receive = _checked(receive)
        if kind == "http":
            send = _unframed(send)
        await self._inner(scope, receive, send)

    def _is_own(self, scope):
        heads = [(name.lower(), value.decode("latin1")) for name, value in scope["headers"]]
        named = [value for name, value in heads if name == b"host"]
        origins = [value for name, value in heads if name == b"origin"]
        if len(named) != 1:
            return False
        try:
            known = urlsplit(f"//{named[0]}").hostname in self._hosts
        except ValueError:
            return False
        if scope["type"] == "http" and scope["path"].startswith(MESSAGES):
            return False  # pages send them by a websocket, as the picture comes
        return (
            known
            and all(origin in (f"http://{named[0]}", f"https://{named[0]}") for origin in origins)
            and _is_fetched_by_own(dict(heads))
        )


def _is_fetched_by_own(heads):
    """Return whether a request is of an own page, or opens one in a tab, as far as the browser says."""
    if heads.get(b"sec-fetch-site", "none") in ("same-origin", "none"):
        return True
    opens = heads.get(b"sec-fetch-mode"), heads.get(b"sec-fetch-dest")
    return opens == ("navigate", "document")


def _checked(receive):
    """Return a receiver of messages that ends the connection at a malformed one."""

    async def receive_sound():
        message = await receive()
        if message["type"] != "websocket.receive" or is_sound(message.get("text")):
            return message
        return {"type": "websocket.disconnect", "code": 1008}

    return receive_sound


def _unframed(send):
    """Return a sender that adds UNFRAMED to the headers."""

    async def send_unframed(message):
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *UNFRAMED]}
        await send(message)

    return send_unframed


class _OneLine(logging.Filter):
    """Puts an exception in place of its log message, in one line, without a traceback."""

    def filter(self, record):
        """Change the record; it is always logged."""
        if record.exc_info and record.exc_info[1] is not None:
            error = record.exc_info[1]
            words = f"gpusim preview: {record.name}: {type(error).__name__}: {error}"
            record.msg, record.args = one_line(words), ()
            record.exc_info = record.exc_text = None
        return True


def log_in_lines() -> None:
    """Let the web server and its libraries report an error in one line."""
    for name in LOGGERS:
        logging.getLogger(name).addFilter(_OneLine())
