"""What is simulated: scenes, lenses, sensors, processors, displays; with units and checks, knowing nothing else."""
