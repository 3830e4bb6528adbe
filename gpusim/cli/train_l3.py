"""`gpusim train-l3`: filters for a camera from simulated frames."""

import argparse


def add_command(commands, device_help: str):
    """Add `train-l3` to the subparsers of `gpusim`; its default `run` is `train_l3`."""
    parser = commands.add_parser(
        "train-l3",
        help="learn a camera's filters for demosaicking, noise, blur and colour "
        "from simulated frames",
    )
    parser.add_argument(
        "scenes",
        nargs="*",
        metavar="SCENE",
        help="more to train on than the generated scenes: "
        "photographs, spectral files with their light, charts",
    )
    parser.add_argument(
        "--camera", required=True, help="as for simulate; any mosaic of three channels or more"
    )
    parser.add_argument(
        "-o",
        "--out",
        required=True,
        metavar="TABLE.npz",
        help="the filters, for [processor] "
        'demosaic = "learned", table = "TABLE.npz" in the camera file',
    )
    parser.add_argument(
        "--light", default="D65", help="in which the camera sees the scenes (default: D65)"
    )
    parser.add_argument(
        "--luminance",
        type=luminances,
        metavar="LOW..HIGH",
        help="of white [cd/m2], as a range or a "
        "list such as 1,10,100 (default: from near darkness to where every channel saturates)",
    )
    parser.add_argument(
        "--generated",
        type=int,
        metavar="N",
        help="scenes that are made of measured reflectances (default: 30; 0: the given ones alone)",
    )
    parser.add_argument(
        "--outputs",
        choices=("channels", "xyz"),
        default="channels",
        help="what the filters give: "
        "the camera's red, green and blue without noise and colour error, or CIE XYZ (default: "
        "channels)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of generated scenes and noise (default: 0)"
    )
    parser.add_argument("--device", default="auto", help=device_help)
    parser.set_defaults(run=train_l3)


def luminances(text: str) -> tuple[float, ...]:
    """Read "LOW..HIGH" or "A,B,C" [cd m-2]; a single one stays single."""
    try:
        low, dots, high = text.partition("..")
        return (float(low), float(high)) if dots else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: wanted LOW..HIGH or a list such as 1,10,100 [cd/m2]"
        ) from None


def train_l3(arguments) -> int:
    """Run `gpusim train-l3`; returns the exit status. Raises GpusimError before any work for wrong input."""
    from tqdm import tqdm

    from gpusim.apps.l3.train import GENERATED, train, training_camera
    from gpusim.domain.errors import OutOfRange
    from gpusim.io.atomic import check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.io.camera.learned import write_table
    from gpusim.io.scene.scenes import open_scene

    check_output(arguments.out)
    if not str(arguments.out).endswith(".npz"):
        raise OutOfRange("--out", arguments.out, "a name that ends in .npz")
    if arguments.seed < 0:
        raise OutOfRange("--seed", arguments.seed, "0 or more")
    camera = open_camera(arguments.camera)
    training_camera(camera)
    scenes = [open_scene(name, light=arguments.light) for name in arguments.scenes]
    generated = GENERATED if arguments.generated is None else arguments.generated
    table = train(
        camera,
        scenes,
        light=arguments.light,
        luminances=arguments.luminance,
        generated=generated,
        outputs=arguments.outputs,
        seed=arguments.seed,
        device=arguments.device,
        progress=lambda frames: tqdm(frames, unit="frame", disable=None),
    )
    write_table(arguments.out, table)
    made = table.layout
    levels, positions, classes, _, weights = made.shape[1:]
    print(
        f"{arguments.out}: {'/'.join(made.mosaic)} to {''.join(made.outputs)}; {levels} levels x {positions} "
        f"positions x {classes} classes of {weights} weights"
    )
    print(table.provenance)
    return 0
