"""When to probe a scene: compare a reused plan with exact values of the scene.

A survey of each scene gives the change of a plan's RMS error, how rough and how bright the scene is, in the frame and
in a few rows (`gpusim.optics.fusion`), but not the error of the worst pixels. Probes give it, at the cost of a frame
or two, so they become rare while nothing changes. The first scene that a plan was not made for is probed. Each time
that the plan holds, the interval to the next probe becomes about three times longer. If a number of the survey rises
above all its earlier values, a probe is due at once and the interval starts again. So n scenes need about log3(n)
probes, and as many again for each rise. Rises are few.

A probe looks at a content, not at its view: windows are drawn all over the content, and a view's error is a mean over
all places and angles. So views of a content that was planned for or probed need no probe, unless they magnify it more.
"""

from dataclasses import replace

import numpy as np

from gpusim.domain.account import Account, Bound
from gpusim.domain.content import Content
from gpusim.domain.scene import Scene
from gpusim.optics.fusion import Surveyed, Watch
from gpusim.planner.plan import Plan

MOVED = 1.1  # times the largest value of the survey: the margin with which planes are chosen
TIMES = 3  # growth of the interval between probes
KINDS = 16  # number of kinds of scenes that are remembered


class Probing:
    """The probes of loops that share a plan.

    A miss sets the minimum number of planes for scenes of its kind. It is remembered until a camera needs other plans,
    or until KINDS other kinds of scenes have missed.

    Attributes:
        count: Number of probes so far.
        words: Why a new plan is made, if a probe missed; else "".
    """

    def __init__(self):
        self.count = 0
        self.words = ""
        self._least: dict[tuple, int] = {}
        self._missed: int | None = None  # number of planes of the plan that missed
        self._interval = 1
        self._begin(None)

    def _begin(self, plan):
        self._plan, self._scene, self._since = plan, None, 0
        # content and zoom of the scenes whose errors are known: of the plan's own, and of the one that was probed last
        self._own = None if plan is None else (plan.scene.content, plan.scene.view.zoom)
        self._probed: tuple[Content, float] | None = None
        self._zoom = 1.0 if plan is None else plan.scene.view.zoom  # largest of scenes that held
        self._account: Account | None = None  # of the last probes
        self._worst: Account | None = None  # with the largest errors of all probes
        self._drift: float | None = None  # of the scene that was probed
        # largest numbers of the surveys of scenes whose probes held
        self._highest: tuple[float, ...] | None = None
        self._awaited: Scene | None = None  # the probed scene, until its survey arrives
        self._name = ""
        # outputs "not met" by the errors of earlier scenes since the last own probes, and before the next
        self._doubted, self._doubts = 0, 1

    def least(self, scene: Scene) -> int:
        """Return the minimum number of planes of a plan for the scene."""
        return self._least.get(kind_of(scene), 0) if self._least else 0

    def forget(self):
        """Forget the numbers of planes: the camera has changed."""
        self._least.clear()

    def set_plan(self, plan: Plan):
        """Begin to use a new plan. After a miss its planes are the minimum for scenes of this kind."""
        if plan is self._plan:
            return
        if self._missed is None or plan.count > self._missed:
            self._interval = 1  # otherwise no better plan exists, and probes must still become rare
        if self._missed is not None:
            self._remember(plan.scene, plan.count)
        self._missed, self.words = None, ""
        self._begin(plan)

    def _remember(self, scene, count):
        kind = kind_of(scene)
        self._least[kind] = max(self._least.pop(kind, 0), count)
        while len(self._least) > KINDS:
            del self._least[next(iter(self._least))]

    @property
    def are_of_last(self) -> bool:
        """Whether the last scene was probed."""
        return self._account is not None and not self._since

    def is_doubted(self, plan: Plan, scene: Scene) -> bool:
        """Return True if a scene that is "not met" by the errors of earlier scenes must be probed itself.

        Each time that its own errors confirm that, the interval to the next such probe becomes about three times
        longer. A view of the plan's own content errs like that, see `is_due`.
        """
        if self.are_of_last or (self._account is None and scene.content is plan.scene.content):
            return False
        self._doubted += 1
        return self._doubted >= self._doubts

    def confirm(self, is_met: bool):
        """Take the verdict of a scene's own probes, which an earlier scene's errors had called "not met"."""
        self._doubted, self._doubts = 0, 1 if is_met else TIMES * self._doubts + 1

    def is_due(self, plan: Plan, scene: Scene) -> bool:
        """Return True if a scene must be probed. Each scene counts once, and views of one content as one.

        Views of the plan's own content err alike, even in another call if its planes have no error, unless they magnify
        it more.
        """
        watch = plan.find(Watch)
        if watch is None or plan.tolerance is None or scene in (plan.scene, self._scene):
            return False
        content, zoom = scene.content, scene.view.zoom
        is_larger = zoom > MOVED * self._zoom
        for known in (self._own, self._probed):
            if known is not None and content is known[0] and zoom <= MOVED * known[1]:
                return False
        if content is plan.scene.content and not (is_larger or watch.wrong.size):
            return False
        self._scene = scene
        self._since += 1
        return is_larger or self._since >= self._interval

    def end_scene(self):
        """Let the last scene go. The same object counts as another scene from now on."""
        self._scene = self._awaited = None
        self._own = self._probed = None  # their arrays may be written to

    def found(self, scene: Scene, account: Account, holds: bool):
        """Take the errors that probes of a scene found."""
        plan, since = self._plan, self._since - 1
        self.count += 1
        self._probed = scene.content, scene.view.zoom
        # not a power of TIMES, so scenes that alternate cannot keep the same step
        self._interval, self._since = TIMES * self._interval + 1, 0
        worst = {} if self._worst is None else self._worst.at(account.seconds).bounds
        self._worst = replace(
            account,
            bounds={
                name: account.bounds.get(name, Bound()).largest(worst.get(name, Bound()))
                for name in {**worst, **account.bounds}
            },
        )
        self._account, self._name, self._awaited, self._drift = account, scene.name, scene, None
        self._zoom = max(self._zoom, scene.view.zoom)
        if not holds:
            words = f"{plan.count} planes" if plan.count else "leaving the blur out"
            unsure = f"; the {since} scenes before were not probed" if since else ""
            self._missed = plan.count
            self.words = f"{words} would miss: {account.verdict(plan.tolerance).words}{unsure}"

    def add_survey(self, plan: Plan, scene: Scene, surveyed: Surveyed):
        """Take the survey of a scene, which arrives later."""
        if plan is not self._plan or self._account is None:
            return
        seen, highest = surveyed.measures, self._highest
        is_probed = scene is self._awaited
        if is_probed:
            self._awaited, self._drift = None, surveyed.drift
        elif highest is not None and any(
            its > MOVED * most for its, most in zip(seen, highest, strict=True)
        ):
            # probe this scene if it is still the current one, else the next
            self._interval, self._scene = 1, None
            is_probed = True
        if is_probed:
            self._highest = seen if highest is None else tuple(map(max, seen, highest))

    def note_misfit(self, plan: Plan, scene: Scene, more: int, is_at_hand: bool):
        """Take a scene whose survey shows that its plan does not fit, and the number of missing planes.

        is_at_hand: the new plan is for this scene and its probes set the number of planes; otherwise the plan is for
        the next scene.
        """
        if is_at_hand:
            self._missed, self.words = plan.count, ""
        else:
            self._remember(scene, plan.count + more)

    def annotate(self, plan: Plan, scene: Scene, drift: float | None) -> Plan:
        """Return the plan with errors predicted for another scene, from probes and later surveys.

        A scene that was not probed has the largest errors of all that were; those that the survey sees are scaled.
        """
        account, worst, name = self._account, self._worst, self._name
        if account is None or worst is None or plan is not self._plan:
            return plan.of(scene, drift)
        bounds, words = account.bounds, "from this scene"
        if self._since:
            words = f"from {name}, {self._since} scene{'s' * (self._since > 1)} ago"
            own = bounds.get(plan.watched)
            bounds = worst.bounds
            if drift and self._drift and own is not None:
                words += ", scaled by the survey of this scene"
                bounds = bounds | {plan.watched: own.times(drift / self._drift)}
        return replace(plan.of(scene, None, replace(account, bounds=bounds)), probed=words)


def kind_of(scene: Scene) -> tuple:
    """Return the properties that scenes of one plan share, see `Plan.serves`."""
    content, light = scene.content, scene.illuminant
    shared = [
        np.asarray(getattr(content, name)).tobytes() for name in ("wavelengths", *content.shared)
    ]
    return (
        type(content),
        content.shape,
        *shared,
        light.values.tobytes(),
        light.wavelengths.tobytes(),
        scene.border,
        scene.margin,
        scene.fov,
        scene.samples_per_pixel,
    )
