"""A client of the preview: its settings, and the frames on their way to it.

Pictures are made while it waits.
"""

import asyncio
import io
import struct
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.apps.preview.controls import CONTROLS
from gpusim.apps.preview.crop import Crop
from gpusim.apps.preview.producer import Picture, Producer
from gpusim.apps.preview.state import History, State
from gpusim.domain.errors import GpusimError, one_line

IN_FLIGHT = 2  # frames that were sent and not yet painted
QUALITY = 85  # of the JPEGs
STILL = 0.3  # [s] without a change after which pictures are exact, and still ones are lossless
POLL = 0.005  # [s] between looks for other settings while a picture is made
SLOW = 0.02  # [s] of a draft after which others of its slider have half the rows and columns
TIMES = 2  # in a row: the first one may build kernels
COUNTED = 30  # frames over which rate and latency are averaged
HEAD = struct.Struct("<III")  # number, version, kind
JPEG, PNG = 0, 1

DEVICE = ThreadPoolExecutor(1, "gpusim-preview")  # makes whole pictures, and what belongs to them
DRAFTS = ThreadPoolExecutor(1, "gpusim-drafts")  # makes drafts of half as many rows and columns


@dataclass(frozen=True)
class Held:
    """A value of a control that makes no picture with the other settings, and the reason."""

    value: Any
    reason: str


async def compute(work, *arguments):
    """Return the result of a function, called in the thread that makes whole pictures."""
    return await _run(DEVICE, work, *arguments)


async def _run(thread, work, *arguments):
    return await asyncio.get_running_loop().run_in_executor(thread, work, *arguments)


class Session:
    """Settings and pictures of a client.

    Attributes:
        error: Error of the last settings, or "".
        held: Name of a control -> its Held. The other settings go on without it, and it is tried
            again with each change of them.
        pages: Functions that forget its pages, by names of these.
    """

    def __init__(self, producer: Producer, state: State):
        self.history, self.producer = History(state), producer
        self.version, self.number = 0, state.frame
        self.shown: Picture | None = None
        self.crop: Crop | None = None  # part that is shown; None: all
        self.error = ""
        self.held: dict[str, Held] = {}
        self._moved = ""  # the control that was moved last
        self._tried = -1  # version of the settings with which held values were tried
        self._good: State | None = None  # settings of the last picture
        self.begun: float | None = None  # when the picture that is being made was begun
        self.used = time.monotonic()
        self._touched = -STILL  # when the settings were changed last
        self._changed = asyncio.Event()  # settings, or a frame was painted
        self._painted: deque[float] = deque(maxlen=COUNTED)
        self._waits: deque[float] = deque(maxlen=COUNTED)
        self.streams = 0  # websockets that show its pictures
        self.was_seen = False  # whether there has been one
        self.pages: dict[str, Callable[[], object]] = {}
        self._whole: asyncio.Future | None = None  # a whole picture that is made
        self._slow: dict[str, int] = {}  # slider -> slow drafts in a row

    @property
    def state(self) -> State:
        """The present settings."""
        return self.history.state

    def set(self, state: State, by: str = "", is_step: bool = False):
        """Take other settings.

        by: the control that was moved. Its movements are one step of the history, unless `is_step`.
        """
        self.history.set(state, "" if is_step else by)
        self.forget_held(by)
        self._moved = by
        self.touch()

    def forget_held(self, name: str):
        """Forget the held value of a control. The thread that makes pictures may be reading the others."""
        self.held = {one: held for one, held in self.held.items() if one != name}

    def step(self, step: Callable[[], bool]) -> bool:
        """Undo or redo: go a step of the history. Return whether there was one."""
        if not step():
            return False
        self.held = {}
        self._moved = ""
        self.touch()
        return True

    def touch(self):
        """Request another picture."""
        self.version += 1
        self.used = self._touched = time.monotonic()
        self._changed.set()

    def touch_page(self):
        """Note that a page uses the session."""
        self.used = time.monotonic()

    @property
    def holds_memory(self) -> bool:
        """Whether its pictures hold memory of the device."""
        return self.producer.holds_memory

    async def release(self) -> None:
        """Free the memory of its pictures. The next picture takes as long as the first one."""
        await self.compute(self.producer.release)
        self.shown = self._whole = None  # a picture, with its bytes

    @property
    def _moves(self) -> bool:
        """Return whether the settings have just changed."""
        return time.monotonic() - self._touched < STILL

    @property
    def rate(self) -> float:
        """Painted frames per second, of the last ones."""
        span = self._painted[-1] - self._painted[0] if len(self._painted) > 1 else 0.0
        if span and time.monotonic() - self._painted[-1] < 2:
            return (len(self._painted) - 1) / span
        return 0.0

    @property
    def latency(self) -> float:
        """Median time from a frame's start to its paint [ms]."""
        return 1e3 * float(np.median(self._waits)) if self._waits else 0.0

    async def compute(self, work, *arguments):
        """See `compute`."""
        return await compute(work, *arguments)

    async def serve(self, send, acknowledged):
        """Send frames on request.

        send: coroutine of bytes; acknowledged: coroutine that waits for a paint.
        """
        begun: deque[float] = deque()

        async def listen():
            while True:
                await acknowledged()
                if begun:  # more acknowledgements than frames say nothing
                    self._waits.append(time.monotonic() - begun.popleft())
                    self._painted.append(time.monotonic())
                self._changed.set()

        async def push():
            sent, start = -1, 0.0
            while True:
                version, settles, most = self.version, False, IN_FLIGHT
                if sent == version:
                    if not self._moves:
                        most = 1  # only the noise is new, and the next change must not wait for it
                    if self.error or not self.state.is_live:
                        if self.error or await self._changes(version, STILL):
                            await self._changes(version)
                            continue
                        settles = True
                    elif await self._changes(
                        version, start + self.producer.period - time.monotonic()
                    ):
                        continue
                start = time.monotonic()
                data = await self._make_picture(version, settles)
                while data and len(begun) >= most and self.version == version:
                    await self._change()
                if data and len(begun) < most:  # else there are newer settings
                    begun.append(start)
                    await send(data)
                sent = version
                if settles:
                    await self._changes(version)

        tasks = [asyncio.ensure_future(listen()), asyncio.ensure_future(push())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            for task in tasks:
                task.cancel()

    async def _changes(self, version, within=None):
        """Return whether the settings change from a version within some seconds."""
        if within is not None and within <= 0:
            return self.version != version
        while self.version == version:
            try:
                await asyncio.wait_for(self._change(), within)
            except TimeoutError:
                return False
        return True

    async def _change(self):
        """Wait for other settings, or for a paint."""
        self._changed.clear()
        await self._changed.wait()

    async def _make_picture(self, version, settles):
        """Return a frame's bytes; none if the settings make no picture or have changed: the last one stays."""
        state, crop = self.state, self.crop
        if state.is_live:
            self.number = (self.number + 1) % self.producer.frames
        else:
            self.number = state.frame
        self.begun = time.monotonic()
        try:
            made = await self._make(version, state, self.number, crop, settles)
        except GpusimError as error:
            self.error = str(error)
            return None
        except Exception as error:  # a device that fails: the page says so, and goes on when it can
            self.error = f"the device fails: {one_line(str(error) or type(error).__name__)}"
            return None
        finally:
            self.begun = None
        if made is None:
            return None
        (self.shown, kind, data), self.error = made, ""
        return HEAD.pack(self.shown.number, version % 2**32, kind) + data

    async def _make(self, version, state, number, crop, settles):
        """Return a picture, its kind and its bytes; None if there are other settings before it is made.

        While a whole picture is made, for example planned, there may be drafts of half as many rows and columns.
        """
        drafts = self._moves and not settles
        is_slow = self._slow.get(self._moved, 0) >= TIMES
        if drafts and self._is_busy and not is_slow:
            await asyncio.wait({self._whole}, timeout=SLOW)
        if drafts and crop is None and (self._is_busy or is_slow):
            try:
                made = await _run(DRAFTS, self._encode_half, state, number)
            except GpusimError:
                made = None  # the whole picture finds the value that makes none
            if made is not None:
                return made
        while self._is_busy:
            await asyncio.wait({self._whole}, timeout=POLL)
            if self.version != version:
                return None
        task = asyncio.ensure_future(
            self.compute(self._find_picture, version, state, number, crop, settles, drafts)
        )
        task.add_done_callback(_note_result)
        self._whole = task
        while not task.done():
            await asyncio.wait({task}, timeout=POLL)
            if self.version != version and not drafts:
                return None  # the thread goes on
        if self._whole is task:
            self._whole = None
        return task.result()

    @property
    def _is_busy(self):
        """Whether a whole picture is being made."""
        return self._whole is not None and not self._whole.done()

    def _find_picture(self, version, state, *others):
        """Return a picture of the settings, without a control's value that makes none. others: see `_encode`."""
        if self.held and self._tried != version:
            self._tried = version
            whole = state
            for name, held in self.held.items():
                whole = whole.change(name, held.value)
            try:
                found = self._encode(whole, *others)
            except GpusimError:
                pass  # its reason stands beside the control
            else:
                self.held = {}
                self._take(state, whole)
                return found
        try:
            found = self._encode(state, *others)
        except GpusimError as error:
            found = self._find_without(version, state, error, *others)
            if found is None:
                raise
            return found
        self._good = state
        return found

    def _find_without(self, version, state, error, *others):
        """Return a picture without the last changes, which are held; None if there is none."""
        good, last = self._good, {self._moved} & CONTROLS.keys()
        if good is None or not last or good.camera != state.camera:
            return None
        changed = {
            name
            for name in {**good.changes, **state.changes}
            if good.changes.get(name) != state.changes.get(name)
        }
        for names in dict.fromkeys(map(frozenset, (last & changed, changed - last, changed))):
            if not names:
                continue
            without = state
            for name in names:
                without = without.reset(name)
                if name in good.changes:
                    without = without.change(name, good.changes[name])
            try:
                found = self._encode(without, *others)
            except GpusimError:
                continue
            values = {name: state.changes[name] for name in names if name in state.changes}
            self.held = self.held | {name: Held(one, str(error)) for name, one in values.items()}
            self._tried = version
            self._take(state, without)
            return found
        return None

    def _take(self, state, other):
        """Put other settings in the place of `state`, if they are still the present ones."""
        self._good = other
        if self.state is state:
            self.history.replace(other)

    def _encode_half(self, state, number):
        shown = self.producer.half_picture(state, number)
        return None if shown is None else (shown, JPEG, _jpeg(shown.codes))

    def _encode(self, state, number, crop, settles, drafts):
        shown, slider = self.shown, self._moved
        if not settles or shown is None or shown.facts.get("draft"):
            start = time.monotonic()
            shown = self.producer.picture(state, number, drafts)
            if drafts and slider:
                is_slow = time.monotonic() - start > SLOW
                self._slow[slider] = self._slow.get(slider, 0) + 1 if is_slow else 0
        codes = shown.codes
        if crop is not None:
            parts = np.split(codes, shown.count, axis=1)
            if not crop.fits(parts[0].shape):  # of another scene
                crop = None
            else:
                codes = np.concatenate([part[crop.part] for part in parts], axis=1)
        if settles or crop is not None:
            return shown, PNG, _png(codes)
        return shown, JPEG, _jpeg(codes)


def _note_result(task):
    """Read the error of a task that nobody waits for any more: asyncio would report it."""
    if not task.cancelled():
        task.exception()


def _jpeg(codes):
    import simplejpeg

    return simplejpeg.encode_jpeg(codes, QUALITY, "RGB", "420", fastdct=True)


def _png(codes):
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(codes).save(file, "PNG", compress_level=1)
    return file.getvalue()
