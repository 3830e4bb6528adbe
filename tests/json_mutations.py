"""Damaged JSON: links and fields of the preview, manifests of videos and pairs, figures of EMVA data sheets."""

import copy
import json
from contextlib import suppress
from dataclasses import replace

from mutations import pick

from gpusim.apps.preview.control import BEYOND, BEYOND_LOG, parse
from gpusim.apps.preview.controls import CONTROLS, LIGHTS, TOLERANCES, VIEWS
from gpusim.apps.preview.recipes import command_line
from gpusim.apps.preview.scene_choice import SceneChoice
from gpusim.apps.preview.state import State
from gpusim.domain.errors import BadData

STATES = [
    State("phone", scene=SceneChoice("flat", size=(48, 32), options={"border": "edge"})),
    State("mono", {"optics.f_number": 2.0, "sensor.bits": 12}, "D65", 100.0, "1e-2", "raw"),
    State(
        "machine-vision",
        {"processor.tone": "contrast", "optics.zernike_waves.7": 0.2},
        seed=3,
        frame=7,
        snapshots={"B": {"camera": "phone", "changes": {"noise.read_e": 3.0}}},
        against="B",
        split=0.25,
    ),
    State(
        "phone",
        light="lamp.csv",
        scene=SceneChoice("a.npz", {"a.npz": "0" * 64}, (64, 48), {"border": "edge"}),
        files={"lamp.csv": "1" * 64},
    ),
]
VIDEO = {
    "gpusim": "0.1",
    "camera": "abc",
    "scenes": ["a.png", "b.png"],
    "frames": 3,
    "loops": {"seconds": [0.01, 0.02, 0.03], "white": [[1.0, 0.5, 0.7]] * 3, "focus": None},
}
MANIFEST = VIDEO | {"plans": {"plan a": [[0, 1]], "plan b": [[2, 2]]}}
SHEET = {
    "pixel_pitch": 3.45e-6,
    "quantum_efficiency": 0.6,
    "wavelength": 525.0,
    "gain": 0.4,
    "bits": 12,
    "saturation_capacity": 8000.0,
    "dark_noise": 5.0,
}
SHEETS = [
    SHEET,
    SHEET
    | {
        "dark_noise": None,
        "dark_noise_dn": 2.1,
        "prnu": 0.8,
        "prnu_row": 0.3,
        "dsnu": 2.0,
        "dsnu_column": 1.0,
        "channels": ["R"],
        "cfa": ["R"],
        "black_level": 64,
    },
    SHEET | {"snr_max_db": 39.03, "dark_current": 3.0, "dark_current_doubling": 7.0, "seed": 3},
]
SLOW = {name for name in CONTROLS if name.startswith(("optics.defocus", "optics.zernike"))}
VALUES = (
    None,
    True,
    False,
    0,
    1,
    -1,
    2,
    3,
    7,
    0.5,
    -0.5,
    1e-300,
    1e300,
    10**40,
    10**400,
    float("nan"),
    float("inf"),
    -float("inf"),
    "",
    "x",
    "phone",
    "raw",
    "x" * 3000,
    "../a.toml",
    "/dev/zero",
    "\0",
    "\ud800",
    "é",
    [],
    [[]],
    {},
    [1, 2, 3],
    [1.0, "x"],
    [[0, 1]],
    [[0, 10**30]],
    [[1, 0]],
    {"a": 1},
    {"camera": "phone"},
    [0.0] * 999,
)
TEXTS = (
    "[" * 50_000,
    "[" * 900 + "]" * 900,
    '{"a":' * 900 + "1" + "}" * 900,
    "9" * 4200,
    "9" * 5000,
    "1e999",
    "-0",
    '"\\ud800"',
    "'x'",
    "",
    "{",
    "NaN",
)


def good(reader):
    """Texts that a reader takes."""
    return [
        text.encode()
        for text in {
            "link": [state.link() for state in STATES],
            "fields": [_quick(state).link() for state in STATES if not state.files],
            "manifest": [json.dumps(MANIFEST, indent=2) + "\n", json.dumps(VIDEO)],
            "sheet": [json.dumps(sheet) for sheet in SHEETS],
        }[reader]
    ]


def changed(text: bytes, random) -> bytes:
    """JSON in which values at any depth are others, are missing, or have other names."""
    whole = json.loads(text)
    for _ in range(int(random.integers(1, 4))):
        place = whole
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                break
            key = pick(random, keys)
            if isinstance(place[key], dict | list) and place[key] and random.random() < 0.7:
                place = place[key]
                continue
            _change(place, key, random)
            break
    text = json.dumps(whole)
    if random.random() < 0.15:
        text = text.replace(json.dumps(pick(random, _leaves(whole))), pick(random, TEXTS), 1)
    return text.encode("utf-8", "surrogatepass")


def manifest(text: bytes, random) -> bytes:
    """A manifest of another video, or of the same with other names of plans."""
    whole = json.loads(text)
    if "plans" not in whole or random.random() < 0.4:
        return changed(text, random)
    plans = json.dumps(
        {"plans": whole.pop("plans") if random.random() < 0.8 else pick(random, VALUES)}
    )
    return json.dumps(whole).encode()[:-1] + b", " + changed(plans.encode(), random)[1:]


def _change(place, key, random):
    """Change one entry of an object or a list."""
    kind = int(random.integers(6))
    if kind == 0:
        del place[key]
    elif kind == 1 and isinstance(place, dict):
        place[
            pick(
                random,
                (
                    "x",
                    "",
                    "camera",
                    "changes",
                    "view",
                    "optics.f_number",
                    "plans",
                    "gain",
                    "y" * 999,
                ),
            )
        ] = place.pop(key)
    elif kind == 2 and isinstance(place, list):
        place += place * int(random.integers(1, 9))
    elif kind == 3 and type(place[key]) in (int, float):
        with suppress(OverflowError):
            place[key] = place[key] * float(10 ** random.uniform(-12, 12))
    else:
        place[key] = copy.deepcopy(pick(random, VALUES))


def _leaves(value):
    found = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [leaf for one in found for leaf in _leaves(one)] or [value]


def fields(text: bytes, random) -> bytes:
    """Settings that someone moved and typed: within sliders, at their ends, and beyond them.

    Aberrations stay as they are: tables of other pupils take up to 30 s, in the preview and everywhere.
    """
    state = State.of_link(text.decode(), "phone")
    changes = dict(state.changes)
    for _ in range(int(random.integers(1, 7))):
        control = CONTROLS[pick(random, [name for name in CONTROLS if name not in SLOW])]
        low, high = (
            (control.low / BEYOND_LOG, control.high * BEYOND_LOG)
            if control.is_log
            else (min(control.low, 0) * BEYOND, control.high * BEYOND)
        )
        part = pick(random, (0.0, 1.0, random.random(), random.random()))
        value = low * (high / low) ** part if control.is_log else low + (high - low) * part
        texts = [parse(word) for word in control.suggested] if control.is_text else []
        values = (
            [*control.choices]
            or texts
            or [float(value)] * 6
            + [
                control.low,
                control.high,
                value * 1e3,
                -1.0,
                0.0,
            ]
        )
        changes[control.name] = (
            control.off
            if control.off is not None and random.random() < 0.1
            else pick(random, values)
        )
    return (
        replace(
            state,
            changes=changes,
            light=pick(random, (None, *LIGHTS)),
            view=pick(random, VIEWS),
            luminance=pick(random, (None, float(10 ** random.uniform(-6, 6)))),
            seed=int(random.integers(2**32)),
            tolerance=pick(random, TOLERANCES),
        )
        .link()
        .encode()
    )


def _quick(state):
    return replace(
        state, changes={name: value for name, value in state.changes.items() if name not in SLOW}
    )


def read_link(path):
    """What the page does with an address, but for its pictures."""
    state = State.of_link(path.read_text("utf-8", "replace"), "phone")
    for one in (state, *state.others):
        one.build()
        one.toml()
    return State.of_link(state.link(), "phone"), command_line(state, 7)


def read_fields(path):
    """A small picture of the settings."""
    from gpusim.apps.preview.producer import Producer
    from gpusim.apps.video.scenes import Still
    from gpusim.backends import open_device
    from gpusim.data.charts import chart

    state = State.of_link(path.read_text("utf-8", "replace"), "phone")
    return Producer(Still(chart("deadleaves", size=(48, 32)), 1), open_device("numpy")).picture(
        state, 0
    )


def read_manifest(path):
    """What a run that goes on with a video reads and writes."""
    from gpusim.apps.video.loops import Lags, Loops
    from gpusim.apps.video.manifest import Plans, keep_manifest

    Loops.read_manifest(path, Lags(exposure=1.0, white=1.0), 3)
    with keep_manifest(path, VIDEO, "the rest", lambda: False), Plans(path) as plans:
        plans.add("plan c", 3, True)


def read_sheet(path):
    """A sensor of the figures."""
    from gpusim import sensor_from_emva1288

    try:
        figures = json.loads(path.read_text("utf-8", "surrogatepass"))
    except (ValueError, RecursionError):
        raise BadData("not JSON, which is this test's") from None
    try:
        return sensor_from_emva1288(**figures)
    except TypeError as error:
        if "sensor_from_emva1288() " in str(
            error
        ):  # an argument that is missing or unknown, as Python has it
            raise BadData("not the function's arguments") from None
        raise
