"""What a plan models and leaves out, with the errors of both."""

from dataclasses import dataclass, field

from gpusim.domain.account import Bound

DECLARED = Bound()  # of what camera or scene declare not to be there: leaving it out is no error


@dataclass
class Notes:
    """What a plan says of itself.

    models: stage -> what is modelled, and why. left_out: what is not, in words. In order.
    bounds: named errors of the account. beside: named errors that are no part of it.
    """

    models: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    bounds: dict[str, Bound] = field(default_factory=dict)
    beside: dict[str, float] = field(default_factory=dict)

    def leave_out(self, words: str, bound: Bound, name: str = "", *, of_scene: bool = False):
        """Leave something out, with a bound of its error. There is no other way to leave something out.

        words: what. bound: DECLARED if camera or scene declare that it is not there; UNKNOWN if nobody can tell: no
        tolerance is called met then. name: of the error in the account; "": the words. of_scene: the scene does not
        hold it. The account is of the scene as it is given, so this error is reported next to the account.
        """
        size = (
            f"relative rms {bound.rms:.2g}, predicted"
            if bound.is_known
            else "its error is not known"
        )
        self.left_out.append(words if bound == DECLARED else f"{words}: {size}")
        if of_scene:
            self.beside[name or words] = bound.rms
        elif bound != DECLARED:
            self.bounds[name or words] = bound
