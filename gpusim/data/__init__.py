"""Built-in data: lights, reflectances, colorimetry, charts, cameras."""
