"""`gpusim plan`: what a frame would compute, its errors and its time, without computing it."""

from dataclasses import dataclass
from typing import ClassVar

from gpusim.cli.options import Request, option, write_json
from gpusim.domain.account import STATUS

TEXTS = {
    "help": "models, predicted errors and time of a frame, without computing it; status 1 if the "
    "tolerance is not met, 3 if that cannot be judged"
}


@dataclass(frozen=True, kw_only=True)
class PlanRequest(Request):
    """Options of `gpusim plan`."""

    REFUSED: ClassVar = {
        "scaling": "a plan does not depend on the brightness of the picture",
        "white_balance": "a plan does not depend on the white of the picture",
    }

    json: str | None = option(metavar="FILE", help="also write the plan to a JSON file")


def plan(request: PlanRequest) -> int:
    """Run `gpusim plan`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if the tolerance is not met, 3 if that cannot be judged.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.io.atomic import check_output
    from gpusim.judge.plan_summary import Forecast

    check_output(request.json)
    simulator, scene = request.open_simulator(), request.open_scene()
    request.refuse_unread("plan")
    forecast = Forecast.of(simulator, scene)
    print(forecast)
    write_json(request.json, forecast.as_dict())
    verdict = forecast.plan.verdict
    return 0 if verdict is None else STATUS[verdict.state]
