"""Training of the network on colours of simulated cameras, seen through mosaics with noise."""

import datetime
import json
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gpusim import __version__
from gpusim.apps.network.layout import CROP, EDGE, TILE
from gpusim.apps.network.model import Model, first_guess, network_inputs, unpack
from gpusim.apps.network.muon import Muon
from gpusim.domain.errors import BadFile
from gpusim.domain.mosaics import mosaic
from gpusim.io.atomic import atomic_path

BATCH = 64
FLAT = 0.06  # share of parts of one colour: they teach equal levels
NATURAL = 0.5  # share of parts whose colours stay
INVERTED = 0.06  # share of channels of the others
RATE = 2.5e-3  # of learning, at first
WARM = 300  # steps in which the rate grows
HALF = 0.85  # share of the time with half-precision sums
EVERY = 20  # steps between reports
KEPT = 0.999  # share of the mean weights that a step keeps
# Mosaics and how often a step sees them
SHARES = {
    "bayer-rggb": 0.44,
    "quad-bayer": 0.25,
    "x-trans": 0.25,
    "nona-bayer": 0.06,
}
CLEAN = 0.45  # share of parts without noise
ENCODED = 0.35  # share of parts whose codes are sRGB's, not roots
ELECTRONS = 10.0, 20_000.0  # at white
READ = 4.0  # [e-] most read noise
BALANCE = 0.6, 3.2  # of red and blue


@dataclass
class Progress:
    """State of a training: step, steps in all, mean error of the last steps [dB]."""

    step: int
    steps: int
    quality: float


class Sampler:
    """Makes parts of pictures as a camera with a mosaic sees them, on a device of PyTorch.

    Args:
        tiles: Linear colours of cameras, balanced, white 1, shape (N, 3, TILE, TILE), uint16 of
            their roots.
        device: Name of PyTorch's device.
        seed: Of all random numbers.
    """

    def __init__(self, tiles: np.ndarray, device: str, seed: int = 0):
        self.tiles = torch.from_numpy(tiles.astype(np.int16)).to(device)
        self.device = device
        self.random = torch.Generator(device)
        self.random.manual_seed(seed)
        self.host = np.random.default_rng(seed)
        shifted = [_shifts(name) for name in SHARES]
        self.masks = torch.from_numpy(np.concatenate(shifted)).to(device)
        shares = np.repeat(
            [share / len(each) for share, each in zip(SHARES.values(), shifted, strict=True)],
            [len(each) for each in shifted],
        )
        self.shares = torch.from_numpy(shares).to(device)

    def _uniform(self, count, low=0.0, high=1.0):
        values = torch.rand((count, 1, 1, 1), generator=self.random, device=self.device)
        return low + (high - low) * values

    def batch(self, count: int = BATCH) -> tuple[torch.Tensor, ...]:
        """Return codes (N, 1, CROP, CROP), masks, noise, and true codes (N, 3, CROP, CROP)."""
        chosen = torch.randint(len(self.tiles), (count,), generator=self.random, device=self.device)
        top, left = self.host.integers(TILE - CROP + 1, size=2)
        part = self.tiles[chosen, :, top : top + CROP, left : left + CROP]
        root = (part.to(torch.int32) & 0xFFFF).float() / 65535
        if self.host.random() < 0.5:
            root = root.flip(3)
        if self.host.random() < 0.5:
            root = root.transpose(2, 3)
        is_natural = self._uniform(count) < NATURAL
        light = torch.where(is_natural, root, self._recolored(root)).square()
        is_flat = self._uniform(count) < FLAT
        light = torch.where(is_flat, light.mean((2, 3), keepdim=True), light)
        light = light * self._uniform(count, 0.25, 1.0)
        masks = self._masks(count)
        gains = torch.cat(
            [
                self._log(count, *BALANCE),
                torch.ones((count, 1, 1, 1), device=self.device),
                self._log(count, *BALANCE),
            ],
            1,
        )
        electrons, read = self._log(count, *ELECTRONS), self._uniform(count, 0.0, READ)
        clean = self._uniform(count) < CLEAN
        encoded = clean & (self._uniform(count) < ENCODED / CLEAN)
        gains = torch.where(clean, torch.ones_like(gains), gains)
        offset = torch.where(clean, torch.zeros_like(read), (0.375 + read**2) / electrons)
        mean = light / gains
        true = torch.sqrt(gains * (mean + offset))
        srgb = torch.where(
            light <= 0.0031308, 12.92 * light, 1.055 * light.clamp_min(1e-6) ** (1 / 2.4) - 0.055
        )
        true = torch.where(encoded, srgb, true)
        count_ = torch.poisson(mean * electrons, generator=self.random)
        normal = torch.randn(mean.shape, generator=self.random, device=self.device)
        noisy = (count_ + read * normal) / electrons + offset
        noisy = torch.sqrt(gains) * torch.sign(noisy) * torch.sqrt(noisy.abs())
        seen = torch.where(clean, true, noisy)
        codes = (masks * seen).sum(1, keepdim=True)
        sigma = torch.where(clean, torch.zeros_like(gains), 0.5 * torch.sqrt(gains / electrons))
        return codes, masks, (masks * sigma).sum(1, keepdim=True), true

    def _recolored(self, root):
        """Return pictures of other colours: photographs alone have too few strong ones.

        Channels change places and strengths, saturation grows or falls, and a few channels are inverted, as where
        surfaces of one lightness and of different colours meet.
        """
        count = len(root)
        order = torch.rand((count, 3), generator=self.random, device=self.device).argsort(1)
        order = torch.where(
            self._uniform(count)[:, :, 0, 0] < 0.5, order, torch.arange(3, device=self.device)
        )
        root = root.gather(1, order[:, :, None, None].expand_as(root))
        uniform = torch.rand((2, count, 3, 1, 1), generator=self.random, device=self.device)
        root = torch.where(uniform[0] < INVERTED, 1 - root, root)
        root = root * torch.where(self._uniform(count) < 0.5, torch.exp(uniform[1] - 1), 1.0)
        grey = root.mean(1, keepdim=True)
        return (grey + self._uniform(count, 0.5, 2.2) * (root - grey)).clamp(0, 1)

    def _log(self, count, low, high):
        return torch.exp(self._uniform(count, float(np.log(low)), float(np.log(high))))

    def _masks(self, count):
        chosen = torch.multinomial(self.shares, count, replacement=True, generator=self.random)
        return self.masks[chosen].float()


def _shifts(name):
    """Return the masks of a mosaic's colours with each shift, (shifts, 3, CROP, CROP)."""
    rows = mosaic(name)
    at = np.array([["RGB".index(letter) for letter in row] for row in rows])
    times = -(-CROP // len(at)) + 1
    whole = np.tile(at, (times, times))
    colors = np.stack([whole == color for color in range(3)])
    return np.stack(
        [colors[:, y : y + CROP, x : x + CROP] for y in range(len(at)) for x in range(len(at))]
    )


class _Update:
    """A step of the training: new weights, and their running means, from one batch.

    On CUDA its kernels are recorded once and repeated: there are hundreds of small ones.
    """

    def __init__(self, model, mean, optimisers, is_half: bool):
        self.model, self.mean, self.optimisers, self.is_half = model, mean, optimisers, is_half
        self.graph: Any = None
        self.square: Any = None

    def __call__(self, batch) -> torch.Tensor:
        """Return the mean square error of each part of the batch."""
        if batch[0].device.type == "cpu":
            return self._apply(batch)
        if self.graph is None:
            self.batch = [one.clone() for one in batch]
            stream = torch.cuda.Stream()
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                for _ in range(3):
                    self._apply(self.batch)
            torch.cuda.current_stream().wait_stream(stream)
            self.graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self.graph):
                self.square = self._apply(self.batch)
        for held, new in zip(self.batch, batch, strict=True):
            held.copy_(new)
        self.graph.replay()
        return self.square

    def _apply(self, batch):
        codes, masks, sigma, true = batch
        guess = first_guess(codes, masks)
        inputs = network_inputs(guess, masks, sigma).contiguous(memory_format=torch.channels_last)
        self.model.zero_grad(set_to_none=True)
        kind = codes.device.type
        with torch.autocast(kind, torch.bfloat16, enabled=self.is_half, cache_enabled=False):
            added = self.model(inputs)
        error = (guess + unpack(added.float()) - true)[..., EDGE:-EDGE, EDGE:-EDGE]
        square = error.square().mean((1, 2, 3))
        torch.sqrt(square + 1e-6).mean().backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        for optimiser in self.optimisers:
            optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(
                list(self.mean.parameters()), list(self.model.parameters()), 1 - KEPT
            )
        return square.detach()


def train(
    tiles: np.ndarray,
    *,
    seconds: float,
    device: str | None = None,
    seed: int = 0,
    state: dict | None = None,
    tell: Callable[[Progress], None] | None = None,
) -> tuple[Model, dict]:
    """Train for some seconds.

    The rate of learning falls along a cosine of the time. A training that goes on begins at half
    of it.

    Args:
        tiles: See `Sampler`.
        seconds: Time to train.
        device: Name of PyTorch's device; None: CUDA if there is one.
        seed: Of all random numbers.
        state: State to go on from.
        tell: Is called every hundred steps.

    Returns:
        The model of mean weights, and the state to go on from.
    """
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    is_cuda = device != "cpu"
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    torch.manual_seed(seed)
    model, mean = Model().to(device), Model().to(device)
    model, mean = (one.to(memory_format=torch.channels_last) for one in (model, mean))
    rate = torch.tensor(RATE, device=device)
    weights = [one for one in model.parameters() if one.ndim > 1]
    biases = [one for one in model.parameters() if one.ndim == 1]
    adam = torch.optim.Adam(biases, rate, (0.9, 0.99), capturable=is_cuda, fused=is_cuda)
    optimisers = [Muon(weights, rate), adam]
    done = 0
    if state is not None:
        model.load_state_dict(state["model"])
        for optimiser, stored in zip(optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(stored)
            optimiser.param_groups[0]["lr"] = rate
        done = state["steps"]
    mean.load_state_dict(model.state_dict())
    sampler = Sampler(tiles, device, seed + done)
    updates = [_Update(model, mean, optimisers, is_half) for is_half in (is_cuda, False)]
    peak = RATE if state is None else RATE / 2
    begin, step = time.monotonic(), 0
    while (passed := (time.monotonic() - begin) / seconds) < 1:
        warm = min(1.0, (step + 1) / WARM)
        rate.fill_(peak * (0.5 + 0.5 * float(np.cos(np.pi * passed))) * warm + 1e-6)
        square = updates[int(passed > HALF)](sampler.batch())
        step += 1
        if tell and step % EVERY == 0:  # waits for the device
            quality = -10 * float(torch.log10(square).mean())
            tell(Progress(done + step, done + int(step / max(passed, 1e-9)), quality))
    stored = [optimiser.state_dict() for optimiser in optimisers]
    return mean, {"model": mean.state_dict(), "optimisers": stored, "steps": done + step}


def provenance(paths: Sequence[Path], cameras: Sequence[str], seed: int, steps: int) -> str:
    """Return how weights were made, as JSON."""
    record = {
        "program": f"gpusim {__version__}, gpusim train-network",
        "date": f"{datetime.date.today()}",
        "pictures": [path.name for path in paths],
        "cameras": list(cameras),
        "mosaics": SHARES,
        "electrons of white": ELECTRONS,
        "most read noise [e-]": READ,
        "share without noise": CLEAN,
        "steps": steps,
        "parts of a step": BATCH,
        "seed": seed,
    }
    return json.dumps(record)


def open_state(path: str | None) -> dict | None:
    """Return the state of a training, or None if there is no file yet. Raises BadFile."""
    if path is None or not Path(path).exists():
        return None
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        Model().load_state_dict(state["model"])
        return {key: state[key] for key in ("model", "optimisers", "steps")}
    except (OSError, RuntimeError, KeyError, EOFError, TypeError, pickle.UnpicklingError) as error:
        cause = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BadFile(path, f"no state of a training ({cause}); give another name") from None


def save_state(path: str, state: dict) -> None:
    """Write the state of a training."""
    with atomic_path(path) as temporary:
        torch.save(state, temporary)
