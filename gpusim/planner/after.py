"""Errors of a plan in a scene that it was not made for, exactly, in probes of that scene."""

from dataclasses import replace

from gpusim.domain.account import SAFETY, Account
from gpusim.optics.fusion import Watch
from gpusim.planner.choices import Fusion
from gpusim.planner.facts import Operation
from gpusim.planner.knobs import highlights, spectral
from gpusim.planner.plan import Plan
from gpusim.planner.question import Question
from gpusim.planner.search import HEADROOM


def probe_account(plan: Plan, question: Question, seconds: float | None) -> Account:
    """Return the plan's account for another scene that it serves.

    The errors of its planes, or of a blur left out, come from probes of that scene; the others are
    from the plan's own scene.

    Args:
        plan: A plan with a watch.
        question: Of that scene.
        seconds: Exposure time [s]; None: the camera's choice.
    """
    watch, fusion = plan.find(Watch), plan.find(Fusion)
    assert watch is not None
    picture = highlights.whole(question)
    operation = (
        picture.operation(question, None)
        if seconds is None
        else Operation(seconds, picture.level, float(question.sensor.read_sigma**2))
    )
    probes = spectral.probes_of(question, picture, operation)
    if fusion is None:
        bound = probes.without_blur
    else:
        *_, (_, bound) = probes.fused_bounds(watch.inputs, fusion.transfers)
    account = plan.account.at(operation.seconds)
    return replace(account, bounds=account.bounds | {plan.watched: bound})


def holds(plan: Plan, account: Account) -> bool:
    """Return whether a plan is about as accurate for another scene, by its account, as for its own."""
    assert plan.tolerance is not None
    own, its = plan.account.total.ratio(plan.tolerance), account.total.ratio(plan.tolerance)
    return SAFETY * its <= max(1, HEADROOM * SAFETY * own)
