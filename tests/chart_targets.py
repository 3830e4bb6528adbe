"""ColorCheckers as random cameras see them, in plain NumPy: shares no code with gpusim's fit."""

import numpy as np
from scipy.special import erf

WAVES = np.arange(390.0, 721.0, 5.0)


def random_camera(rng, letters="RGB"):
    """Quantum efficiencies of channels at WAVES behind an infrared cut, (C, L).

    R, G and B are skewed bells with crosstalk. Others are a bare detector (W, and Y by itself), or one behind a filter
    that takes away blue (Y), red (C) or green (M).
    """
    curves = []
    for middle, width in ((600, 32), (535, 38), (460, 30)):
        centre, left = middle + rng.normal(0, 7), width * rng.uniform(0.85, 1.25)
        right = width * rng.uniform(0.85, 1.3)
        sides = np.where(WAVES < centre, left, right)
        power = rng.uniform(1.8, 2.6)
        curves.append(
            rng.uniform(0.45, 0.7) * np.exp(-0.5 * np.abs((WAVES - centre) / sides) ** power)
        )
    curves = np.array(curves)
    mixing = np.eye(3) + rng.uniform(0, 0.08, (3, 3))
    edge = rng.uniform(655, 690)
    cut = 1 / (1 + np.exp((WAVES - edge) / rng.uniform(5, 9)))
    low = 1 / (1 + np.exp((rng.uniform(400, 415) - WAVES) / 5))
    seen = dict(zip("RGB", (mixing @ curves + 0.01) * cut * low, strict=True))
    if set(letters) <= set("RGB"):
        return np.array([seen[letter] for letter in letters])
    detector = rng.uniform(0.6, 0.8) * np.exp(
        -0.5 * np.abs((WAVES - rng.normal(560, 15)) / rng.uniform(120, 160)) ** rng.uniform(2, 3)
    )
    detector *= cut * low
    for letter in sorted(set(letters) - set("RGB")):
        seen[letter] = detector * (1 if letter == "W" or letters == "Y" else dye(rng, letter))
    return np.array([seen[letter] for letter in letters])


def dichroic_camera(rng, letters="RGB"):
    """Quantum efficiencies as `random_camera`'s, of another kind: silicon behind stacks with steep edges and leaks."""
    places = [390, 430, 480, 540, 600, 660, 720]  # [nm]
    silicon = np.array([0.35, 0.55, 0.68, 0.72, 0.68, 0.6, 0.5]) * rng.uniform(0.95, 1.05, 7)
    silicon = np.interp(WAVES, places, silicon)
    silicon *= step(rng.uniform(395, 420), rng.uniform(3, 9))
    silicon *= 1 - step(rng.uniform(640, 690), rng.uniform(4, 25))
    red = step(rng.normal(590, 7), rng.uniform(8, 16))
    blue = 1 - step(rng.normal(500, 8), rng.uniform(12, 28))
    green = step(rng.normal(492, 8), rng.uniform(12, 25)) * (
        1 - step(rng.normal(583, 8), rng.uniform(14, 28))
    )
    yellow = step(rng.normal(500, 8), rng.uniform(12, 25))
    cyan = 1 - step(rng.normal(588, 8), rng.uniform(12, 25))
    bands = dict(zip("RGBYCM", (red, green, blue, yellow, cyan, 1 - 0.95 * green), strict=True))
    bands |= {"W": np.ones(len(WAVES))} | ({"Y": 1.0} if letters == "Y" else {})
    leaks = {letter: rng.uniform(0.01, 0.07) for letter in bands}
    return np.array([silicon * (leaks[one] + 0.9 * bands[one]) for one in letters])


def step(middle, width):
    """Transmission at WAVES that rises from 0 to 1 at a wavelength [nm]."""
    return 0.5 * (1 + erf((WAVES - middle) / width / 1.4))


def dye(rng, letter):
    """Transmission of a yellow, cyan or magenta filter at WAVES."""
    middle = {"Y": 505, "C": 585, "M": 540}[letter] + rng.normal(0, 7)
    side, other = rng.uniform(12, 24, 2)
    if letter == "M":
        width, depth = rng.uniform(28, 40), rng.uniform(0.7, 0.9)
        lost = np.where(WAVES < middle, width, width * other / side)
        lost = depth * np.exp(-0.5 * np.abs((WAVES - middle) / lost) ** 2.4)
    else:
        at = (WAVES - middle) * (1 if letter == "C" else -1)
        lost = rng.uniform(0.85, 0.95) * 0.5 * (1 + erf(at / np.where(at < 0, side, other) / 1.4))
    return rng.uniform(0.85, 0.97) * (1 - lost) * (1 + rng.normal(0, 0.03) * (WAVES - 550) / 150)


def photons(name):
    """Relative photons of a light at WAVES: a blackbody "3200K", or daylight by a table "D65"."""
    if name.endswith("K"):
        t = float(name[:-1])
        metres = WAVES * 1e-9
        energy = metres**-5 / np.expm1(6.62607015e-34 * 299792458 / (metres * 1.380649e-23 * t))
    else:
        import colour

        table = colour.SDS_ILLUMINANTS[name]
        energy = np.interp(WAVES, table.wavelengths, table.values)
    made = energy * WAVES
    return made / made.mean()


def checker():
    """Reflectances of the 24 patches at WAVES from colour-science, (24, L)."""
    import colour

    sets = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    return np.array([np.interp(WAVES, one.wavelengths, one.values) for one in sets.values()])


def responses(camera, light, surfaces):
    """Electrons of surfaces, (N, C): 1 for white in the strongest channel."""
    weights = camera * photons(light)
    return surfaces @ weights.T / weights.sum(1).max()


def draw(
    patch, shape, cfa, rng, turn=0.1, fill=0.7, electrons=8000, black=64, scale=0.25, order="RGBY"
):
    """A mosaic of a turned chart in perspective on grey, [DN].

    patch: responses (24, C) of channels in an order. cfa: rows of letters.
    """
    rows, cols = shape
    y, x = np.indices(shape)
    u, v = (x - cols / 2) / (fill * cols / 2), (y - rows / 2) / (fill * cols / 2)
    cos, sin = np.cos(turn), np.sin(turn)
    u, v = u * cos + v * sin, v * cos - u * sin
    w = 1 + 0.06 * u + 0.04 * v
    # columns and rows of patches; the black frame is 0.3 wide, gaps 1 / 8
    u, v = u / w * 3.3 + 2.5, v / w * 3.3 + 1.5
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    on_patch = (np.abs(u - column) < 0.44) & (np.abs(v - row) < 0.44)
    on_patch &= (column >= 0) & (column < 6) & (row >= 0) & (row < 4)
    on_chart = (u > -0.7) & (u < 5.7) & (v > -0.7) & (v < 3.7)
    number = np.where(on_patch, row * 6 + column, np.where(on_chart, 24, 25))
    table = np.vstack([patch, 0.5 * patch[23], 0.9 * patch[21]])
    letters = np.array([[order.index(c) for c in line] for line in cfa])
    which = np.tile(letters, (rows // len(cfa) + 1, cols // len(cfa[0]) + 1))[:rows, :cols]
    seen = rng.poisson(electrons * table[number, which]) + rng.normal(0, 3, shape)
    return np.rint(seen * scale + black)
