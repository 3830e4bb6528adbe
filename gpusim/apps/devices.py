"""Work of several devices at the same time: each has a pipeline of its own."""

from collections.abc import Generator, Iterable, Sequence
from contextlib import ExitStack, closing
from typing import Any, TypeVar

from gpusim.apps.video.pipeline import ahead

T = TypeVar("T")
HELD = 2  # items that each pipeline makes ahead
END: Any = object()


def run_together(
    pipelines: Sequence[Iterable[T]], turns: Iterable[int] | None = None
) -> Generator[T, None, None]:
    """Yield the items of pipelines, each of which runs in its own thread.

    An error of one is raised here, when its item's turn comes. It ends the others after their current item, as closing
    this generator does.

    Args:
        pipelines: The pipelines.
        turns: For each item the number of its pipeline. None: all pipelines in turn, each until its end.
    """
    if len(pipelines) == 1:
        yield from pipelines[0]
        return
    with ExitStack() as stack:
        running = [stack.enter_context(closing(ahead(one, HELD))) for one in pipelines]
        for turn in () if turns is None else turns:
            yield next(running[turn])
        while turns is None and running:
            for one in [*running]:
                item = next(one, END)
                if item is END:
                    running.remove(one)
                else:
                    yield item
