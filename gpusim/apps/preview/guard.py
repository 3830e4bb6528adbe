"""Access to the preview: only pages of its own address."""

from urllib.parse import urlsplit

LOOPBACK = ("localhost", "127.0.0.1", "::1")


class Guard:
    """Refuses pages and websockets of other origins, and other host names of this address.

    Args:
        inner: The application.
        hosts: Allowed host names; any port, because it may be forwarded from another machine.
    """

    def __init__(self, inner, hosts=LOOPBACK):
        self._inner, self._hosts = inner, {*hosts}

    async def __call__(self, scope, receive, send):
        """Handle a request, as an ASGI application."""
        if scope["type"] in ("http", "websocket") and not self._is_own(scope):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008})
                return
            headers = [(b"content-type", b"text/plain")]
            await send({"type": "http.response.start", "status": 403, "headers": headers})
            await send({"type": "http.response.body", "body": b"wrong Host or Origin"})
            return
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
        return known and all(
            origin in (f"http://{named[0]}", f"https://{named[0]}") for origin in origins
        )
