"""`gpusim train-network`: weights of the demosaicking network from pictures seen by cameras."""

from dataclasses import dataclass
from functools import partial

from gpusim.cli.options import DEVICE_HELP, Options, option, reads, seed_option

TEXTS = {"help": "train the network that demosaicks and denoises any mosaic of red, green and blue"}
CAMERAS = ("phone",)


@reads("a number above 0 [min]")
def minutes(text: str) -> float:
    """Return minutes above 0. Raises ArgumentTypeError."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError
    return value


@dataclass(frozen=True, kw_only=True)
class TrainNetworkRequest(Options):
    """Options of `gpusim train-network`."""

    pictures: list[str] | tuple = option(
        positional=True,
        in_key=False,
        nargs="+",
        metavar="PICTURES",
        help="photographs, or folders of them, of 320x320 pixels or more; sharp ones teach most",
    )
    camera: list[str] | None = option(
        action="append",
        metavar="CAMERA",
        help="camera whose colours and blur are learned beside those of the pictures; may be repeated "
        "(default: phone)",
    )
    out: str = option(
        "-o",
        "--out",
        metavar="WEIGHTS.npz",
        required=True,
        help='file of the weights, for [processor] demosaic = "network", network = "WEIGHTS.npz" in '
        "the camera file",
    )
    minutes: float = option(
        type=minutes, default=10.0, metavar="MINUTES", help="time to train (default: 10)"
    )
    state: str | None = option(
        metavar="FILE.pt",
        help="go on from this file if it exists, and write the state of the training to it",
    )
    seed: int = seed_option("all random numbers")
    device: str = option(default="auto", help=DEVICE_HELP + "; PyTorch takes CUDA if there is one")


def train_network(request: TrainNetworkRequest) -> int:
    """Run `gpusim train-network`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong, before any work.
    """
    from tqdm import tqdm

    from gpusim.apps.network.layout import PIECE
    from gpusim.apps.network.pictures import find_pictures, read_tiles
    from gpusim.domain.errors import Missing, OutOfRange
    from gpusim.io.atomic import check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.io.camera.network import write_network

    try:
        from gpusim.apps.network.train import Progress, open_state, provenance, save_state, train
    except ImportError as error:
        raise Missing(f"train-network needs PyTorch ({error}); pip install torch") from error
    check_output(request.out)
    if not request.out.endswith(".npz"):
        raise OutOfRange("--out", request.out, "a name that ends in .npz")
    if request.state is not None:
        check_output(request.state)
    state = open_state(request.state)
    paths = find_pictures(request.pictures)
    names = request.camera or list(CAMERAS)
    cameras = [open_camera(name) for name in names]
    tiles, used = read_tiles(
        paths, cameras, request.device, partial(tqdm, unit="picture", disable=None)
    )
    if len(used) < len(paths):
        left = len(paths) - len(used)
        print(
            f"{left} of {len(paths)} pictures are left out: grey, or smaller than {PIECE}x{PIECE}"
        )
    with tqdm(total=None, unit="step", disable=None) as bar:

        def tell(progress: Progress):
            bar.total = progress.steps
            bar.set_postfix_str(f"error {progress.quality:.2f} dB below white")
            bar.update(progress.step - bar.n)

        model, state = train(
            tiles, seconds=60 * request.minutes, seed=request.seed, state=state, tell=tell
        )
    trained = model.export(provenance(used, names, request.seed, state["steps"]))
    write_network(request.out, trained)
    if request.state is not None:
        save_state(request.state, state)
    print(f"{request.out}: {trained.count:,} weights after {state['steps']} steps")
    print(trained.provenance)
    return 0
