"""What comes with gpusim: lights, reflectances, colorimetry, charts, cameras."""
