"""How the tracker was made, with TWIST2's policy as the teacher. See ``python -m research.tracker --help``."""
