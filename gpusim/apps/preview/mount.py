"""The preview's addresses: its page, and the websocket with a session's pictures."""

from nicegui import app, ui

from gpusim.apps.preview.page import Page
from gpusim.apps.preview.recipes import Start
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.sessions import Sessions
from gpusim.apps.preview.state import State
from gpusim.domain.errors import GpusimError


def mount(made, first: State, title: str, shape: tuple[int, int], start: Start) -> Sessions:
    """Add the page and its websocket to NiceGUI's application.

    made: makes a client's Producer. first: settings of a new page. Others: see `Page`.
    """
    from fastapi import WebSocket, WebSocketDisconnect

    sessions = Sessions(made, first)

    @ui.page("/")
    def page(s: str = "", state: str = ""):
        try:
            token, session = sessions.of(s, state)
        except GpusimError as error:
            ui.label(str(error)).classes("text-red-500")
            return
        client = ui.context.client
        session.pages[client.id] = client.delete
        client.on_delete(lambda: session.pages.pop(client.id, None))
        Page(session, token, title, shape, start).build()
        ui.run_javascript(f"history.replaceState(null, '', '/?s={token}')")

    @app.websocket("/picture/{token}")
    async def picture(socket: WebSocket, token: str):
        session = sessions.find(token)
        if session is None:
            await socket.close(1008)
            return
        with sessions.streaming(session) as is_let_in:
            if is_let_in:
                await socket.accept()
                await stream(session, socket)
            else:
                await socket.close(1013)

    async def stream(session: Session, socket: WebSocket):
        """Send pictures until the page has gone."""

        async def wait_for_paint():
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect
            if len(message.get("text") or message.get("bytes") or "") > 16:
                await socket.close(1009)
                raise WebSocketDisconnect

        try:
            await session.serve(socket.send_bytes, wait_for_paint)
        except (WebSocketDisconnect, RuntimeError):
            pass  # it has gone

    app.on_startup(sessions.watch)
    return sessions
