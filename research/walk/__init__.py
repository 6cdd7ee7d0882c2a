"""How the policies were made that follow velocities, with a teacher each. See ``python -m research.walk --help``."""
