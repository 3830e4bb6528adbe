"""Good calibrations of many programs, for mutations."""

import json

PLACE = {"w": 640, "h": 480, "fl_x": 500.0, "fl_y": 501.0, "cx": 320.0, "cy": 240.0, "frames": [{}]}
KB4 = {
    "camera_type": "kb4",
    "intrinsics": {"fx": 380.0, "fy": 380.0, "cx": 320.0, "cy": 240.0, "k1": 0.01, "k2": 0.001},
}
T265 = {"width": 848, "height": 800, "ppx": 420.0, "ppy": 400.0, "fx": 285.0, "fy": 285.0}
T265 |= {"model": "Kannala Brandt4", "coeffs": [0.0, 0.04, -0.04, 0.007, 0]}
BODY = "image_width: 640\nimage_height: 480\ncamera_name: cam\n"
MATRIX = (
    "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [500.1, {}, 320.5, 0, 501, 240.5, 0, 0, 1]\n"
)
TEXTS = (
    BODY
    + MATRIX.format(-0.9)
    + "distortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
    "  data: [-0.02, 0.005, 0.001, 1e-05, 0.0]\nrectification_matrix: {rows: 1, data: [1]}\n",
    "model_type: KANNALA_BRANDT\n"
    + BODY
    + "projection_parameters:\n   k2: 0.01\n   k3: 0.002\n   k4: 0.001\n   k5: 0.0001\n   mu: 400.0\n"
    "   mv: 401.0\n   u0: 320.0\n   v0: 240.0\n",
    "model_type: PINHOLE\n"
    + BODY
    + "distortion_parameters:\n   k1: 0.01\n   k2: 0.002\n   p1: 0.001\n   p2: 0.0001\n"
    "projection_parameters:\n   fx: 400.0\n   fy: 401.0\n   cx: 320.0\n   cy: 240.0\n",
    "# Camera list\n1 OPENCV 640 480 500 500 320 240 0.1 0.01 0.001 0.001\n",
    "# Camera list\n7 OPENCV_FISHEYE 640 480 500 500 320 240 0.1 0.01 0.001 0.001\n",
    "# oST version 5.0 parameters\n\n[image]\n\nwidth\n640\n\nheight\n480\n\n[cam]\n\n"
    "camera matrix\n500 0 320\n0 500 240\n0 0 1\n\ndistortion\n0.1 0.02 0 0 0\n\n"
    "rectification\n1 0 0\n0 1 0\n0 0 1\n\nprojection\n500 0 320 0\n0 500 240 0\n0 0 1 0\n",
    json.dumps(PLACE | {"k1": 0.1, "k2": 1e-05, "p2": 0.001, "camera_model": "OPENCV"}, indent=0),
    json.dumps({"value0": {"intrinsics": [KB4], "resolution": [[640, 480]]}}, indent=0),
    json.dumps(T265, indent=0),
)
