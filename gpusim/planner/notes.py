"""What a plan says of itself."""

from dataclasses import dataclass, field

from gpusim.domain.account import Bound


@dataclass
class Notes:
    """models: stage -> what is modelled, and why. left_out: what is not. In order.

    bounds: named errors of the account. beside: named errors that are no part of it.
    """

    models: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    bounds: dict[str, Bound] = field(default_factory=dict)
    beside: dict[str, float] = field(default_factory=dict)

    def without(self, what: str, bound: Bound, name: str):
        """Something is left out at the cost of an error."""
        self.left_out.append(f"{what}: relative rms {bound.rms:.2g}, predicted")
        self.bounds[name] = bound
