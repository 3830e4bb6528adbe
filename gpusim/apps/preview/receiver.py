"""The element of the preview's page that takes files: by drag and drop, or from a dialog."""

from collections.abc import Awaitable, Callable, Iterable
from contextlib import contextmanager
from typing import Any

from nicegui import run, ui

from gpusim.apps.preview.canvas import mark
from gpusim.apps.preview.session import Session
from gpusim.apps.preview.uploads import MOST_BYTES
from gpusim.domain.errors import BadFile, GpusimError

REASONS = "(...args) => emit(args.flat().map(one => [one.failedPropValidation, one.file.name]))"
MIB = MOST_BYTES // 2**20
# no list of files: what was taken is in the page's other elements
STYLE = """
.gpusim-receiver .q-uploader__list, .gpusim-receiver .q-uploader__subtitle { display: none; }
.gpusim-receiver .q-uploader__header { background: transparent; color: inherit; }
"""
DROP = """
document.body.ondragover = (event) => event.preventDefault();
document.body.ondrop = (event) => {
    event.preventDefault();
    getElement(ID).$refs.qRef.addFiles(event.dataTransfer.files);
};
"""
# Quasar's button contains the input of files, and neither has a name for screen readers
NAME_BUTTONS = """
for (const button of document.querySelectorAll(".q-uploader a.q-btn")) {
    button.setAttribute("role", "group");
    for (const one of [button, ...button.querySelectorAll("input")]) one.ariaLabel = "choose a file";
}
"""
REFUSALS = {
    "max-file-size": f"allowed are {MIB} MiB; make it smaller",
    "max-total-size": f"allowed are {MIB} MiB at once; send fewer files",
}


@contextmanager
def notify_errors():
    """Show an error of the block on the page."""
    try:
        yield
    except GpusimError as error:
        ui.notify(str(error), type="negative", multi_line=True, timeout=10000, close_button=True)


def build_receiver(
    name: str,
    label: str,
    suffixes: Iterable[str],
    session: Session,
    take: Callable[[dict[str, str]], Awaitable[None]],
) -> Any:
    """Return an element that takes files of a client and keeps them.

    While the settings name files that this server does not have, only these are taken.

    Args:
        name: Name of the element for tests.
        label: Its text.
        suffixes: Allowed suffixes.
        session: Session of the client.
        take: Coroutine that is called with what was kept, name -> SHA-256.
    """
    suffixes = tuple(suffixes)

    async def receive(event):
        with notify_errors():
            await _receive(event.files, session, suffixes, take)
        element.reset()

    # FastAPI keeps the element's route after the page has gone, and everything to which the route refers
    receivers = [receive]
    ui.context.client.on_delete(lambda: receivers.clear())

    async def receive_while_open(event):
        for receiver in receivers:
            await receiver(event)

    def refuse(event):
        for reason, file in event.args:
            words = REFUSALS.get(reason, f"allowed are {', '.join(suffixes)}; convert it")
            ui.notify(f"{file}: {words}", type="negative", multi_line=True, timeout=10000)

    element = ui.upload(
        label=label,
        multiple=True,
        auto_upload=True,
        max_file_size=MOST_BYTES,
        max_total_size=MOST_BYTES,
        on_multi_upload=receive_while_open,
    )
    element.on("rejected", refuse, js_handler=REASONS)
    element.props(f'flat bordered accept="{",".join(suffixes)}"').props(mark(name))
    ui.add_css(STYLE)
    ui.timer(0.5, lambda: ui.run_javascript(NAME_BUTTONS), once=True)
    return element.classes("w-full gpusim-receiver")


def take_all_drops(element: Any) -> None:
    """Let a receiver take the files that are dropped anywhere on the page."""
    ui.run_javascript(DROP.replace("ID", str(element.id)))


async def _receive(files, session, suffixes, take):
    """Keep files that have arrived. Raises GpusimError."""
    uploads, state = session.producer.shelf.uploads, session.state
    wanted = uploads.missing(state.scene.files | state.used_files)
    kept = {}
    for file in files:
        uploads.check(file.name, file.size(), suffixes)
        path = uploads.arriving()
        try:
            await file.save(path)
        except OSError as error:
            path.unlink(missing_ok=True)
            why = f"cannot be kept: {error.strerror or error}"
            raise BadFile(file.name, why) from error
        named, sha = await run.io_bound(uploads.keep, file.name, path, wanted)
        kept[named] = sha
    if not wanted:
        await take(kept)
    elif not uploads.missing(wanted):
        session.touch()
