"""Small data bases of made-up cameras and lenses in the formats of the public ones."""

import json
import struct
from pathlib import Path

import numpy as np

LENSFUN = """<lensdatabase version="1">
<mount><name>Acme M</name><compat>Other M</compat></mount>
<camera><maker>Acme Corporation</maker><maker lang="en">Acme</maker><model>Acme Z1</model>
  <model lang="en">Alpha One</model><mount>Acme M</mount><cropfactor>1.5</cropfactor></camera>
<camera><maker>Acme</maker><model>Z10</model><mount>Acme M</mount><cropfactor>1</cropfactor></camera>
<camera><maker>Acme</maker><model>Compact 5</model><mount>acmeC5</mount><cropfactor>5</cropfactor>
  <aspect-ratio>4:3</aspect-ratio></camera>
<lens><maker>Acme</maker><model>Acme Zoom 20-60mm f/2.8</model><mount>Acme M</mount>
  <focal min="20" max="60"/><aperture min="2.8" max="22"/><cropfactor>1.5</cropfactor>
  <calibration>
    <distortion model="ptlens" focal="20" a="0.01" b="-0.03" c="0.01"/>
    <distortion model="ptlens" focal="30" a="0.004" b="-0.01" c="0.005"/>
    <distortion model="ptlens" focal="60" a="0.0" b="0.01" c="0.0"/>
    <tca model="poly3" focal="20" vr="1.0004" vb="0.9995" br="0.0001"/>
    <tca model="poly3" focal="60" vr="1.0001" vb="0.9999"/>
    <vignetting model="pa" focal="20" aperture="2.8" distance="1000" k1="-0.5" k2="0.1" k3="-0.05"/>
    <vignetting model="pa" focal="60" aperture="2.8" distance="1000" k1="-0.3" k2="0.0" k3="0.0"/>
    <vignetting model="pa" focal="20" aperture="8" distance="1000" k1="-0.1" k2="0.0" k3="0.0"/>
  </calibration></lens>
<lens><maker>Other</maker><model>Other Prime 40mm f/2</model><mount>Other M</mount>
  <cropfactor>1</cropfactor><calibration>
    <distortion model="poly3" focal="40" k1="-0.02"/><tca model="linear" focal="40" kr="1.0002" kb="0.9998"/>
  </calibration></lens>
<lens><maker>Acme</maker><model>Fish 8mm</model><mount>Acme M</mount><type>fisheye</type>
  <focal value="10"/><cropfactor>1.5</cropfactor><calibration/></lens>
<lens><maker>Acme</maker><model>Compact 5</model><mount>acmeC5</mount><focal min="6" max="6"/>
  <cropfactor>5</cropfactor><aspect-ratio>4:3</aspect-ratio><calibration>
    <distortion model="poly5" focal="6" k1="-0.01" k2="0.002"/></calibration></lens>
</lensdatabase>
"""
NOISE = {
    "version": 0,
    "noiseprofiles": [
        {
            "maker": "Acme",
            "models": [
                {
                    "comment": "made up",
                    "model": "Z1",
                    "profiles": [
                        {"iso": 50, "a": [1e-5] * 3, "b": [0.0] * 3, "skip": True},
                        {"iso": 100, "a": [2e-5, 1e-5, 1.5e-5], "b": [2e-8, 1e-8, 1e-8]},
                        {"iso": 400, "a": [8e-5, 4e-5, 6e-5], "b": [8e-8, -1e-8, 4e-8]},
                    ],
                }
            ],
        }
    ],
}
CAMCONST = """/* made up */
{"camera_constants": [
    { // quality A
        "make_model": [ "Acme Z1", "Acme Z1 Kit" ],
        "dcraw_matrix": [ 9020,-2890,-715,-4535,12436,2348,-934,1918,7086 ], // D65
        "raw_crop": [ 0, 0, 600, 400 ],
        "ranges": { "black": 66047, "white": [ { "iso": [ 100, 200 ], "levels": [ 16000, 15800, 16000 ] },
            { "iso": 400, "levels": 15000 }, ] }
    },
]}
"""
MATRICES = {
    17: np.array([[1.0, -0.42, 0.0], [-0.48, 1.25, 0.26], [-0.06, 0.14, 0.85]]),
    21: np.array([[0.9, -0.29, -0.07], [-0.45, 1.24, 0.23], [-0.09, 0.19, 0.71]]),
}
TUNING = {
    "version": 2.0,
    "target": "bcm2835",
    "algorithms": [
        {"rpi.black_level": {"black_level": 4096}},
        {"rpi.noise": {"reference_constant": 0, "reference_slope": 2.8}},
        {"rpi.awb": {"ct_curve": [2500.0, 0.6, 0.3, 6500.0, 0.31, 0.71]}},
        {"rpi.alsc": {"luminance_lut": np.linspace(1.0, 2.0, 192).tolist()}},
        {
            "rpi.ccm": {
                "ccms": [
                    {"ct": 2500, "ccm": [1.8, -0.5, -0.3, -0.4, 1.7, -0.3, 0.0, -1.0, 2.0]},
                    {"ct": 6000, "ccm": [2.0, -0.8, -0.2, -0.3, 1.7, -0.4, -0.1, -0.5, 1.6]},
                ]
            }
        },
    ],
}


def profile_bytes(model="Acme Z1", order="<"):
    """Return a DNG camera profile with two matrices."""
    tags, data = [], b""
    start = 8 + 2 + 5 * 12 + 4

    def add(tag, kind, count, value):
        nonlocal data
        if len(value) <= 4:
            tags.append(struct.pack(f"{order}HHI", tag, kind, count) + value.ljust(4, b"\0"))
            return
        tags.append(struct.pack(f"{order}HHII", tag, kind, count, start + len(data)))
        data += value

    name = model.encode() + b"\0"
    add(50708, 2, len(name), name)
    for tag, matrix in zip((50721, 50722), MATRICES.values(), strict=True):
        pairs = [part for value in matrix.ravel() for part in (round(value * 10000), 10000)]
        add(tag, 10, 9, struct.pack(f"{order}18i", *pairs))
    for tag, light in zip((50778, 50779), MATRICES, strict=True):
        add(tag, 3, 1, struct.pack(f"{order}H", light))
    head = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HI", 0x4352, 8)
    return head + struct.pack(f"{order}H", len(tags)) + b"".join(tags) + bytes(4) + data


def write_databases(folder):
    """Write all data bases below a folder and return it."""
    folder = Path(folder)
    for name in ("lensfun", "darktable", "rawtherapee/dcpprofiles", "libcamera"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "lensfun/acme.xml").write_text(LENSFUN)
    (folder / "darktable/noiseprofiles.json").write_text(json.dumps(NOISE))
    (folder / "rawtherapee/camconst.json").write_text(CAMCONST)
    (folder / "rawtherapee/dcpprofiles/Acme Z1.dcp").write_bytes(profile_bytes())
    for name in ("imx477", "imx296_mono"):
        (folder / f"libcamera/{name}.json").write_text(json.dumps(TUNING))
    return folder
