"""Pairs of raw frames of random, static, structured scenes, in plain NumPy; shares no code with gpusim."""

import numpy as np
from raw_cameras import _write, draw_maps, expose

PAIR_LEVELS = (0.05, 0.2, 0.6)  # of saturation, of the brightest part of the scene
PAIRS = 2


def draw_scene(seed, shape):
    """Relative light of a random scene: overlapping rectangles, a gradient, smooth and fine texture."""
    rng = np.random.default_rng([seed, 45])
    rows, cols = shape
    y, x = np.mgrid[:rows, :cols].astype(float)
    light = np.exp(rng.uniform(-3, 0)) * (1 + 0.4 * np.cos((x + 2 * y) / rng.uniform(20, 80)))
    for _ in range(int(rng.integers(6, 30))):
        height, width = rng.integers(6, max(rows // 2, 8)), rng.integers(6, max(cols // 2, 8))
        top, left = rng.integers(0, rows - 5), rng.integers(0, cols - 5)
        patch = light[top : top + height, left : left + width]
        patch[:] = np.exp(rng.uniform(-3.5, 0))
        if rng.random() < 0.5:
            patch *= 1 + rng.uniform(0, 0.5) * np.sin(
                x[: patch.shape[0], : patch.shape[1]] * rng.uniform(0.1, 2)
            )
    light *= 1 + rng.uniform(0, 0.15) * rng.standard_normal(shape)  # leaves, sand
    light = np.clip(light, 0.005, None)
    return light / light.max()


def shoot_pairs(camera, folder, light=None, levels=PAIR_LEVELS, states_black=True, change=None):
    """Write pairs of a static scene at a few exposure times as .npz.

    change: function (maps, rng) -> maps of the second frame of each pair.
    """
    rng = np.random.default_rng([camera.seed, 46])
    maps = draw_maps(camera)
    light = draw_scene(camera.seed, camera.shape) if light is None else light
    maps = maps | {"light": maps["light"] * light}
    folder.mkdir(parents=True, exist_ok=True)
    for iso in camera.gains:
        full, _ = camera.saturation(iso)
        for level in levels:
            for number in range(PAIRS):
                now = change(maps, rng) if change and number else maps
                seconds = round(0.05 * level, 6)
                frame = expose(camera, now, iso, seconds, full * level, rng)
                path = folder / f"pair_{iso}_{level}_{number}.npz"
                more = {"black_level": camera.black, "white_level": camera.white}
                _write(camera, path, frame, iso, seconds, **(more if states_black else {}))
