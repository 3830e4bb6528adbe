"""What a plan says of itself."""

from dataclasses import dataclass, field


@dataclass
class Notes:
    """models: stage -> what is modelled, and why; left_out: what is not; predicted: named error bounds. In order."""

    models: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    predicted: dict[str, float] = field(default_factory=dict)
