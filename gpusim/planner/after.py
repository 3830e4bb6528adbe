"""After the fact: what a plan errs in a scene that it was not made for, exactly, in probes of that scene."""

from dataclasses import replace

from gpusim.domain.account import SAFETY, Account
from gpusim.planner.facts import Operation
from gpusim.planner.knobs import highlights, spectral
from gpusim.planner.plan import Plan
from gpusim.planner.question import Question
from gpusim.planner.search import HEADROOM


def probed(plan: Plan, question: Question, seconds: float | None) -> Account:
    """The plan's account for another scene that it serves: its planes, or a blur that it leaves out, by probes of that.

    question: of that scene. seconds: of the exposure [s]; None: what the camera would choose. The other errors are
    those of the plan's own scene. plan: one with a watch.
    """
    assert plan.watch is not None
    picture = highlights.whole(question)
    operation = (
        picture.operation(question, None)
        if seconds is None
        else Operation(seconds, picture.level, float(question.sensor.read_sigma**2))
    )
    probes = spectral.probes_of(question, picture, operation)
    if plan.transfers is None:
        bound = probes.unblurred
    else:
        *_, (_, bound) = probes.fused(plan.watch.inputs, plan.transfers)
    account = plan.account.at(operation.seconds)
    return replace(account, bounds=account.bounds | {plan.watched: bound})


def holds(plan: Plan, account: Account) -> bool:
    """Whether a plan is as right by an account of another scene as it was to be for its own."""
    assert plan.tolerance is not None
    own, its = plan.account.total.ratio(plan.tolerance), account.total.ratio(plan.tolerance)
    return SAFETY * its <= max(1, HEADROOM * SAFETY * own)
