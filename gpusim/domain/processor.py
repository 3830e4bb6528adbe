"""The image processor: from the mosaic of digital numbers to linear display colours."""

from dataclasses import dataclass

from gpusim.domain.errors import UnknownName

DEMOSAICS = ("bilinear", "adaptive")
WHITE_BALANCES = ("illuminant", "none")
COLORS = ("matrix", "none")


@dataclass(frozen=True)
class Processor:
    """What is done to the raw image.

    demosaic: "bilinear", or "adaptive" (interpolates along the edges).
    white_balance: "illuminant" (the scene's light is known; a perfect diffuser comes out neutral) or "none".
    color: "matrix" (least-squares 3 x C transform to CIE XYZ, trained on reflectances under the scene's light) or
        "none" (channels go to the display as they are).
    training: name of the reflectance set that the matrix is trained on.
    In either case a perfect diffuser in the scene's light renders as display white.
    Raises UnknownName.
    """

    demosaic: str = "bilinear"
    white_balance: str = "illuminant"
    color: str = "matrix"
    training: str = "objects"

    def __post_init__(self):
        for key, known in (("demosaic", DEMOSAICS), ("white_balance", WHITE_BALANCES), ("color", COLORS)):
            if getattr(self, key) not in known:
                raise UnknownName(f"processor.{key}", getattr(self, key), known)
