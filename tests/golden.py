"""Digests of what gpusim makes of some sixty questions, to see that a change of the code changes no bit of a frame.

`python tests/golden.py --out FILE` stores the digests of the gpusim that is imported. `python tests/golden.py --against
REF` makes those of another commit on the same machine, and of this one, and lists what differs. Bits of floats depend
on the processor and the driver, so that digests are only compared within one run or on one machine.
"""

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
DEVICES = ("opencl", "warp", "numpy")
SIZE = (72, 48)  # width, height [sample]
CAMERAS = {  # name: base camera and settings
    "phone": ("phone", {}),
    "phone, coma": ("phone", {"seidel_waves": (0.0, 0.4, 0.0, 0.0, 0.0)}),
    "phone, defocus": ("phone", {"defocus_um": 9.0}),
    "phone, patterns": (
        "phone",
        {
            "prnu": 0.01,
            "dsnu_e": 1.0,
            "hot_pixels": 1e-3,
            "hot_current_e_per_s": 500.0,
            "telegraph_pixels": 0.01,
            "telegraph_e": 5.0,
            "defects": "known",
        },
    ),
    "phone, best": ("phone", {"demosaic": "best", "denoise": 0.5}),
    "phone, binned": ("phone", {"binning": (2, 2)}),
    "figure8": ("figure8", {}),
    "machine-vision": ("machine-vision", {}),
    "machine-vision, small aperture": ("machine-vision", {"f_number": 16.0}),
    "mono": ("mono", {}),
    "mono, exact noise": ("mono", {"photon": "exact", "read_e": 3.0}),
}
SCENES = {
    "deadleaves": {"seed": 3},
    "colorchecker": {},
    "slanted-edge": {},
    "points": {},
}
TIMES = re.compile(r"\b[0-9.]+ ?ms\b|\b[0-9.]+ s\b")


def questions():
    """Yield (name, camera, settings, scene, settings, tolerance): every camera, every scene, every tolerance.

    A lens that varies over the field has no tolerance: its plans take a minute.
    """
    tolerances = (None, "video", 1e-4)
    for number, (camera, (base, changes)) in enumerate(CAMERAS.items()):
        for more in (0, 1):
            scene = list(SCENES)[(number + 2 * more) % len(SCENES)]
            tolerance = (
                None if "seidel_waves" in changes else tolerances[(number + more) % len(tolerances)]
            )
            yield (
                f"{camera} | {scene} | {tolerance}",
                base,
                changes,
                scene,
                SCENES[scene],
                tolerance,
            )


def digest_frame(device, base, changes, name, settings, tolerance, seed=1) -> dict[str, str]:
    """Digests of the mean electrons, raw values, codes, predicted errors and report of one frame."""
    import gpusim as gs

    scene = gs.chart(name, size=SIZE, **settings)
    simulate = gs.Simulator(
        gs.open_camera(base).with_(**changes), device=device, tolerance=tolerance
    )
    frame = simulate(scene, seed=seed)
    table = getattr(frame.report, "table", frame.report.__str__)()  # str: of commits without table
    report = "\n".join(re.sub(r" +", " ", TIMES.sub("", line)) for line in table.splitlines())
    account = json.dumps(simulate.plan(scene).account.as_dict(), sort_keys=True)
    arrays = {
        key: np.ascontiguousarray(getattr(frame, key))
        for key in ("mean", "raw", "rgb")
        if getattr(frame, key) is not None
    }
    found = {key: hashlib.sha256(value.tobytes()).hexdigest()[:16] for key, value in arrays.items()}
    texts = {"account": account, "report": report}
    return found | {
        key: hashlib.sha256(text.encode()).hexdigest()[:16] for key, text in texts.items()
    }


def digest_all(devices=DEVICES) -> dict[str, dict[str, str]]:
    """Digests of every question on every device."""
    return {
        f"{device} | {name}": digest_frame(device, *question)
        for device in devices
        for name, *question in questions()
    }


def differences(before, after) -> list[str]:
    """What differs, one line each."""
    return [
        f"{name}: {key}"
        for name in sorted(before | after)
        for key in sorted(before.get(name, {}) | after.get(name, {}))
        if before.get(name, {}).get(key) != after.get(name, {}).get(key)
    ]


def digests_of(commit: str) -> dict[str, dict[str, str]]:
    """Digests that another commit makes on this machine."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder, "tree")
        subprocess.run(
            ["git", "worktree", "add", "--detach", "-q", tree, commit], cwd=ROOT, check=True
        )
        try:
            return digests_in(tree, Path(folder, "digests.json"))
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=ROOT, check=True)


def digests_in(tree, out) -> dict[str, dict[str, str]]:
    """Digests that the gpusim in a folder makes, by a process of its own."""
    subprocess.run(
        [sys.executable, __file__, "--out", out],
        check=True,
        env=os.environ | {"PYTHONPATH": str(tree)},
    )
    return json.loads(Path(out).read_text())


def main():
    """Make digests, store them or compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="file for the digests")
    parser.add_argument("--against", metavar="REF", help="commit to compare with")
    arguments = parser.parse_args()
    if arguments.out:
        arguments.out.write_text(json.dumps(digest_all(), indent=1))
    if arguments.against:
        with tempfile.TemporaryDirectory() as folder:
            own = digests_in(ROOT, Path(folder, "own.json"))
        changed = differences(digests_of(arguments.against), own)
        print("\n".join(changed) or f"all {sum(map(len, own.values()))} digests are equal")
        sys.exit(bool(changed))


if __name__ == "__main__":
    main()
