"""Limit on what a client may send to the preview in one request."""

from gpusim.apps.preview.uploads import MOST_BYTES

FORM = 2**16  # [byte] of a form around a file


class BodyLimit:
    """Refuses requests whose body is longer than a limit, before it is read.

    A body needs the header Content-Length, which browsers send. The server reads no further than it
    says.

    Args:
        inner: The application.
        most: Longest body [byte].
    """

    def __init__(self, inner, most: int = MOST_BYTES + FORM):
        self._inner, self._most = inner, most

    async def __call__(self, scope, receive, send):
        """Handle a request, as an ASGI application."""
        refusal = self._refusal(scope) if scope["type"] == "http" else None
        if refusal is None:
            await self._inner(scope, receive, send)
            return
        status, why = refusal
        headers = [(b"content-type", b"text/plain"), (b"connection", b"close")]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": why.encode()})

    def _refusal(self, scope):
        """Return a status and a reason, or None."""
        heads = {name.lower(): value for name, value in scope["headers"]}
        if b"transfer-encoding" in heads:
            return 411, "wanted the header Content-Length"
        length = heads.get(b"content-length", b"0")
        if not length.isdigit():
            return 400, "Content-Length is no number"
        if int(length) > self._most:
            return 413, f"{int(length)} bytes; allowed are {self._most}"
        return None
