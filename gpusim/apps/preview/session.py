"""A client of the preview: its settings, and the frames on their way to it.

Pictures are made while it waits.
"""

import asyncio
import io
import struct
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor

import numpy as np

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


async def compute(work, *arguments):
    """Return the result of a function, called in the thread that makes whole pictures."""
    return await _run(DEVICE, work, *arguments)


async def _run(thread, work, *arguments):
    return await asyncio.get_running_loop().run_in_executor(thread, work, *arguments)


class Session:
    """Settings and pictures of a client. error: error of the last settings, or ""."""

    def __init__(self, producer: Producer, state: State):
        self.history, self.producer = History(state), producer
        self.version, self.number = 0, state.frame
        self.shown: Picture | None = None
        self.crop: Crop | None = None  # part that is shown; None: all
        self.error = ""
        self.begun: float | None = None  # when the picture that is being made was begun
        self.used = time.monotonic()
        self._touched = -STILL  # when the settings were changed last
        self._changed = asyncio.Event()  # settings, or a frame was painted
        self._painted: deque[float] = deque(maxlen=COUNTED)
        self._waits: deque[float] = deque(maxlen=COUNTED)
        self.streams = 0  # websockets that show its pictures
        self.was_seen = False  # whether there has been one
        self._slider = ""  # what was moved last
        self._whole: asyncio.Future | None = None  # a whole picture that is made, or was last
        self._slow: dict[str, int] = {}  # slider -> slow drafts in a row

    @property
    def state(self) -> State:
        """The present settings."""
        return self.history.state

    def set(self, state: State, by: str = ""):
        """Take other settings. by: the slider that moves; "" for a separate step of the history."""
        self.history.set(state, by)
        self._slider = by
        self.touch()

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
        self.shown = None
        await self.compute(self.producer.release)

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
        drafts, slider = self._moves and not settles, self._slider
        if drafts and self._is_busy:
            await asyncio.wait({self._whole}, timeout=SLOW)
        if drafts and crop is None and (self._is_busy or self._slow.get(slider, 0) >= TIMES):
            made = await _run(DRAFTS, self._encode_half, state, number)
            if made is not None:
                return made
        while self._is_busy:
            await asyncio.wait({self._whole}, timeout=POLL)
            if self.version != version:
                return None
        self._whole = asyncio.ensure_future(
            self.compute(self._encode, state, number, crop, settles, drafts, slider)
        )
        self._whole.add_done_callback(_note_result)
        while not self._whole.done():
            await asyncio.wait({self._whole}, timeout=POLL)
            if self.version != version and not drafts:
                return None  # the thread goes on
        return self._whole.result()

    @property
    def _is_busy(self):
        """Whether a whole picture is being made."""
        return self._whole is not None and not self._whole.done()

    def _encode_half(self, state, number):
        shown = self.producer.half_picture(state, number)
        return None if shown is None else (shown, JPEG, _jpeg(shown.codes))

    def _encode(self, state, number, crop, settles, drafts, slider):
        shown = self.shown
        if not settles or shown is None or shown.facts.get("draft"):
            start = time.monotonic()
            shown = self.producer.picture(state, number, drafts)
            if drafts and slider:
                is_slow = time.monotonic() - start > SLOW
                self._slow[slider] = self._slow.get(slider, 0) + 1 if is_slow else 0
        codes = shown.codes if crop is None else shown.codes[crop.part]
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
