"""The tags of a picture's file as exiftool reads them."""

import json
import shutil
import subprocess

import pytest


def exiftool(path) -> dict:
    """Tags by name, lists of numbers as such, of a file in which exiftool finds no error and nothing to warn of."""
    if not shutil.which("exiftool"):
        pytest.skip("exiftool is not installed")
    run = subprocess.run(
        ["exiftool", "-json", "-n", "-validate", "-all", path], capture_output=True, text=True
    )
    tags = {name: _parsed(value) for name, value in json.loads(run.stdout)[0].items()}
    assert tags["Validate"] == [0, 0, 0], run.stdout + run.stderr  # errors, warnings, minor ones
    return tags


def _parsed(value):
    try:
        numbers = [float(part) for part in value.split()]
    except (AttributeError, ValueError):
        return value
    return numbers if len(numbers) != 1 else numbers[0]
