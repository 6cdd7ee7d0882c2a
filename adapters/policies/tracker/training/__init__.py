"""How the tracker was made: DAgger, with TWIST2's policy as the teacher. See ``python -m …training --help``."""
