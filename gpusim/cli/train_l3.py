"""`gpusim train-l3`: filters for a camera from simulated frames."""

from dataclasses import dataclass
from functools import partial

from gpusim.cli.options import DEVICE_HELP, Options, option, reads, scene_option, seed_option

TEXTS = {
    "help": "train a camera's filters for demosaicking, noise, blur and colour on simulated frames"
}


@reads("LOW..HIGH or a list such as 1,10,100 [cd/m2]")
def luminances(text: str) -> tuple[float, ...]:
    """Return the luminances of "LOW..HIGH" or "A,B,C" [cd m-2]. Raises ArgumentTypeError."""
    low, dots, high = text.partition("..")
    return (float(low), float(high)) if dots else tuple(float(part) for part in text.split(","))


@dataclass(frozen=True, kw_only=True)
class TrainRequest(Options):
    """Options of `gpusim train-l3`."""

    scenes: list[str] | tuple = scene_option(
        "scenes to train on in addition to the generated ones: photographs, spectral files with "
        "their light, charts",
        default=(),
        nargs="*",
    )
    camera: str = option(
        required=True, help="as for simulate; any mosaic of three or more channels"
    )
    out: str = option(
        "-o",
        "--out",
        metavar="TABLE.npz",
        help='file of the filters, for [processor] demosaic = "learned", table = "TABLE.npz" in the '
        "camera file",
        required=True,
    )
    light: str = option(default="D65", help="light on the scenes (default: D65)")
    luminance: tuple[float, ...] | None = option(
        type=luminances,
        metavar="LOW..HIGH",
        help="luminance of a white diffuser [cd/m2], as a range or a list such as 1,10,100 "
        "(default: from near darkness to where every channel saturates)",
    )
    generated: int | None = option(
        type=int,
        metavar="N",
        help="number of scenes generated from measured reflectances (default: 30; 0: only the "
        "given scenes)",
    )
    outputs: str = option(
        default="channels",
        choices=("channels", "xyz"),
        help="values that the filters estimate: the camera's red, green and blue without noise and "
        "colour error, or CIE XYZ (default: channels)",
    )
    seed: int = seed_option("the generated scenes and of the noise")
    device: str = option(default="auto", help=DEVICE_HELP)


def train_l3(request: TrainRequest) -> int:
    """Run `gpusim train-l3`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong, before any work.
    """
    from tqdm import tqdm

    from gpusim.apps.l3.train import GENERATED, train, training_camera
    from gpusim.domain.errors import OutOfRange
    from gpusim.io.atomic import check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.io.camera.learned import write_table
    from gpusim.io.scene.scenes import open_scene

    check_output(request.out)
    if not request.out.endswith(".npz"):
        raise OutOfRange("--out", request.out, "a name that ends in .npz")
    camera = open_camera(request.camera)
    training_camera(camera)
    table = train(
        camera,
        [open_scene(name, light=request.light) for name in request.scenes],
        light=request.light,
        luminances=request.luminance,
        generated=GENERATED if request.generated is None else request.generated,
        outputs=request.outputs,
        seed=request.seed,
        device=request.device,
        progress=partial(tqdm, unit="frame", disable=None),
    )
    write_table(request.out, table)
    made = table.layout
    levels, positions, classes, _, weights = made.shape[1:]
    print(
        f"{request.out}: {'/'.join(made.mosaic)} to {''.join(made.outputs)}; {levels} levels x {positions} "
        f"positions x {classes} classes of {weights} weights"
    )
    print(table.provenance)
    return 0
