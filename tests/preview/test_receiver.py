"""A page that has gone is forgotten: nothing that outlives it refers to it."""

import gc
import weakref

from gpusim.apps.preview.receiver import build_receiver


class Owner:
    """A part of a page."""

    async def take(self, kept):
        """Take files."""


def test_a_receiver_forgets_its_page():
    from nicegui import Client
    from nicegui.page import page

    owner, client = Owner(), Client(page("/a-page-that-goes"))
    with client:
        build_receiver("file", "a file", [".csv"], None, owner.take)
    seen = weakref.ref(owner)
    del owner
    gc.collect()
    assert seen() is not None, "the page is there, and needs its part"
    client.delete()
    del client
    gc.collect()
    assert seen() is None
