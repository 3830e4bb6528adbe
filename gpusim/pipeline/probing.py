"""Estimates after the fact: when a plan that is kept is compared with exact values of a scene at hand, and what stays.

The survey of every scene tells how the root mean square of a plan's error changes (`gpusim.optics.drift`), and that of
a few rows, but not what it is at the worst pixels. Probes tell that, at the cost of a frame or two, and so they become
rare while nothing changes: the first scene that a plan was not made for is probed, and then, each time that the plan
holds, one after about three times as many as before. Where the survey rises beyond all that it has told before, a probe
is due at once, and it counts from the start. So over n scenes there are about log3(n) probes, and as many more for each
such rise, of which there are few.
"""

from dataclasses import replace

import numpy as np

from gpusim.domain.account import Account
from gpusim.domain.scene import Scene
from gpusim.planner.plan import Plan

MOVED = 1.1  # times the largest that the survey has told: as far as a choice of planes has room
TIMES = 3  # as many scenes until the next probe as until the one before
KINDS = 16  # of scenes that are remembered


class Probing:
    """Of programs that share their plan.

    count: probes so far. What a miss teaches is how many planes scenes of its kind take at least, and stays until
    another camera asks for other plans, or KINDS other kinds of scenes have missed since.
    """

    def __init__(self):
        self.count = 0
        self._least: dict[tuple, int] = {}
        self._missed: tuple[int, str] | None = None  # planes of the plan that did, and words
        self._interval = 1
        self._begin(None)

    def _begin(self, plan):
        self._plan, self._scene, self._since = plan, None, 0
        self._account: Account | None = None
        self._drift: float | None = None  # of the scene that was probed
        self._highest: tuple[float, float] | None = (
            None  # drift, and that of the steepest rows, where probes held
        )
        self._awaited: Scene | None = None  # the same, until the survey has told its drift
        self._name = ""

    def least(self, scene: Scene) -> int:
        """Planes that a plan for the scene has at least."""
        return self._least.get(kind_of(scene), 0)

    def forget(self):
        """Planes are of another camera from now on."""
        self._least.clear()

    @property
    def words(self) -> str:
        """Why the plan is made anew, where a probe missed."""
        return "" if self._missed is None else self._missed[1]

    def planned(self, plan: Plan):
        """A plan was made; after a miss it is what scenes of this kind take."""
        if plan is self._plan:
            return
        if self._missed is None or plan.count > self._missed[0]:
            self._interval = 1  # else nothing better can be had, and looking for it is to become rare all the same
        if self._missed is not None:
            self._remember(plan.scene, plan.count)
        self._missed = None
        self._begin(plan)

    def _remember(self, scene, count):
        kind = kind_of(scene)
        self._least[kind] = max(self._least.pop(kind, 0), count)
        while len(self._least) > KINDS:
            del self._least[next(iter(self._least))]

    def is_due(self, plan: Plan, scene: Scene) -> bool:
        """Whether to probe a scene, which counts once."""
        if plan.watch is None or plan.tolerance is None or scene in (plan.scene, self._scene):
            return False
        self._scene = scene
        self._since += 1
        return self._since >= self._interval

    def found(self, scene: Scene, account: Account, holds: bool):
        """What probes of a scene told."""
        plan, since = self._plan, self._since - 1
        self.count += 1
        self._interval, self._since = (
            TIMES * self._interval + 1,
            0,
        )  # no even steps, which scenes in turn might follow
        self._account, self._name, self._awaited, self._drift = account, scene.name, scene, None
        if not holds:
            words = f"{plan.count} planes" if plan.count else "leaving the blur out"
            unsure = f"; the {since} before were not probed" if since else ""
            self._missed = (
                plan.count,
                f"{words} would miss: {account.verdict(plan.tolerance).words}{unsure}",
            )

    def surveyed(self, plan: Plan, scene: Scene, drift: float, steepest: float):
        """What the survey told of a scene, later: its drift, and that of its steepest rows."""
        if plan is not self._plan or self._account is None:
            return
        seen, highest = (drift, steepest), self._highest
        is_probed = scene is self._awaited
        if is_probed:
            self._awaited, self._drift = None, drift
        elif highest is not None and any(
            its > MOVED * most for its, most in zip(seen, highest, strict=True)
        ):
            self._interval, self._scene = (
                1,
                None,
            )  # this scene, if it is still at hand, else the next
            is_probed = True
        if is_probed:
            self._highest = (
                seen if highest is None else (max(drift, highest[0]), max(steepest, highest[1]))
            )

    def note_misfit(self, plan: Plan, scene: Scene, more: int, is_at_hand: bool):
        """A plan did not do for a scene by its survey, which says how many more planes would.

        is_at_hand: whether another is made for that scene, whose probes tell it, not for the next.
        """
        if is_at_hand:
            self._missed = plan.count, ""
        else:
            self._remember(scene, plan.count + more)

    def annotate(self, plan: Plan, scene: Scene, drift: float | None) -> Plan:
        """The plan as that of another scene, by the last probes and what the survey found since."""
        account, name = self._account, self._name
        if account is None or plan is not self._plan:
            return plan.of(scene, drift)
        bounds, words = account.bounds, "this scene's"
        if self._since:
            words = f"those of {name}, {self._since} scenes ago"
            if drift and self._drift:
                words += ", and what the device saw of this one"
                bounds = bounds | {plan.watched: bounds[plan.watched].times(drift / self._drift)}
        return replace(plan.of(scene, None, replace(account, bounds=bounds)), probed=words)


def kind_of(scene: Scene) -> tuple:
    """What scenes that one plan serves have in common: see `Plan.serves`."""
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
